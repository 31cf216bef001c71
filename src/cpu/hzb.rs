//! The depth pyramid: the depth key of every pixel, and for every square of 2, 4, 8, … pixels the farthest in it.
//!
//! Squares are aligned to multiples of their size, and the last row and column of a level may hang over the
//! picture's edge, where no pixel is. So it is conservative for pictures of any size, odd ones included: a
//! texel never stands for pixels outside its square and leaves none out.

use std::ops::Range;

use rayon::prelude::*;

use super::visibility::Pixel;
use crate::limits::{PYRAMID_FINER, PYRAMID_REACH};
use crate::views::{Footprint, Occluder};

#[derive(Debug, Default)]
struct Level {
    columns: usize,
    rows: usize,
    keys: Vec<u32>,
}

/// The pyramid of one depth image.
#[derive(Debug, Default)]
pub struct Hzb {
    levels: Vec<Level>,
}

impl Hzb {
    /// Builds the pyramid of a visibility buffer in rows of `width` pixels, reusing its memory. `changed` are the rows that
    /// changed since it was built of the same picture, or all.
    pub fn build<P: Pixel>(&mut self, pixels: &[P], width: usize, mut changed: Range<usize>) {
        let height = pixels.len() / width;
        assert!(pixels.len() == width * height && changed.end <= height);
        let (mut columns, mut rows) = (width, height);
        for depth in 0.. {
            if self.levels.len() == depth {
                self.levels.push(Level::default());
            }
            let (below, rest) = self.levels.split_at_mut(depth);
            let level = &mut rest[0];
            (level.columns, level.rows) = (columns, rows);
            level.keys.resize(columns * rows, 0);
            match below.last() {
                None => copy(&mut level.keys, width, changed.clone(), pixels),
                Some(b) => reduce(&mut level.keys, columns, changed.clone(), &b.keys, b.columns),
            }
            if columns == 1 && rows == 1 {
                self.levels.truncate(depth + 1);
                break;
            }
            (columns, rows) = (columns.div_ceil(2), rows.div_ceil(2));
            changed = changed.start / 2..changed.end.div_ceil(2);
        }
    }

    /// Number of levels; level 0 has the pixels, level 1 squares of 2 × 2.
    pub fn depth(&self) -> usize {
        self.levels.len()
    }

    /// The farthest key in the square of `column`, `row` at `level`.
    pub fn key(&self, level: usize, column: usize, row: usize) -> u32 {
        let l = &self.levels[level];
        l.keys[row * l.columns + column]
    }

    /// The same as far as the texels of one level say.
    fn hides_at(&self, level: usize, footprint: &Footprint) -> bool {
        let [x0, y0, x1, y1] = footprint.rect;
        let l = &self.levels[level];
        let at = |v: u16| usize::from(v >> level);
        (at(y0)..=at(y1)).all(|row| {
            l.keys[row * l.columns + at(x0)..=row * l.columns + at(x1)]
                .iter()
                .all(|&k| footprint.near_key < k)
        })
    }
}

impl Occluder for Hzb {
    /// True when everything drawn so far is nearer than the box on every pixel that the box may touch.
    fn hides(&self, footprint: &Footprint) -> bool {
        let [x0, y0, x1, y1] = footprint.rect;
        let mut level = 0;
        while level + 1 < self.levels.len()
            && ((x1 >> level) - (x0 >> level) >= PYRAMID_REACH
                || (y1 >> level) - (y0 >> level) >= PYRAMID_REACH)
        {
            level += 1;
        }
        // What is seen is mostly seen in the middle: a look there saves most boxes all others.
        let finer = level.saturating_sub(PYRAMID_FINER);
        let middle = |a: u16, b: u16| ((usize::from(a) + usize::from(b)) / 2) >> finer;
        if footprint.near_key >= self.key(finer, middle(x0, x1), middle(y0, y1)) {
            return false;
        }
        self.hides_at(level, footprint) || (level > 0 && self.hides_at(finer, footprint))
    }
}

/// The keys of some rows of pixels.
fn copy<P: Pixel>(out: &mut [u32], width: usize, rows: Range<usize>, from: &[P]) {
    let copy_row = |row: usize, out: &mut [u32]| {
        out.iter_mut().zip(&from[row * width..]).for_each(|(key, pixel)| *key = pixel.key());
    };
    fill(out, width, rows, copy_row);
}

/// Minimum over 2 × 2 blocks, of some rows of them; a block over the edge has fewer entries.
fn reduce(out: &mut [u32], columns: usize, rows: Range<usize>, from: &[u32], width: usize) {
    let reduce_row = |row: usize, out: &mut [u32]| {
        let upper = &from[2 * row * width..][..width];
        let lower = from.get((2 * row + 1) * width..(2 * row + 2) * width).unwrap_or(upper);
        for (column, texel) in out.iter_mut().enumerate() {
            let (a, b) = (2 * column, (2 * column + 1).min(width - 1));
            *texel = upper[a].min(upper[b]).min(lower[a]).min(lower[b]);
        }
    };
    fill(out, columns, rows, reduce_row);
}

/// Has some rows of a level made, each by its number.
fn fill(out: &mut [u32], columns: usize, rows: Range<usize>, make: impl Fn(usize, &mut [u32]) + Sync) {
    let out = &mut out[rows.start * columns..rows.end * columns];
    if out.len() < 1 << 13 {
        out.chunks_mut(columns).zip(rows).for_each(|(out, row)| make(row, out));
    } else {
        out.par_chunks_mut(columns).zip(rows).with_min_len(8).for_each(|(out, row)| make(row, out));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(seed: &mut u64) -> u64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        *seed >> 33
    }

    #[test]
    fn every_texel_is_the_minimum_of_its_square_for_any_size() {
        let mut seed = 1;
        for (width, height) in [(1, 1), (1, 7), (2, 1), (3, 3), (17, 5), (64, 64), (127, 65), (255, 3)] {
            let words: Vec<u64> = (0..width * height).map(|_| random(&mut seed) << 32 | 7).collect();
            let mut hzb = Hzb::default();
            hzb.build(&[5u64], 1, 0..1);
            hzb.build(&words, width, 0..height);
            for level in 0..hzb.depth() {
                let side = 1usize << level;
                for row in 0..height.div_ceil(side) {
                    for column in 0..width.div_ceil(side) {
                        let expected = (row * side..height.min((row + 1) * side))
                            .flat_map(|y| {
                                (column * side..width.min((column + 1) * side)).map(move |x| (x, y))
                            })
                            .map(|(x, y)| (words[y * width + x] >> 32) as u32)
                            .min();
                        assert_eq!(Some(hzb.key(level, column, row)), expected);
                    }
                }
            }
            assert_eq!(hzb.levels.last().map(|l| l.keys.len()), Some(1));
        }
    }

    #[test]
    fn where_some_rows_changed_the_rest_stays() {
        let mut seed = 3;
        for (width, height) in [(1, 1), (3, 7), (64, 64), (127, 65)] {
            let mut words: Vec<u64> = (0..width * height).map(|_| random(&mut seed) << 32).collect();
            let (mut part, mut whole) = (Hzb::default(), Hzb::default());
            part.build(&words, width, 0..height);
            for _ in 0..20 {
                let start = random(&mut seed) as usize % height;
                let end = start + random(&mut seed) as usize % (height + 1 - start);
                words[start * width..end * width].iter_mut().for_each(|word| *word = random(&mut seed) << 32);
                part.build(&words, width, start..end);
                whole.build(&words, width, 0..height);
                let keys = |hzb: &Hzb| hzb.levels.iter().map(|level| level.keys.clone()).collect::<Vec<_>>();
                assert_eq!(keys(&part), keys(&whole));
            }
        }
    }

    #[test]
    fn hides_only_what_is_farther_than_every_pixel_of_the_rectangle() {
        let mut seed = 2;
        let (width, height) = (101, 67);
        let words: Vec<u64> = (0..width * height).map(|_| (random(&mut seed) % 1000) << 32 | 1).collect();
        let mut hzb = Hzb::default();
        hzb.build(&words, width, 0..height);
        let mut hidden = 0;
        for _ in 0..20_000 {
            let x0 = random(&mut seed) as usize % width;
            let y0 = random(&mut seed) as usize % height;
            let x1 = (x0 + random(&mut seed) as usize % 4).min(width - 1);
            let y1 = (y0 + random(&mut seed) as usize % 4).min(height - 1);
            let near_key = random(&mut seed) as u32 % 200;
            let rect = [x0, y0, x1, y1].map(|v| v as u16);
            let footprint = Footprint { rect, near_key, span: 1, clipped: false };
            if hzb.hides(&footprint) {
                hidden += 1;
                for y in y0..=y1 {
                    for x in x0..=x1 {
                        assert!(words[y * width + x] >> 32 > u64::from(near_key));
                    }
                }
            }
        }
        assert!(hidden > 500, "the test must test something: {hidden}");
    }
}
