//! Cells: a grid over the mesh in Morton order, and the blocks of cells that hold about as many triangles.

use std::ops::Range;

use crate::math::Aabb;

/// Cells along each axis are 2 to this power.
const BITS: u32 = 7;

/// A grid of cells over a box.
#[derive(Clone, Copy, Debug)]
pub struct Cells {
    low: [f64; 3],
    per_unit: f64,
}

impl Cells {
    /// Over a box, shifted by a part of it: what is a border in one grid is none in another.
    pub fn new(bounds: &Aabb, shift: f64) -> Self {
        let side = (0..3).map(|k| f64::from(bounds.max[k]) - f64::from(bounds.min[k])).fold(0.0, f64::max);
        let side = if side > 0.0 { side } else { 1.0 };
        Self {
            low: std::array::from_fn(|k| f64::from(bounds.min[k]) - shift * side),
            // Rounding puts nothing beyond the last cell: see `of`.
            per_unit: f64::from(1u32 << BITS) / (side * (1.0 + shift)),
        }
    }

    /// Their number.
    pub const COUNT: usize = 1 << (3 * BITS);

    /// The number of the cell of a point.
    pub fn of(&self, p: [f64; 3]) -> u32 {
        let last = f64::from((1u32 << BITS) - 1);
        let spread = |x: u32| (0..BITS).fold(0, |out, bit| out | (x >> bit & 1) << (3 * bit));
        let along = |k: usize| ((p[k] - self.low[k]) * self.per_unit).clamp(0.0, last) as u32;
        spread(along(0)) << 2 | spread(along(1)) << 1 | spread(along(2))
    }
}

/// Which block each cell is part of.
#[derive(Clone, Debug)]
pub struct Blocks {
    of_cell: Vec<u32>,
    /// Their number.
    pub count: usize,
}

/// A block is made of cubes of cells with at most one in so many of its triangles.
const CUBES: u64 = 8;

impl Blocks {
    /// Blocks of neighbouring cells with at most `most` triangles, or one cell; `counts` has those of each cell. They are as few
    /// as that allows, and about as large as each other, so that workers end together.
    pub fn new(counts: &[u64], most: u64) -> Self {
        let mut sums = Vec::with_capacity(counts.len() + 1);
        sums.push(0);
        counts.iter().for_each(|count| sums.push(sums[sums.len() - 1] + count));
        let total = sums[counts.len()];
        // A cube goes where its middle is: a block may have half of one more at both of its ends.
        let room = if total > most { (most - most / (CUBES + 1)).max(1) } else { total.max(1) };
        let fair = total.div_ceil(total.div_ceil(room).max(1)).max(1);
        let mut cubes = Vec::new();
        split(&sums, 0..counts.len(), if total > most { (fair / CUBES).max(1) } else { most }, &mut cubes);
        let mut blocks = Self { of_cell: vec![0; counts.len()], count: 0 };
        let mut last = None;
        for cube in cubes {
            // Neighbours in Morton order.
            let place = (sums[cube.start] + sums[cube.end]) / 2 / fair;
            if last != Some(place) {
                blocks.count += 1;
                last = Some(place);
            }
            blocks.of_cell[cube].fill(blocks.count as u32 - 1);
        }
        blocks
    }

    /// The block of a cell.
    pub fn of(&self, cell: u32) -> u32 {
        self.of_cell[cell as usize]
    }
}

/// The largest cubes of cells with at most so many triangles.
fn split(sums: &[u64], cells: Range<usize>, most: u64, out: &mut Vec<Range<usize>>) {
    let count = sums[cells.end] - sums[cells.start];
    if count == 0 {
        return;
    }
    let part = cells.len() / 8;
    if count <= most || part == 0 {
        out.push(cells);
        return;
    }
    (0..8).for_each(|k| split(sums, cells.start + k * part..cells.start + (k + 1) * part, most, out));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_hold_neighbours_up_to_their_most() {
        let mut counts = vec![0; Cells::COUNT];
        (0..1000).for_each(|i| counts[i * 977 % Cells::COUNT] += 1 + (i % 7) as u64);
        let total: u64 = counts.iter().sum();
        let blocks = Blocks::new(&counts, 500);
        let mut held = vec![0; blocks.count];
        counts.iter().zip(&blocks.of_cell).for_each(|(count, block)| held[*block as usize] += count);
        assert_eq!(held.iter().sum::<u64>(), total);
        assert!(held.iter().all(|count| (1..=500).contains(count)), "{held:?}");
        assert!(blocks.count as u64 <= total.div_ceil(500 - 500 / 9), "{held:?}");
        let [least, largest] = [held.iter().min().unwrap(), held.iter().max().unwrap()];
        assert!(4 * least >= 3 * largest, "{held:?}");
        assert_eq!(Blocks::new(&counts, total).count, 1);
    }

    #[test]
    fn cells_cover_the_box_however_it_is_shifted() {
        let bounds = Aabb { min: [-1.0, 0.0, 0.25], max: [1.0, 0.5, 0.25] };
        for shift in [0.0, 0.37] {
            let cells = Cells::new(&bounds, shift);
            for p in [[-1.0, 0.0, 0.25], [1.0, 0.5, 0.25], [1.0, 0.0, 0.25]] {
                assert!((cells.of(p) as usize) < Cells::COUNT);
            }
            assert_ne!(cells.of([-1.0, 0.0, 0.25]), cells.of([1.0, 0.0, 0.25]));
        }
    }
}
