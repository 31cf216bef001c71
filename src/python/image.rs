//! `_core.Image`: pictures from Python.

use std::sync::Arc;

use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::errors::to_python;
use crate::scene::image::{self, Pixels};

/// An image with its levels. See `nanite_rs.Image`.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct Image {
    pub(super) inner: Arc<image::Image>,
}

/// (H, W, C) pixels of one of the types.
#[derive(FromPyObject)]
enum Array<'py> {
    Bytes(PyReadonlyArray3<'py, u8>),
    Words(PyReadonlyArray3<'py, u16>),
    Floats(PyReadonlyArray3<'py, f32>),
}

#[pymethods]
impl Image {
    #[new]
    fn new(py: Python<'_>, pixels: Array<'_>, srgb: bool) -> PyResult<Self> {
        let (samples, shape) = match &pixels {
            Array::Bytes(array) => (Pixels::Bytes(array.as_slice()?), array.shape()),
            Array::Words(array) => (Pixels::Words(array.as_slice()?), array.shape()),
            Array::Floats(array) => (Pixels::Floats(array.as_slice()?), array.shape()),
        };
        let side = |k: usize| u32::try_from(shape[k]).unwrap_or(u32::MAX);
        let (width, height, channels) = (side(1), side(0), shape[2]);
        let made = py.detach(|| image::Image::new(samples, width, height, channels, srgb));
        Ok(Self { inner: Arc::new(made.map_err(|error| to_python(py, error))?) })
    }

    /// Width and height of each level.
    #[getter]
    fn sizes(&self) -> Vec<(u32, u32)> {
        (0..self.inner.levels()).map(|level| self.inner.size(level).into()).collect()
    }
}
