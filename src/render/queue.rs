//! What is drawn in which round: nearest first, a growing portion at a time, so that the depth pyramid of one
//! round hides as much as possible of the next.
//!
//! Only keys and rectangles decide, so the order depends on neither threads nor timing.

use crate::cpu::project::{Footprint, Screen};

/// Side, pixels, of the tiles by which the occupied part of the picture is measured.
const TILE: usize = 32;

/// Entries in front-to-back order.
#[derive(Debug)]
pub(super) struct Queue<T> {
    /// Farthest first, so that the nearest are taken from the end.
    entries: Vec<(Footprint, T)>,
    /// Pixels of the next portion.
    budget: u64,
    /// Pixels of all entries together.
    total: u64,
}

impl<T: Copy + Ord> Queue<T> {
    /// Queues entries. When all rectangles together cover less than `worthwhile` times what they occupy, there
    /// is little to hide, and the first portion is everything.
    pub(super) fn new(
        entries: impl Iterator<Item = (Footprint, T)>,
        screen: &Screen,
        worthwhile: f64,
    ) -> Self {
        let mut entries: Vec<(Footprint, T)> = entries.collect();
        let columns = (screen.width as usize).div_ceil(TILE);
        let mut tiles = vec![false; columns * (screen.height as usize).div_ceil(TILE)];
        let mut total = 0;
        for (footprint, _) in &entries {
            total += footprint.area();
            if footprint.near_key == u32::MAX {
                continue;
            }
            let [x0, y0, x1, y1] = footprint.rect.map(|v| usize::from(v) / TILE);
            for y in y0..=y1 {
                tiles[y * columns + x0..=y * columns + x1].fill(true);
            }
        }
        let occupied = (tiles.iter().filter(|t| **t).count() * TILE * TILE) as u64;
        let pays = occupied > 0 && total as f64 >= worthwhile * occupied as f64;
        if pays {
            entries.sort_unstable_by_key(|(f, entry)| (f.near_key, std::cmp::Reverse(*entry)));
        }
        Self { entries, budget: if pays { occupied } else { u64::MAX }, total }
    }

    /// True when all was taken.
    pub(super) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Takes the nearest entries that together could cover the budget, in ascending order, and doubles the
    /// budget. A rest of less than a budget comes along.
    pub(super) fn take(&mut self) -> Vec<T> {
        let mut sum = 0;
        let mut keep = self.entries.len();
        while keep > 0 && (sum < self.budget || self.total < self.budget) {
            keep -= 1;
            let area = self.entries[keep].0.area();
            sum += area;
            self.total -= area;
        }
        self.budget = self.budget.saturating_mul(2);
        let mut taken: Vec<T> = self.entries.drain(keep..).map(|(_, entry)| entry).collect();
        taken.sort_unstable();
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A fourth of the four tiles around it.
    fn square(x: u16, key: u32) -> Footprint {
        Footprint { rect: [x, 16, x + 31, 47], near_key: key, span: 32, clipped: false }
    }

    #[test]
    fn portions_come_nearest_first_and_double() {
        let screen =
            Screen { width: 64, height: 64, orthographic: false, near: 1.0, far: f32::INFINITY, far_key: 0 };
        // Apart from each other: all at once, in order.
        let mut apart = Queue::new([(square(0, 7), 3), (square(32, 5), 1)].into_iter(), &screen, 1.5);
        assert_eq!(apart.take(), [1, 3]);
        assert!(apart.is_empty());
        // A pile of 15 where 4 fill the occupied tiles: 4, then 8, then the rest.
        let pile = (0..15).map(|i| (square(16, 100 - i), i));
        let mut pile = Queue::new(pile, &screen, 1.5);
        assert_eq!(pile.take(), [0, 1, 2, 3]);
        assert_eq!(pile.take(), (4..15).collect::<Vec<_>>());
        assert!(pile.is_empty() && pile.take().is_empty());
        let mut tower = Queue::new((0..60).map(|i| (square(16, 100 - i), i)), &screen, 1.5);
        assert_eq!([tower.take().len(), tower.take().len(), tower.take().len()], [4, 8, 16]);
    }
}
