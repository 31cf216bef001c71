//! What a light sees through the texels of a page.

use std::sync::OnceLock;

use crate::limits::{
    SHADOW_PAGE_SIDE, SHADOW_PAGE_TEXELS, SHADOW_SLOT_WORDS, SHADOW_TILE_SIDE, SHADOW_TILES,
};

/// Tiles of a page on a side.
pub const TILES_ACROSS: usize = (SHADOW_PAGE_SIDE / SHADOW_TILE_SIDE) as usize;

/// The depths of a page.
#[derive(Debug)]
pub struct ShadowPage {
    /// Keys of depth, larger is nearer to the light; 0 where it sees nothing.
    keys: Box<[u32]>,
    /// Triangles of the light's cut that were drawn.
    triangles: u32,
    /// The least and the largest key of each tile, then of all, for lights that have a size.
    tiles: OnceLock<Box<[[u32; 2]]>>,
}

impl ShadowPage {
    /// Of all its keys, row by row, and how many triangles were drawn.
    pub fn new(keys: Vec<u32>, triangles: u32) -> Self {
        debug_assert_eq!(keys.len(), SHADOW_PAGE_TEXELS);
        Self { keys: keys.into(), triangles, tiles: OnceLock::new() }
    }

    /// Triangles of the light's cut that were drawn: those of clusters that may touch it and that others do not hide.
    pub fn triangles(&self) -> u32 {
        self.triangles
    }

    /// All keys, row by row.
    pub fn keys(&self) -> &[u32] {
        &self.keys
    }

    /// The least and the largest key in tiles that cover a rectangle of texels: left, top, right and bottom, the last ones
    /// included.
    pub fn range(&self, [x0, y0, x1, y1]: [u32; 4]) -> [u32; 2] {
        let tiles = self.tiles.get_or_init(|| self.tiles());
        let [x0, y0, x1, y1] = [x0, y0, x1, y1].map(|v| (v / SHADOW_TILE_SIDE) as usize);
        let rows = (y0..=y1).flat_map(|y| &tiles[y * TILES_ACROSS + x0..=y * TILES_ACROSS + x1]);
        rows.fold([u32::MAX, 0], |[low, high], tile| [low.min(tile[0]), high.max(tile[1])])
    }

    /// The least and the largest key.
    pub fn whole(&self) -> [u32; 2] {
        self.tiles.get_or_init(|| self.tiles())[SHADOW_TILES]
    }

    /// As it lies in the pool of a device: [`SHADOW_SLOT_WORDS`].
    pub fn words(&self) -> Vec<u32> {
        let mut words = self.keys.to_vec();
        words.extend(self.tiles.get_or_init(|| self.tiles()).as_flattened());
        words.resize(SHADOW_SLOT_WORDS, 0);
        words
    }

    fn tiles(&self) -> Box<[[u32; 2]]> {
        let mut tiles = vec![[u32::MAX, 0]; SHADOW_TILES];
        let side = SHADOW_TILE_SIDE as usize;
        for (y, row) in self.keys.chunks_exact(SHADOW_PAGE_SIDE as usize).enumerate() {
            for (tile, part) in tiles[y / side * TILES_ACROSS..].iter_mut().zip(row.chunks_exact(side)) {
                for key in part {
                    *tile = [tile[0].min(*key), tile[1].max(*key)];
                }
            }
        }
        tiles.push(tiles.iter().fold([u32::MAX, 0], |all, tile| [all[0].min(tile[0]), all[1].max(tile[1])]));
        tiles.into()
    }
}
