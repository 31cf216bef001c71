//! The depth pyramids of a view: of this frame and of an earlier one. Whether they pay, and what a frame may start from.

use wgpu::{Buffer, BufferUsages};

use super::context::Context;
use crate::error::Result;
use crate::gpu_types::{QUAD, View};
use crate::limits::{CLUSTER_MAX_TRIANGLES, PYRAMID_LEVELS, SHADOW_GRID_WORDS};

/// What two frames must have in common, so that keys mean the same.
type Constants = [u32; 3];

/// The pyramids of this frame and of an earlier one.
#[derive(Debug)]
pub(super) struct Pyramids {
    size: (u32, u32),
    /// See [`View::pyramid`].
    levels: Vec<[u32; 4]>,
    /// This frame's, and the earlier one's.
    buffers: [Buffer; 2],
    /// Of the frame that the earlier pyramid shows; absent when there is none.
    constants: Option<Constants>,
    /// The view of the frame before.
    last: Option<View>,
    /// The key of the view that last had no earlier frame, see [`View::occluders`].
    occluders: u32,
    /// Triangles of the last frame that had no earlier one, with what it hid.
    whole: u64,
    /// Frames in a row whose pyramid did not pay.
    vain: u32,
    /// Frames to draw without pyramids, and how many it will be when they do not pay again.
    pause: u32,
    next_pause: u32,
}

/// A pyramid pays where it leaves out a triangle for so many pixels.
const PIXELS_PER_TRIANGLE: u64 = 4;
/// Frames in a row that it may fail to, as the first ones after a cut do.
const MOST_VAIN: u32 = 3;
/// Frames to draw without, at most, before trying again.
const LONGEST_PAUSE: u32 = 64;

/// Levels of the pyramid of a picture; level 0 has its pixels, and no keys where those of all levels would be more than
/// `most`.
fn levels(size: (u32, u32), most: u64) -> Vec<[u32; 4]> {
    let all = levels_from(0, size);
    if keys(&all) <= most { all } else { levels_from(1, size) }
}

/// The same, with keys from a level on.
fn levels_from(least: usize, (mut columns, mut rows): (u32, u32)) -> Vec<[u32; 4]> {
    let mut first = 0;
    let mut out = Vec::new();
    while columns > 0 {
        let stride = if out.len() < least { 0 } else { columns.next_multiple_of(QUAD) };
        out.push([columns, rows, first, stride]);
        if columns == 1 && rows == 1 {
            break;
        }
        first += stride * rows;
        (columns, rows) = (columns.div_ceil(2), rows.div_ceil(2));
    }
    out
}

/// Keys of some levels.
fn keys(levels: &[[u32; 4]]) -> u64 {
    levels.iter().map(|[_, rows, _, stride]| u64::from(*stride) * u64::from(*rows)).sum()
}

fn constants(view: &View) -> Constants {
    [view.orthographic, view.near.to_bits(), view.far.to_bits()]
}

/// Cosine of the largest turn from frame to frame after which most of what was drawn is still on the picture.
const MOST_TURN: f32 = 0.966;
/// The same of how much longer or shorter a focal length may be,
const MOST_ZOOM: f32 = 1.25;
/// and of how far the eye may move, as a part of the distance of the nearest things that hide others.
const MOST_WAY: f32 = 0.5;

/// Whether a view shows much the same as that of the frame before.
fn alike(last: &View, view: &View) -> bool {
    let dot = |k: usize| (0..3).map(|j| last.rotate[k][j] * view.rotate[k][j]).sum::<f32>();
    // The trace of a rotation is 1 + 2 cos.
    let turned = 0.5 * (dot(0) + dot(1) + dot(2) - 1.0);
    let zoom = |k: usize| (view.focal[k] / last.focal[k]).max(last.focal[k] / view.focal[k]);
    let way = |k: usize| (view.rotate[k][3] - last.rotate[k][3]) + (view.low[k] - last.low[k]);
    let way = (0..3).map(|k| way(k) * way(k)).sum::<f32>().sqrt();
    let distance = match (view.occluders, view.orthographic) {
        (0, _) => f32::INFINITY,
        (key, 0) => view.near / f32::from_bits(key),
        (key, _) => f32::from_bits(!key),
    };
    turned >= MOST_TURN && zoom(0).max(zoom(1)) <= MOST_ZOOM && way <= MOST_WAY * distance
}

impl Pyramids {
    /// For pictures of a size; none for (0, 0).
    pub(super) fn new(context: &Context, size: (u32, u32)) -> Result<Self> {
        let key = size_of::<u32>() as u64;
        let levels = levels(size, context.largest_array() / key);
        let bytes = key * keys(&levels);
        let buffer = || context.buffer("the depth pyramid", bytes, BufferUsages::STORAGE);
        Ok(Self {
            size,
            levels,
            buffers: [buffer()?, buffer()?],
            constants: None,
            last: None,
            occluders: 0,
            whole: 0,
            vain: 0,
            pause: 0,
            next_pause: 1,
        })
    }

    /// In place of an earlier one, room for the grid of a block of shadow pages.
    pub(super) fn of_pages(context: &Context) -> Result<Self> {
        let none = Self::new(context, (0, 0))?;
        let bytes = (size_of::<u32>() * SHADOW_GRID_WORDS) as u64;
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let [own, _] = none.buffers;
        let grid = context.buffer("grids of shadow pages", bytes, usage)?;
        Ok(Self { buffers: [own, grid], ..none })
    }

    /// Pixels across and down.
    pub(super) fn size(&self) -> (u32, u32) {
        self.size
    }

    /// The one that this frame builds.
    pub(super) fn own(&self) -> &Buffer {
        &self.buffers[0]
    }

    /// The one of an earlier frame.
    pub(super) fn earlier(&self) -> &Buffer {
        &self.buffers[1]
    }

    /// Whether frames are drawn without pyramids for a while, because these did not pay.
    pub(super) fn paused(&self) -> bool {
        self.pause > 0
    }

    /// Takes in that a frame was drawn without.
    pub(super) fn wait(&mut self) {
        self.pause -= 1;
    }

    /// Whether the pyramid of an earlier frame is there for a view, or frames are drawn without.
    pub(super) fn starts(&self, view: &View) -> bool {
        let known = self.size == (view.width, view.height) && self.constants == Some(constants(view));
        !known && !self.paused()
    }

    /// Tells the view of a frame what is known of an earlier one; whether there is a pyramid of it, and whether the frame
    /// before showed much the same.
    pub(super) fn recall(&mut self, view: &mut View) -> (bool, bool) {
        let mut table = [[0; 4]; PYRAMID_LEVELS];
        table[..self.levels.len()].copy_from_slice(&self.levels);
        (view.pyramid, view.levels) = (table, self.levels.len() as u32);
        let known = self.constants == Some(constants(view));
        if !known {
            self.occluders = view.occluders;
        }
        view.occluders = self.occluders;
        (known, self.last.is_some_and(|last| alike(&last, view)))
    }

    /// Takes in that a frame of so many triangles was drawn and so many clusters hidden at least, which built a pyramid or
    /// did not need one.
    pub(super) fn remember(&mut self, view: &View, triangles: u64, hidden: u64, built: bool) {
        let pixels = u64::from(view.width) * u64::from(view.height);
        self.last = Some(*view);
        if view.history == 0 {
            self.whole = triangles + hidden * CLUSTER_MAX_TRIANGLES as u64;
        } else if PIXELS_PER_TRIANGLE * self.whole.saturating_sub(triangles) < pixels {
            self.vain += 1;
        } else {
            (self.vain, self.next_pause) = (0, 1);
        }
        if self.vain > MOST_VAIN {
            (self.vain, self.pause, self.constants) = (0, self.next_pause, None);
            self.next_pause = (2 * self.next_pause).min(LONGEST_PAUSE);
            return;
        }
        self.constants = built.then(|| constants(view));
        if built {
            self.buffers.swap(0, 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::MAX_VIEWPORT;

    #[test]
    fn levels_halve_down_to_one_texel() {
        let all = |size| levels(size, u64::MAX);
        assert_eq!(all((0, 0)), Vec::<[u32; 4]>::new());
        assert_eq!(all((1, 1)), [[1, 1, 0, 4]]);
        let nine = [[9, 3, 0, 12], [5, 2, 36, 8], [3, 1, 52, 4], [2, 1, 56, 4], [1, 1, 60, 4]];
        assert_eq!(all((9, 3)), nine);
        assert!(all((MAX_VIEWPORT, MAX_VIEWPORT)).len() <= PYRAMID_LEVELS);
        // Too large for keys of all pixels.
        assert_eq!((keys(&nine), levels((9, 3), 64)), (64, nine.to_vec()));
        let without = [[9, 3, 0, 0], [5, 2, 0, 8], [3, 1, 16, 4], [2, 1, 20, 4], [1, 1, 24, 4]];
        assert_eq!(levels((9, 3), 63), without);
    }
}
