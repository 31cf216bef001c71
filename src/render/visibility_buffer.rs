//! What a frame keeps of its picture. The memory of frames that are gone is used again.

use std::sync::Arc;
#[cfg(feature = "gpu")]
use std::sync::OnceLock;

use super::stats::FrameStats;
use crate::cpu::output;
use crate::cpu::visibility::covered;
use crate::error::{Error, Result};
#[cfg(feature = "gpu")]
use crate::gpu;
use crate::stages::Stage;
use crate::threads::Lock;
use crate::views::{InstanceView, Screen};

/// The pixels of a frame, row by row from the top.
#[derive(Debug)]
pub(super) enum VisibilityBuffer {
    /// The visibility buffer, which everything else can be made of.
    Words(Vec<u64>),
    /// Depth and nothing else; the bits of keys until [`VisibilityBuffer::measure`].
    Depth(Vec<f32>),
    /// The visibility buffer on a device, and here once it was read.
    #[cfg(feature = "gpu")]
    OnDevice(gpu::DeviceVisibility, OnceLock<Vec<u64>>),
    /// The keys of depth alone on a device, and the depth here once it was read.
    #[cfg(feature = "gpu")]
    DepthOnDevice(gpu::DeviceVisibility, OnceLock<Vec<f32>>),
}

impl VisibilityBuffer {
    /// Whether a device has it, and nobody else.
    pub(super) fn is_on_device(&self) -> bool {
        match self {
            #[cfg(feature = "gpu")]
            Self::OnDevice(_, words) => words.get().is_none(),
            #[cfg(feature = "gpu")]
            Self::DepthOnDevice(_, depth) => depth.get().is_none(),
            _ => false,
        }
    }

    /// The visibility buffer; an error where `what` is to be made of it and it is not there.
    pub(super) fn words(&self, what: &str) -> Result<&[u64]> {
        match self {
            Self::Words(words) => Ok(words),
            #[cfg(feature = "gpu")]
            Self::OnDevice(left, words) => match words.get() {
                Some(words) => Ok(words),
                None => left.read().map(|read| &words.get_or_init(|| read)[..]),
            },
            _ => Err(Error::argument("depth_only", format!("the frame has depth alone, and no {what}"))),
        }
    }

    /// Depth, where there is nothing else.
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables, reason = "keys come from a device alone"))]
    pub(super) fn depth(&self, screen: &Screen) -> Result<Option<&[f32]>> {
        match self {
            Self::Depth(depth) => Ok(Some(depth)),
            #[cfg(feature = "gpu")]
            Self::DepthOnDevice(left, depth) => match depth.get() {
                Some(depth) => Ok(Some(depth)),
                None => {
                    let mut keys: Vec<u32> = left.read()?;
                    output::depth_of_keys(&mut keys, screen);
                    let read = bytemuck::allocation::cast_vec(keys);
                    Ok(Some(depth.get_or_init(|| read)))
                }
            },
            _ => Ok(None),
        }
    }

    /// As a device has it: two halves for each word, the lower one first, or one number. Nothing of what is left there.
    pub(super) fn bits(&mut self) -> &mut [u32] {
        match self {
            Self::Words(words) => bytemuck::cast_slice_mut(words),
            Self::Depth(depth) => bytemuck::cast_slice_mut(depth),
            #[cfg(feature = "gpu")]
            Self::OnDevice(..) | Self::DepthOnDevice(..) => &mut [],
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
            Self::Depth(depth) => covered::<u32>(bytemuck::cast_slice(depth)),
            words => words.words("coverage").map_or(0, covered),
        }
    }
}

/// What frames that are gone leave, whose memory waits to be used again.
#[derive(Clone, Debug, Default)]
pub(super) struct ScratchPool(Arc<Lock<Kept>>);

#[derive(Debug, Default)]
struct Kept {
    pictures: Vec<VisibilityBuffer>,
    /// Empty ones.
    views: Vec<Vec<InstanceView>>,
}

/// Keeps another, of those given back last.
fn keep<T>(kept: &mut Vec<T>, other: T) {
    if kept.len() == ScratchPool::MOST {
        kept.remove(0);
    }
    kept.push(other);
}

impl ScratchPool {
    /// How many are kept of each: those given back last.
    const MOST: usize = 2;
    const WHAT: &str = "the memory of pictures";

    /// A picture of so many pixels, which may hold anything.
    pub(super) fn take(&self, pixels: usize, depth_only: bool) -> VisibilityBuffer {
        let fits = |picture: &VisibilityBuffer| match picture {
            VisibilityBuffer::Words(words) => !depth_only && words.len() == pixels,
            VisibilityBuffer::Depth(depth) => depth_only && depth.len() == pixels,
            #[cfg(feature = "gpu")]
            VisibilityBuffer::OnDevice(..) | VisibilityBuffer::DepthOnDevice(..) => false,
        };
        let found = self.0.write(Self::WHAT).ok().and_then(|mut kept| {
            let at = kept.pictures.iter().position(fits)?;
            Some(kept.pictures.remove(at))
        });
        found.unwrap_or_else(|| match depth_only {
            true => VisibilityBuffer::Depth(vec![0.0; pixels]),
            false => VisibilityBuffer::Words(vec![0; pixels]),
        })
    }

    /// Takes one back.
    pub(super) fn give(&self, picture: VisibilityBuffer) {
        #[cfg(feature = "gpu")]
        let picture = match picture {
            VisibilityBuffer::OnDevice(_, words) => match words.into_inner() {
                Some(words) => VisibilityBuffer::Words(words),
                None => return,
            },
            VisibilityBuffer::DepthOnDevice(_, depth) => match depth.into_inner() {
                Some(depth) => VisibilityBuffer::Depth(depth),
                None => return,
            },
            here => here,
        };
        if let Ok(mut kept) = self.0.write(Self::WHAT) {
            keep(&mut kept.pictures, picture);
        }
    }

    /// An empty list of views.
    #[cfg(feature = "gpu")]
    pub(super) fn take_views(&self) -> Vec<InstanceView> {
        self.0.write(Self::WHAT).ok().and_then(|mut kept| kept.views.pop()).unwrap_or_default()
    }

    /// Takes one back.
    pub(super) fn give_views(&self, mut views: Vec<InstanceView>) {
        // Of what they hold nothing is kept alive.
        views.clear();
        if let Ok(mut kept) = self.0.write(Self::WHAT) {
            keep(&mut kept.views, views);
        }
    }
}
