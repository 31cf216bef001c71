//! The order in which a frame draws: first what the frame before showed, then nearest first, in batches that grow. So the
//! depth pyramid of one batch occludes as much as possible of the next.
//!
//! Only keys, rectangles and that frame decide. The order depends on neither threads nor timing.

use crate::views::{Footprint, Screen};
use rayon::prelude::*;

/// Side, pixels, of the tiles by which the occupied part of the picture is measured.
const TILE: usize = 32;

/// When entries are deferred.
#[derive(Clone, Copy, Debug)]
pub(super) struct Terms {
    /// Only where their rectangles cover what they occupy more often than this.
    pub(super) overlap: f64,
    /// Pixels that an entry counts for besides its own: what it costs however small it is.
    pub(super) each: u64,
}

/// Entries in front-to-back order.
#[derive(Debug)]
pub(super) struct Queue<T> {
    /// Farthest first, so that the nearest are taken from the end; behind them those that were shown.
    entries: Vec<(Footprint, T)>,
    /// Where the nearest end.
    shown: usize,
    /// Pixels of the next batch.
    budget: u64,
    /// What all entries together count for, pixels.
    total: u64,
    each: u64,
}

impl<T: Copy + Ord + Send> Queue<T> {
    /// Queues entries, each with whether it was shown before: those come with the first batch. When all rectangles
    /// together cover what they occupy no more often than the terms say, little is occluded, and the first batch is
    /// everything.
    pub(super) fn new(
        all: impl Iterator<Item = (Footprint, T, bool)>,
        screen: &Screen,
        Terms { overlap, each }: Terms,
    ) -> Self {
        let columns = (screen.width as usize).div_ceil(TILE);
        let mut tiles = vec![false; columns * (screen.height as usize).div_ceil(TILE)];
        let mut total = 0;
        let (mut entries, mut before) = (Vec::with_capacity(all.size_hint().0), Vec::new());
        for (footprint, entry, shown) in all {
            let list = if shown { &mut before } else { &mut entries };
            list.push((footprint, entry));
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
        let pays = occupied > 0 && total as f64 >= overlap * occupied as f64;
        if !pays {
            entries.append(&mut before);
            return Self { shown: 0, entries, budget: u64::MAX, total, each: 0 };
        }
        entries.par_sort_unstable_by_key(|(f, entry)| (f.near_key, std::cmp::Reverse(*entry)));
        let nearest = entries.len();
        entries.append(&mut before);
        total += each * entries.len() as u64;
        Self { shown: nearest, entries, budget: occupied, total, each }
    }

    /// True when all was taken.
    pub(super) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Takes the nearest entries that together count for the budget, in ascending order, and doubles the
    /// budget. A rest of less than a budget comes along.
    pub(super) fn take(&mut self) -> Vec<T> {
        let mut sum = 0;
        let mut keep = self.entries.len();
        while keep > 0 && (keep > self.shown || sum < self.budget || self.total < self.budget) {
            keep -= 1;
            let pixels = self.entries[keep].0.area() + self.each;
            sum += pixels;
            self.total -= pixels;
        }
        self.shown = self.entries.len();
        self.budget = self.budget.saturating_mul(2);
        let mut taken: Vec<T> = self.entries.drain(keep..).map(|(_, entry)| entry).collect();
        taken.sort_unstable();
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TERMS: Terms = Terms { overlap: 1.5, each: 0 };

    /// A fourth of the four tiles around it.
    fn square(x: u16, key: u32) -> Footprint {
        Footprint { rect: [x, 16, x + 31, 47], near_key: key, span: 32, clipped: false }
    }

    #[test]
    fn batches_come_nearest_first_and_double() {
        let screen =
            Screen { width: 64, height: 64, orthographic: false, near: 1.0, far: f32::INFINITY, far_key: 0 };
        // Apart from each other: all at once, in order.
        let mut apart =
            Queue::new([(square(0, 7), 3, true), (square(32, 5), 1, true)].into_iter(), &screen, TERMS);
        assert_eq!(apart.take(), [1, 3]);
        assert!(apart.is_empty());
        // A pile of 15 where 4 fill the occupied tiles: 4, then 8, then the rest.
        let pile = (0..15).map(|i| (square(16, 100 - i), i, false));
        let mut pile = Queue::new(pile, &screen, TERMS);
        assert_eq!(pile.take(), [0, 1, 2, 3]);
        assert_eq!(pile.take(), (4..15).collect::<Vec<_>>());
        assert!(pile.is_empty() && pile.take().is_empty());
        let tower = |shown: fn(&u32) -> bool| {
            Queue::new((0..60).map(|i| (square(16, 100 - i), i, shown(&i))), &screen, TERMS)
        };
        let mut unknown = tower(|_| false);
        assert_eq!([unknown.take().len(), unknown.take().len(), unknown.take().len()], [4, 8, 16]);
        // However small they are, they count.
        let grains = (0..60).map(|i| (square(16, 100 - i), i, false));
        let mut grains = Queue::new(grains, &screen, Terms { each: 1024, ..TERMS });
        assert_eq!([grains.take().len(), grains.take().len(), grains.take().len()], [2, 4, 8]);
        // What was shown comes first, and the nearest only as far as that leaves room.
        let mut known = tower(|i| [40, 41].contains(i));
        assert_eq!(known.take(), [0, 1, 40, 41]);
        assert_eq!(known.take(), (2..10).collect::<Vec<_>>());
        let mut many = tower(|i| *i >= 50);
        assert_eq!(many.take(), (50..60).collect::<Vec<_>>());
        assert_eq!(many.take(), (0..8).collect::<Vec<_>>());
    }
}
