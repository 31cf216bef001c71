//! The encoders of meshoptimizer, as `EXT_meshopt_compression` and `KHR_meshopt_compression` have them.

use numpy::{PyArray1, PyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::arrays::{FaceArray, into_array, into_rows, vertex_rows};
use super::calls::detached;
use super::errors::argument_error;
use crate::error::Error;

/// How hard the vertex codec tries; version 0 does not ask.
const VERTEX_LEVEL: i32 = 2;
/// Bits of each coordinate of a packed direction.
const DIRECTION_BITS: i32 = 8;

fn failed(error: meshopt::Error) -> Error {
    Error::Invariant(format!("meshoptimizer: {error}"))
}

/// Orders faces and vertices so that they pack well. Returns the faces with new numbers, and for each new vertex its old number;
/// vertices that no face has are left out.
#[pyfunction]
#[allow(clippy::type_complexity)]
pub(super) fn vertex_order(
    py: Python<'_>,
    faces: &Bound<'_, PyAny>,
    vertices: usize,
) -> PyResult<(Py<PyArray2<u32>>, Py<PyArray1<u32>>)> {
    let faces = FaceArray::new(faces, "faces", vertices)?;
    let faces = faces.get();
    let (faces, order) = detached(py, || {
        let mut corners = meshopt::optimize_vertex_cache(faces.as_flattened(), vertices);
        let place = meshopt::optimize_vertex_fetch_remap(&corners, vertices);
        let used = place.iter().filter(|row| **row != u32::MAX).count();
        let mut order = vec![0; used];
        for (old, new) in place.iter().enumerate().filter(|(_, new)| **new != u32::MAX) {
            order[*new as usize] = old as u32;
        }
        corners.iter_mut().for_each(|v| *v = place[*v as usize]);
        Ok((corners.as_chunks::<3>().0.to_vec(), order))
    })?;
    Ok((into_rows(py, faces)?, into_array(py, order)))
}

/// Packs rows of (N, S) bytes, S a multiple of 4 up to 16, by version 0 or 1 of the vertex codec.
#[pyfunction]
pub(super) fn pack_vertices<'py>(
    py: Python<'py>,
    rows: &Bound<'py, PyAny>,
    version: i32,
) -> PyResult<Bound<'py, PyBytes>> {
    fn packed<'py, const S: usize>(
        py: Python<'py>,
        rows: &Bound<'py, PyAny>,
        version: i32,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let rows = vertex_rows::<u8, S>(rows, "rows", rows.len()?)?;
        let rows = rows.get();
        let encode = || meshopt::encode_vertex_buffer_level(rows, VERTEX_LEVEL, Some(version));
        detached(py, || encode().map_err(failed)).map(|bytes| PyBytes::new(py, &bytes))
    }
    if !(0..=1).contains(&version) {
        return Err(argument_error(py, "version", format!("must be 0 or 1, not {version}")));
    }
    let shape = rows.cast::<numpy::PyUntypedArray>().map(|array| array.shape().to_vec()).unwrap_or_default();
    match shape[..] {
        [_, 4] => packed::<4>(py, rows, version),
        [_, 8] => packed::<8>(py, rows, version),
        [_, 12] => packed::<12>(py, rows, version),
        [_, 16] => packed::<16>(py, rows, version),
        _ => Err(argument_error(py, "rows", format!("expected 4, 8, 12 or 16 columns, found {shape:?}"))),
    }
}

/// Packs faces.
#[pyfunction]
pub(super) fn pack_faces<'py>(
    py: Python<'py>,
    faces: &Bound<'py, PyAny>,
    vertices: usize,
) -> PyResult<Bound<'py, PyBytes>> {
    let faces = FaceArray::new(faces, "faces", vertices)?;
    let faces = faces.get();
    let encode = || meshopt::encode_index_buffer(faces.as_flattened(), vertices);
    detached(py, || encode().map_err(failed)).map(|bytes| PyBytes::new(py, &bytes))
}

/// Rounds unit vectors to (N, 4) bytes of the octahedral filter; what it decodes to is (N, 4) int8, normalized.
#[pyfunction]
pub(super) fn pack_directions(py: Python<'_>, directions: &Bound<'_, PyAny>) -> PyResult<Py<PyArray2<i8>>> {
    let rows = vertex_rows::<f32, 3>(directions, "directions", directions.len()?)?;
    let rows = rows.get();
    let packed = detached(py, || {
        let wide: Vec<[f32; 4]> = rows.iter().map(|[x, y, z]| [*x, *y, *z, 0.0]).collect();
        Ok(meshopt::encoding::encode_filter_oct::<i8>(&wide, DIRECTION_BITS))
    })?;
    into_rows(py, packed)
}
