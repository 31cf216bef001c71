//! The encoder of Basis Universal, whose textures devices decode to formats of their own.

use basis_universal::encoding::{Compressor, CompressorParams};
use basis_universal::{BasisTextureFormat, ColorSpace};
use numpy::PyReadonlyArray3;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::calls::detached;
use super::errors::argument_error;
use crate::error::Error;
use crate::threads;

/// The largest side of an image: as the encoder has it.
const MOST_TEXELS: usize = 16_384;
/// Of ETC1S, 1 to 255: colours, whose codebooks most images share most of.
const COLOR_QUALITY: u32 = 192;
/// Of UASTC, 0 to 4: normals and the like. The next level takes twice the time.
const DATA_QUALITY: u32 = 0;
/// Of zstd. More saves a hundredth.
const FRAME_LEVEL: i32 = 9;

/// Encodes the levels of an image, each (H, W, 4) of uint8, the sides of each half those of the last, rounded down, but not below
/// one, as a `.basis` file: colours, in sRGB, as ETC1S, all else as UASTC. The same bytes with any number of threads.
#[pyfunction]
pub(super) fn encode_basis<'py>(
    py: Python<'py>,
    levels: Vec<PyReadonlyArray3<'py, u8>>,
    color: bool,
) -> PyResult<Bound<'py, PyBytes>> {
    let wrong = |message: String| argument_error(py, "levels", message);
    let Some(first) = levels.first() else {
        return Err(wrong("expected a level at least, found none".into()));
    };
    let (height, width, _) = first.as_array().dim();
    if !(1..=MOST_TEXELS).contains(&width) || !(1..=MOST_TEXELS).contains(&height) {
        return Err(wrong(format!("expected 1 to {MOST_TEXELS} texels a side, found ({height}, {width})")));
    }
    let mut images = Vec::new();
    for (k, level) in levels.iter().enumerate() {
        let expected = ((height >> k).max(1), (width >> k).max(1), 4);
        let found = level.as_array().dim();
        if found != expected {
            return Err(wrong(format!("level {k}: expected {expected:?}, found {found:?}")));
        }
        images.push((level.as_slice()?, expected.1 as u32, expected.0 as u32));
    }
    let file = detached(py, || {
        let mut params = CompressorParams::new();
        for (k, (texels, width, height)) in (0..).zip(&images) {
            let mut image = match k {
                0 => params.source_image_mut(0),
                _ => params.source_mipmap_image_mut(0, k - 1),
            };
            image.init(texels, *width, *height, 4);
        }
        if color {
            params.set_basis_format(BasisTextureFormat::ETC1S);
            params.set_etc1s_quality_level(COLOR_QUALITY);
            params.set_color_space(ColorSpace::Srgb);
        } else {
            params.set_basis_format(BasisTextureFormat::UASTC4x4);
            params.set_uastc_quality_level(DATA_QUALITY);
            params.set_color_space(ColorSpace::Linear);
        }
        let mut compressor = Compressor::new(threads::count() as u32);
        // SAFETY: the parameters are within their ranges, and `init` above copied as many texels as there are.
        let done = unsafe { compressor.init(&params) && compressor.process().is_ok() };
        if done {
            Ok(compressor.basis_file().to_vec())
        } else {
            Err(Error::Invariant("Basis Universal cannot encode an image".into()))
        }
    })?;
    Ok(PyBytes::new(py, &file))
}

/// One frame of zstd.
#[pyfunction]
pub(super) fn compressed<'py>(py: Python<'py>, data: &[u8]) -> PyResult<Bound<'py, PyBytes>> {
    let frame = detached(py, || {
        let failed = |error| Error::Invariant(format!("zstd: {error}"));
        zstd::bulk::compress(data, FRAME_LEVEL).map_err(failed)
    })?;
    Ok(PyBytes::new(py, &frame))
}
