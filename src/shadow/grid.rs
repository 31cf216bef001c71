//! Which pages of a block are drawn.

use super::map::{Block, PageKey};
use crate::limits::{SHADOW_BLOCK_PAGES, SHADOW_CORNERS, SHADOW_GRID_PAGES, SHADOW_GRID_WORDS};

const CORNERS: usize = SHADOW_CORNERS as usize;
const SIDE: usize = SHADOW_BLOCK_PAGES as usize;

/// The pages of a block that are drawn, as a table: for each corner of the grid of pages, row by row, how many of them lie
/// above it and to its left (Crow, "Summed-Area Tables for Texture Mapping", SIGGRAPH 1984). Behind these for each place the
/// number of its page plus one, or 0.
#[derive(Clone, Debug)]
pub struct Grid(Vec<u32>);

impl Grid {
    /// Of the pages of a block, numbered from `first` on.
    pub fn new(block: &Block, pages: &[PageKey], first: u32) -> Self {
        let mut words = vec![0u32; SHADOW_GRID_WORDS];
        for (number, page) in (first + 1..).zip(pages) {
            let [x, y] = block.place(page);
            words[(y + 1) * CORNERS + x + 1] = 1;
            words[SHADOW_GRID_PAGES + y * SIDE + x] = number;
        }
        for y in 1..CORNERS {
            let mut row = 0;
            for x in 1..CORNERS {
                row += words[y * CORNERS + x];
                words[y * CORNERS + x] = row + words[(y - 1) * CORNERS + x];
            }
        }
        Self(words)
    }

    /// Whether any is in these columns and rows: left, top, right and bottom, the last ones included.
    pub fn any(&self, [x0, y0, x1, y1]: [usize; 4]) -> bool {
        let at = |x: usize, y: usize| self.0[y * CORNERS + x];
        at(x1 + 1, y1 + 1) + at(x0, y0) > at(x0, y1 + 1) + at(x1 + 1, y0)
    }

    /// The numbers of the pages there.
    pub fn numbers(&self, [x0, y0, x1, y1]: [usize; 4]) -> impl Iterator<Item = u32> {
        let row =
            move |y: usize| &self.0[SHADOW_GRID_PAGES + y * SIDE + x0..=SHADOW_GRID_PAGES + y * SIDE + x1];
        (y0..=y1).flat_map(row).filter(|number| **number != 0).map(|number| number - 1)
    }

    /// The whole table.
    pub fn words(&self) -> &[u32] {
        &self.0
    }
}
