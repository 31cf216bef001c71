//! What casters of a block of pages do not matter: a pyramid over tiles of texels, of the depth behind which nothing is looked
//! up, or behind which something else stands that the light sees first.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::hzb::Hzb;
use crate::limits::{SHADOW_PAGE_SIDE, SHADOW_TILE_SIDE, SHADOW_TILES};
use crate::shadow::page::TILES_ACROSS;
use crate::shadow::{Block, PageKey, ShadowPage};
use crate::views::{Footprint, Occluder};

/// Above all keys of depth, but for that of what is before a light's eye.
pub const UNUSED: u32 = u32::MAX;

/// Of each tile of a page, the key of the farthest depth that is looked up there; [`UNUSED`] where none is.
pub type Walls = FxHashMap<PageKey, Box<[u32; SHADOW_TILES]>>;

/// The pyramid of a block, over the rectangle that its wanted pages are in.
#[derive(Debug)]
pub struct Mask {
    /// Its first column and row of tiles.
    first: [u16; 2],
    /// Its columns and rows.
    size: [u16; 2],
    pyramid: Hzb,
}

impl Mask {
    /// Of pages of a block, `walls` and what the light is known to see in them.
    pub fn new<'a>(
        block: &Block,
        pages: &[PageKey],
        walls: &Walls,
        seen: impl Fn(&PageKey) -> Option<&'a ShadowPage> + Sync,
    ) -> Self {
        let places = || pages.iter().map(|page| block.place(page));
        let bound = |k: usize| {
            let (low, high) =
                places().fold((usize::MAX, 0), |(low, high), place| (low.min(place[k]), high.max(place[k])));
            (low, high + 1 - low)
        };
        let ((left, across), (top, down)) = (bound(0), bound(1));
        let columns = across * TILES_ACROSS;
        let mut keys = vec![UNUSED; columns * down * TILES_ACROSS];
        let cells = |page: &PageKey| {
            let mut cells = walls.get(page).map_or([0; SHADOW_TILES], |wall| **wall);
            if let Some(seen) = seen(page) {
                // All that is before the light's eye has one key, and hides itself no more than others.
                let keys = farthest(seen.keys()).map(|key| key.min(UNUSED - 1));
                cells.iter_mut().zip(keys).for_each(|(cell, key)| *cell = key.max(*cell));
            }
            cells
        };
        let all: Vec<[u32; SHADOW_TILES]> = pages.par_iter().map(cells).collect();
        for (page, cells) in pages.iter().zip(&all) {
            let [x, y] = block.place(page);
            let from = (y - top) * TILES_ACROSS * columns + (x - left) * TILES_ACROSS;
            for (row, cells) in cells.chunks_exact(TILES_ACROSS).enumerate() {
                keys[from + row * columns..][..TILES_ACROSS].copy_from_slice(cells);
            }
        }
        let mut pyramid = Hzb::default();
        pyramid.build(&keys, columns, 0..down * TILES_ACROSS);
        let [first, size] = [[left * TILES_ACROSS, top * TILES_ACROSS], [columns, down * TILES_ACROSS]]
            .map(|v| v.map(|v| v as u16));
        Self { first, size, pyramid }
    }
}

/// The farthest key of each tile of a page.
pub(super) fn farthest(keys: &[u32]) -> [u32; SHADOW_TILES] {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { farthest_avx2(keys) };
    }
    farthest_anywhere(keys)
}

/// The same with 256-bit vectors.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn farthest_avx2(keys: &[u32]) -> [u32; SHADOW_TILES] {
    farthest_anywhere(keys)
}

#[inline(always)]
fn farthest_anywhere(keys: &[u32]) -> [u32; SHADOW_TILES] {
    let (page, tile) = (SHADOW_PAGE_SIDE as usize, SHADOW_TILE_SIDE as usize);
    let mut out = [0; SHADOW_TILES];
    for (rows, out) in keys.chunks_exact(tile * page).zip(out.chunks_exact_mut(TILES_ACROSS)) {
        let mut least = [u32::MAX; SHADOW_PAGE_SIDE as usize];
        for row in rows.chunks_exact(page) {
            least.iter_mut().zip(row).for_each(|(least, key)| *least = (*least).min(*key));
        }
        for (out, least) in out.iter_mut().zip(least.chunks_exact(tile)) {
            *out = least.iter().fold(u32::MAX, |least, key| least.min(*key));
        }
    }
    out
}

impl Occluder for Mask {
    fn hides(&self, footprint: &Footprint) -> bool {
        let [x0, y0, x1, y1] = footprint.rect.map(|v| v / SHADOW_TILE_SIDE as u16);
        let within = |low: u16, high: u16, k: usize| {
            let last = self.first[k] + self.size[k] - 1;
            (low <= last && high >= self.first[k])
                .then(|| [low, high].map(|v| v.clamp(self.first[k], last) - self.first[k]))
        };
        let (Some([x0, x1]), Some([y0, y1])) = (within(x0, x1, 0), within(y0, y1, 1)) else { return true };
        // What is before the light's eye is no nearer than all else.
        let near_key = footprint.near_key.min(UNUSED - 1);
        self.pyramid.hides(&Footprint { rect: [x0, y0, x1, y1], near_key, ..*footprint })
    }
}
