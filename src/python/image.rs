//! `_core.Image` and `_core.EnvironmentMap`: pictures from Python.

use std::sync::Arc;

use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::calls::detached;
use crate::scene::EnvironmentMap as Map;
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

impl Array<'_> {
    /// The pixels, their columns, rows and channels.
    fn parts(&self) -> PyResult<(Pixels<'_>, u32, u32, usize)> {
        let (pixels, shape) = match self {
            Self::Bytes(array) => (Pixels::Bytes(array.as_slice()?), array.shape()),
            Self::Words(array) => (Pixels::Words(array.as_slice()?), array.shape()),
            Self::Floats(array) => (Pixels::Floats(array.as_slice()?), array.shape()),
        };
        let side = |k: usize| u32::try_from(shape[k]).unwrap_or(u32::MAX);
        Ok((pixels, side(1), side(0), shape[2]))
    }
}

/// A map of the light around. See `nanite_rs.Environment`.
#[pyclass(frozen, module = "nanite_rs._core")]
pub struct EnvironmentMap {
    pub(super) inner: Arc<Map>,
}

#[pymethods]
impl EnvironmentMap {
    #[new]
    fn new(py: Python<'_>, pixels: Array<'_>) -> PyResult<Self> {
        let (pixels, width, height, channels) = pixels.parts()?;
        let made = detached(py, || Map::new(pixels, width, height, channels))?;
        Ok(Self { inner: Arc::new(made) })
    }
}

#[pymethods]
impl Image {
    #[new]
    fn new(py: Python<'_>, pixels: Array<'_>, srgb: bool) -> PyResult<Self> {
        let (pixels, width, height, channels) = pixels.parts()?;
        let made = detached(py, || image::Image::new(pixels, width, height, channels, srgb))?;
        Ok(Self { inner: Arc::new(made) })
    }

    /// Width and height of each level.
    #[getter]
    fn sizes(&self) -> Vec<(u32, u32)> {
        (0..self.inner.levels()).map(|level| self.inner.size(level).into()).collect()
    }
}
