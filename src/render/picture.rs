//! What a frame keeps of its picture. The memory of frames that are gone is used again.

use std::sync::{Arc, Mutex};

use super::stages::Stage;
use super::stats::FrameStats;
use crate::cpu::output;
use crate::cpu::project::Screen;
use crate::cpu::visibility::covered;
use crate::error::{Error, Result};

/// The pixels of a frame, row by row from the top.
#[derive(Debug)]
pub(super) enum Picture {
    /// The visibility buffer, which everything else can be made of.
    Words(Vec<u64>),
    /// Depth and nothing else; the bits of keys until [`Picture::measure`].
    Depth(Vec<f32>),
}

impl Picture {
    fn len(&self) -> usize {
        match self {
            Self::Words(words) => words.len(),
            Self::Depth(depth) => depth.len(),
        }
    }

    fn is_depth(&self) -> bool {
        matches!(self, Self::Depth(_))
    }

    /// The visibility buffer; an error where `what` is to be made of it and it is not there.
    pub(super) fn words(&self, what: &str) -> Result<&[u64]> {
        match self {
            Self::Words(words) => Ok(words),
            Self::Depth(_) => {
                Err(Error::argument("depth_only", format!("the frame has depth alone, and no {what}")))
            }
        }
    }

    /// As a device has it: two halves for each word, the lower one first, or one number.
    pub(super) fn bits(&mut self) -> &mut [u32] {
        match self {
            Self::Words(words) => bytemuck::cast_slice_mut(words),
            Self::Depth(depth) => bytemuck::cast_slice_mut(depth),
        }
    }

    /// Where there is depth alone: from keys to it.
    pub(super) fn measure(&mut self, screen: &Screen, stats: &mut FrameStats) {
        if let Self::Depth(depth) = self {
            let keys: &mut [u32] = bytemuck::cast_slice_mut(depth);
            let pixels = keys.len() as u64;
            stats.time(Stage::Output, 1, || (output::depth_of_keys(keys, screen), pixels, pixels));
        }
    }

    /// How many pixels show anything.
    pub(super) fn covered(&self) -> u64 {
        match self {
            Self::Words(words) => covered(words),
            Self::Depth(depth) => covered::<u32>(bytemuck::cast_slice(depth)),
        }
    }
}

/// Pictures whose memory waits to be used again.
#[derive(Clone, Debug, Default)]
pub(super) struct Spare(Arc<Mutex<Vec<Picture>>>);

impl Spare {
    /// How many are kept: those given back last.
    const MOST: usize = 2;

    /// A picture of so many pixels, which may hold anything.
    pub(super) fn take(&self, pixels: usize, depth_only: bool) -> Picture {
        let fits = |picture: &Picture| picture.len() == pixels && picture.is_depth() == depth_only;
        let found = self.0.lock().ok().and_then(|mut kept| {
            let at = kept.iter().position(fits)?;
            Some(kept.remove(at))
        });
        found.unwrap_or_else(|| match depth_only {
            true => Picture::Depth(vec![0.0; pixels]),
            false => Picture::Words(vec![0; pixels]),
        })
    }

    /// Takes one back.
    pub(super) fn give(&self, picture: Picture) {
        if let Ok(mut kept) = self.0.lock() {
            if kept.len() == Self::MOST {
                kept.remove(0);
            }
            kept.push(picture);
        }
    }
}
