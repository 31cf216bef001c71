//! `_core.TriangleMesh`: ordinary meshes, whose vertices may move.

use numpy::{PyArray2, PyReadonlyArray1};
use pyo3::prelude::*;

use super::arrays::{PositionArray, into_rows, vertex_rows};
use super::calls::detached;
use super::mesh::{Mesh, RawArrays};
use crate::build::OneLevel;
use crate::mesh::skin::{Influences, JointMatrix, skin};
use crate::model::{Primitive, StrokeSize};

/// What of an ordinary mesh does not depend on where its vertices are.
#[pyclass(frozen, module = "nanite_rs._core")]
pub(super) struct TriangleMesh(OneLevel);

#[pymethods]
impl TriangleMesh {
    /// From arrays. See `nanite_rs.TriangleMesh`. With `stroke` (whether of lines, radius, whether in units of the world) faces
    /// are points, a vertex three times, or lines, the second vertex twice.
    #[new]
    #[pyo3(signature = (arrays, stroke=None))]
    fn new(py: Python<'_>, arrays: RawArrays<'_>, stroke: Option<(bool, f32, bool)>) -> PyResult<Self> {
        let primitive = stroke.map_or(Primitive::Triangles, |(line, radius, world)| {
            let size = if world { StrokeSize::World(radius) } else { StrokeSize::Pixels(radius) };
            if line { Primitive::Lines(size) } else { Primitive::Points(size) }
        });
        arrays.with_source(|source| detached(py, || OneLevel::new(source, primitive)).map(Self))
    }

    /// The mesh with its vertices at these positions. Without `normals` they are computed.
    #[pyo3(signature = (vertices, normals=None))]
    fn shape(
        &self,
        py: Python<'_>,
        vertices: &Bound<'_, PyAny>,
        normals: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Mesh> {
        let positions = PositionArray::new(vertices, "vertices")?;
        let normals =
            normals.map(|rows| vertex_rows::<f32, 3>(rows, "normals", self.0.vertices())).transpose()?;
        let (positions, normals) = (positions.get(), normals.as_ref().map(|rows| rows.get()));
        detached(py, || self.0.shape(positions, normals)).map(Mesh::new)
    }
}

/// Positions and normals.
type SkinnedArrays = (Py<PyArray2<f64>>, Option<Py<PyArray2<f32>>>);

/// Vertices where joints take them: positions (N, 3) float64, and normals. `joints` and `weights` are those of all vertices, one
/// after the other, `matrices` three rows (3 · J, 4) for each joint.
#[pyfunction]
#[pyo3(signature = (vertices, normals, joints, weights, matrices))]
pub(super) fn skinned(
    py: Python<'_>,
    vertices: &Bound<'_, PyAny>,
    normals: Option<&Bound<'_, PyAny>>,
    joints: PyReadonlyArray1<'_, u32>,
    weights: PyReadonlyArray1<'_, f32>,
    matrices: &Bound<'_, PyAny>,
) -> PyResult<SkinnedArrays> {
    let count = vertices.len()?;
    let vertices = vertex_rows::<f32, 3>(vertices, "vertices", count)?;
    let normals = normals.map(|rows| vertex_rows::<f32, 3>(rows, "normals", count)).transpose()?;
    let rows = vertex_rows::<f64, 4>(matrices, "matrices", matrices.len()?)?;
    let matrices: &[JointMatrix] = rows.get().as_chunks().0;
    let influences = Influences { joints: joints.as_slice()?, weights: weights.as_slice()? };
    let (vertices, normals) = (vertices.get(), normals.as_ref().map(|rows| rows.get()));
    let (moved, turned) = detached(py, || skin(vertices, normals, influences, matrices))?;
    Ok((into_rows(py, moved)?, turned.map(|rows| into_rows(py, rows)).transpose()?))
}
