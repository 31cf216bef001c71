//! Checked access to NumPy arrays: shapes, dtypes and ranges, with errors that name the argument.

use std::borrow::Cow;

use numpy::{
    Element, PyArray, PyArray1, PyArray2, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArray2,
    PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods, dtype,
};
use pyo3::prelude::*;
use rayon::prelude::*;

use super::calls::detached;
use super::errors::{argument_error, dtype_error, to_python};
use crate::error::Error;
use crate::mesh::{Colors, Positions, SourceChannel};
use crate::model::{ChannelInfo, ChannelType, ColorFormat};

/// An (N, C) array of `T`, C-contiguous and aligned, that stays alive and unwritten by us.
pub(super) struct Rows<'py, T: Element, const C: usize>(PyReadonlyArray2<'py, T>);

impl<T: Element + bytemuck::Pod, const C: usize> Rows<'_, T, C> {
    /// The rows, without copying.
    pub(super) fn get(&self) -> &[[T; C]] {
        // `rows` made sure of both.
        bytemuck::cast_slice(self.0.as_slice().unwrap_or_default())
    }
}

fn untyped<'a, 'py>(
    value: &'a Bound<'py, PyAny>,
    argument: &'static str,
) -> PyResult<&'a Bound<'py, PyUntypedArray>> {
    value.cast::<PyUntypedArray>().map_err(|_| {
        let found = value.get_type().name().map_or_else(|_| "?".into(), |n| n.to_string());
        dtype_error(value.py(), argument, &format!("expected a NumPy array, not {found}"))
    })
}

fn check_shape(array: &Bound<'_, PyUntypedArray>, argument: &'static str, columns: usize) -> PyResult<()> {
    if array.ndim() == 2 && array.shape()[1] == columns {
        return Ok(());
    }
    let letter = if argument.ends_with("faces") { 'M' } else { 'N' };
    let found = match array.shape() {
        [one] => format!("({one},)"),
        shape => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    };
    Err(argument_error(array.py(), argument, format!("expected shape ({letter}, {columns}), found {found}")))
}

/// The name that users know, such as float64.
fn dtype_name(array: &Bound<'_, PyUntypedArray>) -> String {
    array.dtype().to_string()
}

/// A C-contiguous, aligned, native-endian array of `T`: the array itself where it is one already.
fn rows<'py, T: Element + bytemuck::Pod, const C: usize>(
    array: &Bound<'py, PyUntypedArray>,
) -> PyResult<Rows<'py, T, C>> {
    let py = array.py();
    if let Ok(typed) = array.cast::<PyArray2<T>>()
        && typed.is_c_contiguous()
        && let Ok(readonly) = typed.try_readonly()
        && readonly.as_slice().is_ok_and(|s| s.as_ptr().is_aligned())
    {
        return Ok(Rows(readonly));
    }
    let copy = py.import("numpy")?.call_method1("array", (array, dtype::<T>(py)))?;
    let copy = py.import("numpy")?.call_method1("ascontiguousarray", (copy,))?;
    Ok(Rows(copy.cast::<PyArray2<T>>()?.try_readonly()?))
}

/// RGBA colours of any of the dtypes that are kept.
pub(super) enum ColorArray<'py> {
    U8(Rows<'py, u8, 4>),
    U16(Rows<'py, u16, 4>),
    F32(Rows<'py, f32, 4>),
}

impl<'py> ColorArray<'py> {
    /// Checks that `value` is (N, 4) of uint8, uint16 or float32, one row for each of so many vertices.
    pub(super) fn new(value: &Bound<'py, PyAny>, argument: &'static str, vertices: usize) -> PyResult<Self> {
        let array = untyped(value, argument)?;
        Ok(match (array.dtype().kind(), array.dtype().itemsize()) {
            (b'u', 2) => Self::U16(vertex_rows(value, argument, vertices)?),
            (b'f', 4) => Self::F32(vertex_rows(value, argument, vertices)?),
            _ => Self::U8(vertex_rows(value, argument, vertices)?),
        })
    }

    /// The rows, without copying.
    pub(super) fn get(&self) -> Colors<'_> {
        match self {
            Self::U8(rows) => Colors::U8(rows.get()),
            Self::U16(rows) => Colors::U16(rows.get()),
            Self::F32(rows) => Colors::F32(rows.get()),
        }
    }
}

/// Colours as an (N, 4) array of the dtype of their format; None without.
pub(super) fn into_colors(
    py: Python<'_>,
    words: Vec<u32>,
    format: ColorFormat,
) -> PyResult<Option<Py<PyAny>>> {
    let Some(dtype) = format.dtype() else { return Ok(None) };
    let rows = into_words(py, words, format.words())?;
    Ok(Some(rows.bind(py).call_method1("view", (dtype,))?.unbind()))
}

/// Vertex positions of either precision.
pub(super) enum PositionArray<'py> {
    F32(Rows<'py, f32, 3>),
    F64(Rows<'py, f64, 3>),
}

impl<'py> PositionArray<'py> {
    /// Takes (N, 3) float32 or float64.
    pub(super) fn new(value: &Bound<'py, PyAny>, argument: &'static str) -> PyResult<Self> {
        let array = untyped(value, argument)?;
        check_shape(array, argument, 3)?;
        match (array.dtype().kind(), array.dtype().itemsize()) {
            (b'f', 4) => Ok(Self::F32(rows(array)?)),
            (b'f', 8) => Ok(Self::F64(rows(array)?)),
            _ => {
                let found = dtype_name(array);
                Err(dtype_error(value.py(), argument, &format!("expected float32 or float64, not {found}")))
            }
        }
    }

    /// The view that building takes.
    pub(super) fn get(&self) -> Positions<'_> {
        match self {
            Self::F32(rows) => Positions::F32(rows.get()),
            Self::F64(rows) => Positions::F64(rows.get()),
        }
    }
}

/// Triangles of any integer type.
pub(super) enum FaceArray<'py> {
    Borrowed(Rows<'py, u32, 3>),
    Converted(Vec<[u32; 3]>),
}

impl<'py> FaceArray<'py> {
    /// Takes (M, 3) integers; refuses what no vertex number can be, with its row.
    pub(super) fn new(value: &Bound<'py, PyAny>, argument: &'static str, vertices: usize) -> PyResult<Self> {
        let array = untyped(value, argument)?;
        check_shape(array, argument, 3)?;
        match (array.dtype().kind(), array.dtype().itemsize()) {
            (b'u', 4) => Ok(Self::Borrowed(rows(array)?)),
            (b'u', 1) => convert::<u8>(array, vertices),
            (b'u', 2) => convert::<u16>(array, vertices),
            (b'u', 8) => convert::<u64>(array, vertices),
            (b'i', 1) => convert::<i8>(array, vertices),
            (b'i', 2) => convert::<i16>(array, vertices),
            (b'i', 4) => convert::<i32>(array, vertices),
            (b'i', 8) => convert::<i64>(array, vertices),
            _ => {
                let found = dtype_name(array);
                Err(dtype_error(value.py(), argument, &format!("expected an integer dtype, not {found}")))
            }
        }
    }

    /// The triangles.
    pub(super) fn get(&self) -> &[[u32; 3]] {
        match self {
            Self::Borrowed(rows) => rows.get(),
            Self::Converted(rows) => rows,
        }
    }
}

fn convert<'py, T>(array: &Bound<'py, PyUntypedArray>, vertices: usize) -> PyResult<FaceArray<'py>>
where
    T: Element + bytemuck::Pod + TryInto<u32> + Into<i128>,
{
    let py = array.py();
    let source = rows::<T, 3>(array)?;
    let source = source.get();
    let converted = detached(py, || {
        Ok(source
            .par_iter()
            .enumerate()
            .map(|(face, row)| {
                let mut out = [0; 3];
                for (to, from) in out.iter_mut().zip(row) {
                    let fits = (*from).try_into().ok().filter(|v: &u32| (*v as usize) < vertices);
                    *to = fits.ok_or((face, Into::<i128>::into(*from)))?;
                }
                Ok(out)
            })
            .collect::<Result<Vec<_>, (usize, i128)>>())
    })?;
    // Which bad face came first to a thread is chance: name the first in the array.
    converted.map(FaceArray::Converted).map_err(|_| {
        let bad = |v: &T| Into::<i128>::into(*v) < 0 || Into::<i128>::into(*v) >= vertices as i128;
        let first =
            source.iter().enumerate().find_map(|(face, row)| Some((face, row.iter().copied().find(bad)?)));
        let (face, index) = first.map_or((0, 0), |(face, v)| (face, Into::<i128>::into(v)));
        let index = i64::try_from(index).unwrap_or(i64::MAX);
        to_python(py, Error::IndexOutOfRange { face, index, vertices })
    })
}

/// One row per vertex of a given dtype; other dtypes are refused.
pub(super) fn vertex_rows<'py, T: Element + bytemuck::Pod, const C: usize>(
    value: &Bound<'py, PyAny>,
    argument: &'static str,
    vertices: usize,
) -> PyResult<Rows<'py, T, C>> {
    let array = untyped(value, argument)?;
    check_shape(array, argument, C)?;
    let py = value.py();
    if array.len() / C != vertices {
        let found = array.len() / C;
        let message = format!("expected one row for each of the {vertices} vertices, found {found}");
        return Err(argument_error(py, argument, message));
    }
    let expected = dtype::<T>(py);
    if array.dtype().kind() != expected.kind() || array.dtype().itemsize() != expected.itemsize() {
        let found = dtype_name(array);
        return Err(dtype_error(py, argument, &format!("expected {expected}, not {found}")));
    }
    rows(array)
}

/// An (N, C) array that takes over the memory of a vector.
pub(super) fn into_rows<T, const C: usize>(py: Python<'_>, rows: Vec<[T; C]>) -> PyResult<Py<PyArray2<T>>>
where
    T: Element + bytemuck::Pod,
{
    let count = rows.len();
    Ok(PyArray::from_vec(py, rows.into_flattened()).reshape([count, C])?.unbind())
}

/// A one-dimensional array that takes over the memory of a vector.
pub(super) fn into_array<T: Element>(py: Python<'_>, values: Vec<T>) -> Py<PyArray1<T>> {
    PyArray::from_vec(py, values).unbind()
}

/// An (N, C) array of words that takes over the memory of a vector.
pub(super) fn into_words(py: Python<'_>, words: Vec<u32>, columns: usize) -> PyResult<Py<PyArray2<u32>>> {
    let rows = words.len().checked_div(columns).unwrap_or(0);
    Ok(PyArray::from_vec(py, words).reshape([rows, columns])?.unbind())
}

/// A named channel: the words of its values as uint32, (N,) or (N, C), with the dtype that they are.
pub(super) struct ChannelArray<'py> {
    info: ChannelInfo,
    words: PyReadonlyArrayDyn<'py, u32>,
}

impl<'py> ChannelArray<'py> {
    /// Takes a C-contiguous array of words.
    pub(super) fn new(name: String, dtype: &str, value: &Bound<'py, PyAny>) -> PyResult<Self> {
        let py = value.py();
        let Some(dtype) = ChannelType::named(dtype) else {
            return Err(dtype_error(py, "channels", &format!("{name:?} cannot be {dtype}")));
        };
        let words = value.cast::<PyArrayDyn<u32>>()?.try_readonly()?;
        let columns = match *words.shape() {
            [_] => None,
            [_, columns] => u32::try_from(columns).ok(),
            _ => {
                let message = format!("{name:?} has shape {:?}; expected (N,) or (N, C)", words.shape());
                return Err(argument_error(py, "channels", message));
            }
        };
        if words.as_slice().is_err() {
            return Err(argument_error(py, "channels", format!("{name:?} is not contiguous")));
        }
        Ok(Self { info: ChannelInfo { name, dtype, columns }, words })
    }

    /// The view that building takes.
    pub(super) fn get(&self) -> SourceChannel<'_> {
        SourceChannel { info: self.info.clone(), words: self.words.as_slice().unwrap_or_default() }
    }
}

/// A 4×4 matrix of f64 from anything that converts to one.
pub(super) fn matrix4(value: &Bound<'_, PyAny>, argument: &'static str) -> PyResult<[[f64; 4]; 4]> {
    let py = value.py();
    let array = py.import("numpy")?.call_method1("asarray", (value, dtype::<f64>(py)));
    let wrong =
        |found: Cow<'_, str>| argument_error(py, argument, format!("expected a 4×4 matrix, found {found}"));
    let array = array.map_err(|_| wrong("something else".into()))?;
    let array = array.cast_into::<PyUntypedArray>()?;
    if array.shape() != [4, 4] {
        return Err(wrong(format!("shape {:?}", array.shape()).into()));
    }
    let rows = rows::<f64, 4>(&array)?;
    let matrix: [[f64; 4]; 4] = std::array::from_fn(|i| rows.get()[i]);
    if let Some(bad) = matrix.iter().flatten().find(|v| !v.is_finite()) {
        return Err(argument_error(py, argument, format!("every entry must be finite, found {bad}")));
    }
    Ok(matrix)
}

/// 4×4 matrices of f64 from an (N, 4, 4) array, C-contiguous. What is in them is for others to check.
pub(super) fn matrices(value: &Bound<'_, PyAny>, argument: &'static str) -> PyResult<Vec<[[f64; 4]; 4]>> {
    let py = value.py();
    let array = untyped(value, argument)?;
    if array.ndim() != 3 || array.shape()[1..] != [4, 4] {
        let message = format!("expected shape (N, 4, 4), found {:?}", array.shape());
        return Err(argument_error(py, argument, message));
    }
    let array = value.extract::<PyReadonlyArrayDyn<'_, f64>>();
    let array = array.map_err(|_| dtype_error(py, argument, "expected float64"))?;
    let numbers = array.as_slice().map_err(|_| dtype_error(py, argument, "expected a contiguous array"))?;
    Ok(bytemuck::cast_slice::<f64, [[f64; 4]; 4]>(numbers).to_vec())
}
