//! Displacement from Python. See `nanite_rs.displace`.

use std::borrow::Cow;

use numpy::{PyReadonlyArray2, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{FaceArray, PositionArray, into_array, into_rows, vertex_rows};
use super::calls::{interruptible, watched};
use super::errors::{argument_error, to_python};
use super::measure::wide;
use super::scene::wrap;
use crate::displace::heightfield::Posts;
use crate::displace::{HeightMap, Input, Options, Texels};
use crate::error::{Error, Result};

/// Numbers of an array, C-contiguous, of any type that is kept.
#[derive(FromPyObject)]
pub(super) enum TexelArray<'py> {
    U8(PyReadonlyArrayDyn<'py, u8>),
    U16(PyReadonlyArrayDyn<'py, u16>),
    F32(PyReadonlyArrayDyn<'py, f32>),
    F64(PyReadonlyArrayDyn<'py, f64>),
}

impl TexelArray<'_> {
    fn shape(&self) -> &[usize] {
        match self {
            Self::U8(a) => a.shape(),
            Self::U16(a) => a.shape(),
            Self::F32(a) => a.shape(),
            Self::F64(a) => a.shape(),
        }
    }

    fn texels(&self) -> Result<Texels<'_>> {
        let found = match self {
            Self::U8(a) => a.as_slice().map(Texels::U8),
            Self::U16(a) => a.as_slice().map(Texels::U16),
            Self::F32(a) => a.as_slice().map(Texels::F32),
            Self::F64(a) => a.as_slice().map(Texels::F64),
        };
        found.map_err(|_| Error::argument("height", "must be C-contiguous"))
    }
}

/// Displaces a mesh. Texels are (H, W) or (H, W, 3).
#[pyfunction]
// They have names in Python.
#[allow(clippy::too_many_arguments)]
#[pyo3(signature = (arrays, texels, *, wraps, rows, scale, midlevel, tolerance, max_triangles))]
pub(super) fn displace<'py>(
    py: Python<'py>,
    arrays: (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Option<Bound<'py, PyAny>>),
    texels: TexelArray<'py>,
    wraps: (u8, u8),
    rows: [[f64; 3]; 2],
    scale: f64,
    midlevel: f64,
    tolerance: f64,
    max_triangles: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let (vertices, faces, uvs, normals) = arrays;
    let positions = PositionArray::new(&vertices, "vertices")?;
    let count = positions.get().len();
    let faces = FaceArray::new(&faces, "faces", count)?;
    let uvs = vertex_rows::<f64, 2>(&uvs, "uvs", count)?;
    let normals = normals.map(|n| vertex_rows::<f64, 3>(&n, "normals", count)).transpose()?;
    let wide: Cow<'_, [[f64; 3]]> = wide(py, &positions)?;
    let input = Input {
        vertices: &wide,
        faces: faces.get(),
        uvs: uvs.get(),
        normals: normals.as_ref().map(|n| n.get()),
    };
    let shape = [texels.shape()[0], texels.shape()[1]];
    let numbers = texels.texels().map_err(|error| to_python(py, error))?;
    let options = Options { scale, midlevel, tolerance, max_triangles };
    let made = watched(py, 0, None, |progress| {
        let map = HeightMap::new(numbers, shape, [wrap(wraps.0), wrap(wraps.1)], rows)?;
        crate::displace::displace(input, map, &options, &|| progress.update(0, 0))
    })?;
    let out = PyDict::new(py);
    out.set_item("vertices", into_rows(py, made.vertices)?)?;
    out.set_item("faces", into_rows(py, made.faces)?)?;
    out.set_item("uvs", into_rows(py, made.uvs)?)?;
    out.set_item("normals", into_rows(py, made.normals)?)?;
    out.set_item("face_ids", into_array(py, made.face_ids))?;
    out.set_item("error", made.error)?;
    out.set_item("tear", made.tear)?;
    out.set_item("dropped_faces", made.dropped)?;
    Ok(out)
}

/// Triangulates a rectangle of posts, of which `roles` says what each is.
#[pyfunction]
#[pyo3(signature = (heights, roles, *, tolerance, max_triangles, fit))]
pub(super) fn heightfield<'py>(
    py: Python<'py>,
    heights: PyReadonlyArray2<'py, f64>,
    roles: PyReadonlyArray2<'py, u8>,
    tolerance: f64,
    max_triangles: usize,
    fit: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let shape = heights.shape();
    let (height, width) = (shape[0], shape[1]);
    let (Ok(numbers), Ok(kinds)) = (heights.as_slice(), roles.as_slice()) else {
        return Err(argument_error(py, "heights", "must be C-contiguous"));
    };
    if roles.shape() != shape {
        return Err(argument_error(py, "roles", format!("expected shape {shape:?}")));
    }
    let posts = Posts { heights: numbers, roles: kinds, width, height };
    let made = interruptible(py, |check| {
        crate::displace::heightfield::heightfield(posts, tolerance, max_triangles, fit, check)
    })?;
    let out = PyDict::new(py);
    out.set_item("places", into_rows(py, made.places)?)?;
    out.set_item("heights", into_array(py, made.heights))?;
    out.set_item("triangles", into_rows(py, made.triangles)?)?;
    out.set_item("error", made.error)?;
    out.set_item("squares", made.squares)?;
    out.set_item("measured", made.measured)?;
    Ok(out)
}
