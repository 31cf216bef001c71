//! Distances between meshes from Python. See `nanite_rs.measure`.

use std::borrow::Cow;

use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

use super::arrays::{FaceArray, PositionArray, into_array, into_rows};
use super::calls::{detached, watched};
use crate::measure::distance::{OneSided, Summary};
use crate::measure::{self, DistanceOptions, MeshView};
use crate::mesh::Positions;

/// Positions as f64, copied only where they are not.
pub(super) fn wide<'a>(py: Python<'_>, positions: &'a PositionArray<'_>) -> PyResult<Cow<'a, [[f64; 3]]>> {
    Ok(match positions.get() {
        Positions::F64(p) => Cow::Borrowed(p),
        Positions::F32(p) => {
            Cow::Owned(detached(py, || Ok(p.par_iter().map(|v| v.map(f64::from)).collect()))?)
        }
    })
}

fn summary(s: &Summary) -> (f64, f64, f64) {
    (s.mean, s.rms, s.max)
}

fn one_sided(py: Python<'_>, side: OneSided) -> PyResult<Bound<'_, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("distance", summary(&side.distance))?;
    out.set_item("normals", summary(&side.normals))?;
    out.set_item("area", side.area)?;
    out.set_item("bound", side.bound.map(|b| (b.lower, b.upper, b.pieces)))?;
    out.set_item("per_vertex", into_array(py, side.per_vertex))?;
    Ok(out)
}

/// Distances in both directions and the rounding of their bounds.
#[pyfunction]
#[pyo3(signature = (a_vertices, a_faces, b_vertices, b_faces, *, samples, seed, bounded=None))]
pub(super) fn surface_distance<'py>(
    py: Python<'py>,
    a_vertices: &Bound<'py, PyAny>,
    a_faces: &Bound<'py, PyAny>,
    b_vertices: &Bound<'py, PyAny>,
    b_faces: &Bound<'py, PyAny>,
    samples: usize,
    seed: u64,
    bounded: Option<(f64, u64)>,
) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>, f64)> {
    let a_positions = PositionArray::new(a_vertices, "a.vertices")?;
    let b_positions = PositionArray::new(b_vertices, "b.vertices")?;
    let a_faces = FaceArray::new(a_faces, "a.faces", a_positions.get().len())?;
    let b_faces = FaceArray::new(b_faces, "b.faces", b_positions.get().len())?;
    let (a_wide, b_wide) = (wide(py, &a_positions)?, wide(py, &b_positions)?);
    let a = MeshView { name: "a.vertices", vertices: &a_wide, faces: a_faces.get() };
    let b = MeshView { name: "b.vertices", vertices: &b_wide, faces: b_faces.get() };
    let options = DistanceOptions { samples, seed, bounded };
    let found = watched(py, 0, None, |progress| {
        measure::surface_distance(a, b, &options, &|done, total| progress.update(done, total))
    })?;
    let [from_a, from_b] = found.directions;
    Ok((one_sided(py, from_a)?, one_sided(py, from_b)?, found.rounding))
}

/// Distances, faces and points.
type ClosestPoints = (Py<PyArray1<f64>>, Py<PyArray1<u32>>, Py<PyArray2<f64>>);

/// Distances, faces and points nearest to each of some points.
#[pyfunction]
pub(super) fn closest_points<'py>(
    py: Python<'py>,
    points: &Bound<'py, PyAny>,
    vertices: &Bound<'py, PyAny>,
    faces: &Bound<'py, PyAny>,
) -> PyResult<ClosestPoints> {
    let points = PositionArray::new(points, "points")?;
    let vertices = PositionArray::new(vertices, "mesh.vertices")?;
    let faces = FaceArray::new(faces, "mesh.faces", vertices.get().len())?;
    let (wide_points, wide_vertices) = (wide(py, &points)?, wide(py, &vertices)?);
    let mesh = MeshView { name: "mesh.vertices", vertices: &wide_vertices, faces: faces.get() };
    let found = watched(py, 0, None, |progress| {
        measure::closest_points(("points", &wide_points), mesh, &|done, total| progress.update(done, total))
    })?;
    Ok((
        into_array(py, found.iter().map(|f| f.0).collect()),
        into_array(py, found.iter().map(|f| f.1).collect()),
        into_rows(py, found.iter().map(|f| f.2).collect())?,
    ))
}
