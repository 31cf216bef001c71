//! Files of other programs as arrays for Python. What they mean is decided there.

use numpy::{Element, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};

use super::arrays::{into_array, into_rows};
use super::calls::detached;
use super::errors::{exception_with_message, to_python};
use crate::error::{Error, Result};
use crate::read::{obj, off, ply, polygon, stl};

/// Reads without the interpreter lock. Errors begin with the name of the file.
fn reading<T: Send>(py: Python<'_>, file: &str, read: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    detached(py, || Ok(read()))?.map_err(|error| match error {
        Error::Source { .. } => exception_with_message(py, "FormatError", &format!("{file}: {error}")),
        Error::IndexOutOfRange { .. } | Error::TooLarge(_) => {
            exception_with_message(py, "MeshError", &format!("{file}: {error}"))
        }
        other => to_python(py, other),
    })
}

fn bytes_of(py: Python<'_>, names: &[Vec<u8>]) -> PyResult<Py<PyList>> {
    Ok(PyList::new(py, names.iter().map(|n| PyBytes::new(py, n)))?.unbind())
}

fn optional_rows<T: Element + bytemuck::Pod, const C: usize>(
    py: Python<'_>,
    rows: Option<Vec<[T; C]>>,
) -> PyResult<Option<Py<PyAny>>> {
    rows.map(|rows| Ok(into_rows(py, rows)?.into_any())).transpose()
}

fn values(py: Python<'_>, values: ply::Values) -> Py<PyAny> {
    use ply::Values as V;
    match values {
        V::I8(v) => into_array(py, v).into_any(),
        V::U8(v) => into_array(py, v).into_any(),
        V::I16(v) => into_array(py, v).into_any(),
        V::U16(v) => into_array(py, v).into_any(),
        V::I32(v) => into_array(py, v).into_any(),
        V::U32(v) => into_array(py, v).into_any(),
        V::I64(v) => into_array(py, v).into_any(),
        V::U64(v) => into_array(py, v).into_any(),
        V::F32(v) => into_array(py, v).into_any(),
        V::F64(v) => into_array(py, v).into_any(),
    }
}

/// Elements with their properties: values, and lengths of lists.
#[pyfunction]
pub(super) fn read_ply<'py>(py: Python<'py>, file: &str, data: &[u8]) -> PyResult<Bound<'py, PyDict>> {
    let found = reading(py, file, || ply::read(data))?;
    let out = PyDict::new(py);
    out.set_item("format", found.format)?;
    out.set_item("comments", bytes_of(py, &found.comments)?)?;
    out.set_item("behind", found.behind)?;
    let elements = PyList::empty(py);
    for element in found.elements {
        let properties = PyDict::new(py);
        for property in element.properties {
            let lengths = property.lengths.map(|l| into_array(py, l));
            properties.set_item(property.name, (values(py, property.values), lengths))?;
        }
        elements.append((element.name, element.rows, properties))?;
    }
    out.set_item("elements", elements)?;
    Ok(out)
}

/// How many rows of the only element are whole, the bytes that they take, and whether one is cut off behind them.
#[pyfunction]
pub(super) fn whole_ply_rows(py: Python<'_>, file: &str, data: &[u8]) -> PyResult<(usize, usize, bool)> {
    let found = reading(py, file, || ply::whole_rows(data))?;
    Ok((found.rows, found.bytes, found.cut_off))
}

/// Corners of triangles, and what is said about them.
#[pyfunction]
pub(super) fn read_stl<'py>(py: Python<'py>, file: &str, data: &[u8]) -> PyResult<Bound<'py, PyDict>> {
    let found = reading(py, file, || stl::read(data))?;
    let out = PyDict::new(py);
    out.set_item("corners", into_rows(py, found.corners)?)?;
    out.set_item("attributes", found.attributes.map(|a| into_array(py, a)))?;
    out.set_item("header", PyBytes::new(py, &found.header))?;
    out.set_item("solids", found.solids)?;
    out.set_item("behind", found.behind)?;
    Ok(out)
}

/// Parts by object and material, with their names.
#[pyfunction]
pub(super) fn read_obj<'py>(py: Python<'py>, file: &str, data: &[u8]) -> PyResult<Bound<'py, PyDict>> {
    let found: obj::Obj = reading(py, file, || obj::read(data))?;
    let out = PyDict::new(py);
    out.set_item("objects", found.objects)?;
    out.set_item("materials", bytes_of(py, &found.materials)?)?;
    out.set_item("groups", found.groups)?;
    out.set_item("libraries", bytes_of(py, &found.libraries)?)?;
    out.set_item("left", found.left)?;
    let parts = PyList::empty(py);
    for part in found.parts {
        let row = PyDict::new(py);
        row.set_item("object", part.object)?;
        row.set_item("material", part.material)?;
        row.set_item("positions", into_rows(py, part.positions)?)?;
        row.set_item("faces", into_rows(py, part.faces)?)?;
        row.set_item("uvs", optional_rows(py, part.uvs)?)?;
        row.set_item("normals", optional_rows(py, part.normals)?)?;
        row.set_item("colors", optional_rows(py, part.colors)?)?;
        row.set_item("groups", part.groups.map(|g| into_array(py, g)))?;
        row.set_item("smoothing", part.smoothing.map(|s| into_array(py, s)))?;
        parts.append(row)?;
    }
    out.set_item("parts", parts)?;
    Ok(out)
}

/// Vertices with what they carry, and polygons.
#[pyfunction]
pub(super) fn read_off<'py>(py: Python<'py>, file: &str, data: &[u8]) -> PyResult<Bound<'py, PyDict>> {
    let found = reading(py, file, || off::read(data))?;
    let out = PyDict::new(py);
    out.set_item("positions", into_rows(py, found.positions)?)?;
    out.set_item("normals", optional_rows(py, found.normals)?)?;
    out.set_item("colors", optional_rows(py, found.colors)?)?;
    out.set_item("uvs", optional_rows(py, found.uvs)?)?;
    out.set_item("corners", into_array(py, found.corners))?;
    out.set_item("counts", into_array(py, found.counts))?;
    out.set_item("face_colors", optional_rows(py, found.face_colors)?)?;
    out.set_item("more", found.more)?;
    out.set_item("by_table", found.by_table)?;
    out.set_item("behind", found.behind)?;
    Ok(out)
}

/// Triangles as numbers of corners, the polygon of each, and how many polygons have fewer than three corners.
#[pyfunction]
pub(super) fn triangulate<'py>(
    py: Python<'py>,
    file: &str,
    points: PyReadonlyArray2<'py, f64>,
    corners: PyReadonlyArray1<'py, u32>,
    counts: PyReadonlyArray1<'py, u32>,
) -> PyResult<(Py<PyAny>, Py<PyAny>, usize)> {
    let points: &[[f64; 3]] = bytemuck::cast_slice(points.as_slice()?);
    let (corners, counts) = (corners.as_slice()?, counts.as_slice()?);
    let found = reading(py, file, || polygon::triangulate(points, corners, counts))?;
    let triangles = into_rows(py, found.corners)?.into_any();
    Ok((triangles, into_array(py, found.polygons).into_any(), found.without))
}

/// Triangles of strips that numbers below zero part.
#[pyfunction]
pub(super) fn strips<'py>(
    py: Python<'py>,
    values: PyReadonlyArray1<'py, i64>,
    lengths: PyReadonlyArray1<'py, u32>,
) -> PyResult<Py<PyAny>> {
    let (values, lengths) = (values.as_slice()?, lengths.as_slice()?);
    Ok(into_rows(py, detached(py, || Ok(polygon::strips(values, lengths)))?)?.into_any())
}
