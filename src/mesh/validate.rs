//! What is refused, with the index and the value.

use rayon::prelude::*;

use super::frame::LARGEST_EXPONENT;
use super::source::{Colors, Positions, SourceChannel, SourceMesh};
use crate::error::{Error, Result};

/// Most vertices and most faces: identities are 32-bit and new ones are made at every level.
const MAX_ELEMENTS: usize = 1 << 30;

fn finite<const N: usize, T: Copy + Into<f64> + Sync>(argument: &'static str, rows: &[[T; N]]) -> Result<()> {
    let bad = rows.par_iter().position_first(|row| row.iter().any(|x| !(*x).into().is_finite()));
    match bad {
        Some(index) => Err(Error::NonFinite {
            argument: argument.into(),
            index,
            value: rows[index].map(Into::into).to_vec(),
        }),
        None => Ok(()),
    }
}

/// Simplification may place vertices a little outside, and lengths and errors between coordinates must not overflow.
fn representable<T: Copy + Into<f64> + Sync>(rows: &[[T; 3]], exponent: i32) -> Result<()> {
    let most = 2f64.powi(exponent);
    match rows.par_iter().position_first(|row| row.iter().any(|x| (*x).into().abs() > most)) {
        Some(i) => {
            let row = rows[i].map(Into::into);
            Err(Error::TooLarge(format!("vertices[{i}] is {row:?}; at most 2^{exponent} is supported")))
        }
        None => Ok(()),
    }
}

fn same_length(argument: &'static str, found: usize, vertices: usize) -> Result<()> {
    if found == vertices {
        return Ok(());
    }
    Err(Error::argument(argument, format!("expected one row per vertex ({vertices}), found {found}")))
}

/// Checks sizes, indices and finiteness of everything. Later stages rely on it.
pub fn validate(source: &SourceMesh<'_>) -> Result<()> {
    let vertices = source.positions.len();
    if source.faces.is_empty() {
        return Err(Error::EmptyMesh("faces has no rows".into()));
    }
    if vertices == 0 {
        return Err(Error::EmptyMesh("vertices has no rows".into()));
    }
    if vertices > MAX_ELEMENTS || source.faces.len() > MAX_ELEMENTS {
        return Err(Error::TooLarge(format!(
            "{vertices} vertices and {} faces; at most {MAX_ELEMENTS} of each are supported",
            source.faces.len()
        )));
    }
    let bad = source.faces.par_iter().position_first(|f| f.iter().any(|v| *v as usize >= vertices));
    if let Some(face) = bad {
        let index = source.faces[face].iter().find(|v| **v as usize >= vertices).copied().unwrap_or_default();
        return Err(Error::IndexOutOfRange { face, index: i64::from(index), vertices });
    }
    match source.positions {
        Positions::F32(p) => {
            finite("vertices", p)?;
            representable(p, f32::MAX_EXP - 1)?;
        }
        Positions::F64(p) => {
            finite("vertices", p)?;
            representable(p, LARGEST_EXPONENT)?;
        }
    }
    if let Some(normals) = source.normals {
        same_length("normals", normals.len(), vertices)?;
        finite("normals", normals)?;
    }
    if let Some(colors) = source.colors {
        same_length("colors", colors.len(), vertices)?;
        if let Colors::F32(rows) = colors
            && let Some(row) = rows.iter().position(|row| !row.iter().all(|x| (0.0..=1.0).contains(x)))
        {
            return Err(Error::argument("colors", format!("row {row}: numbers must lie between 0 and 1")));
        }
    }
    if source.uvs.len() > SourceMesh::MAX_UV_SETS {
        return Err(Error::argument(
            "uvs",
            format!("at most {} sets are supported, found {}", SourceMesh::MAX_UV_SETS, source.uvs.len()),
        ));
    }
    for set in &source.uvs {
        same_length("uvs", set.len(), vertices)?;
        finite("uvs", set)?;
    }
    if let Some(materials) = source.materials {
        let (found, faces) = (materials.len(), source.faces.len());
        if found != faces {
            let message = format!("expected one for each of the {faces} faces, found {found}");
            return Err(Error::argument("face_materials", message));
        }
    }
    source.channels.iter().enumerate().try_for_each(|(i, c)| channel(c, &source.channels[..i], vertices))
}

fn channel(channel: &SourceChannel<'_>, others: &[SourceChannel<'_>], vertices: usize) -> Result<()> {
    let info = &channel.info;
    let fail = |message: String| Err(Error::argument("channels", format!("{:?} {message}", info.name)));
    if info.name.is_empty() || others.iter().any(|c| c.info.name == info.name) {
        return fail("names no channel of its own".into());
    }
    let width = info.width();
    if width == 0 || !channel.words.len().is_multiple_of(width) {
        return fail(format!("has {} values in rows of {width}", channel.words.len()));
    }
    let rows = channel.words.len() / width;
    if rows != vertices {
        return fail(format!("has {rows} rows; expected one for each of the {vertices} vertices"));
    }
    let Some(at) = channel.words.par_iter().position_first(|w| !info.dtype.holds(*w)) else { return Ok(()) };
    if info.dtype.is_label() {
        return fail(format!("holds {:#x} in row {}, which its type cannot", channel.words[at], at / width));
    }
    let row = &channel.words[at / width * width..][..width];
    Err(Error::NonFinite {
        argument: format!("channels[{:?}]", info.name).into(),
        index: at / width,
        value: row.iter().map(|w| f64::from(f32::from_bits(*w))).collect(),
    })
}
