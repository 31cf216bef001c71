//! Height maps, and how far one is from a linear function over a triangle of it.
//!
//! A map is continuous: values of texels, blended bilinearly between texel centres. In a cell, the square between four
//! centres, the difference h − l to a linear function l is bilinear. Along some direction it is linear, so over a convex
//! polygon it is largest at the outline; along a straight edge it is quadratic, with the second difference 2 d Δx Δy, so it
//! exceeds its ends by at most a quarter of |d Δx Δy|, with d = h₀₀ − h₁₀ − h₀₁ + h₁₁. Cells inside a triangle have axis-
//! parallel edges: there the corners decide. Cells at its outline are clipped.

use glam::DVec3;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::scene::texture::Wrap;

/// Rows of a footprint that are looked at first are this far apart: what is large is found by a part of the work.
const COARSE_ROWS: i64 = 16;
/// A footprint of more than this many maps is bounded by the smallest and largest texel.
const MOST_REPEATS: f64 = 8.0;

/// Rows of a map from (u, v, 1) with v up.
const UPRIGHT: [[f64; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, -1.0, 1.0]];

/// The row or column of a map of n that stands at k.
fn wrapped(wrap: Wrap, k: i64, n: usize) -> usize {
    let n = n as i64;
    let k = match wrap {
        Wrap::Repeat => k.rem_euclid(n),
        Wrap::Mirror => {
            let k = k.rem_euclid(2 * n);
            k.min(2 * n - 1 - k)
        }
        Wrap::Clamp => k.clamp(0, n - 1),
    };
    k as usize
}

/// Numbers of texels as they lie in memory. Integers stand for 0 to 1.
#[derive(Clone, Copy, Debug)]
pub enum Texels<'a> {
    /// Bytes.
    U8(&'a [u8]),
    /// 16 bits.
    U16(&'a [u16]),
    /// Single precision.
    F32(&'a [f32]),
    /// Double precision.
    F64(&'a [f64]),
}

impl Texels<'_> {
    /// How many numbers there are.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(t) => t.len(),
            Self::U16(t) => t.len(),
            Self::F32(t) => t.len(),
            Self::F64(t) => t.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A number.
    pub fn get(&self, k: usize) -> f64 {
        match self {
            Self::U8(t) => f64::from(t[k]) / 255.0,
            Self::U16(t) => f64::from(t[k]) / 65535.0,
            Self::F32(t) => f64::from(t[k]),
            Self::F64(t) => t[k],
        }
    }
}

/// A map of heights, or of vectors, over the plane.
#[derive(Clone, Copy, Debug)]
pub struct HeightMap<'a> {
    /// Rows from the top, of so many channels.
    pub texels: Texels<'a>,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// What lies beyond the edges along x and y.
    pub wrap: [Wrap; 2],
    /// The map from (u, v, 1) to places on the map in its sides, x right, y down.
    pub rows: [[f64; 3]; 2],
    /// Smallest and largest value of each channel.
    pub range: [[f64; 3]; 2],
}

/// A corner of a footprint: its place in texels, centres at whole numbers, and the value of the linear function there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Corner {
    pub place: [f64; 2],
    pub line: DVec3,
}

/// A convex polygon; a triangle clipped to a cell has seven corners at most.
#[derive(Clone, Copy, Default)]
struct Polygon {
    corners: [Corner; 10],
    len: usize,
}

impl Polygon {
    fn new(corners: &[Corner]) -> Self {
        let mut polygon = Self::default();
        corners.iter().for_each(|c| polygon.push(*c));
        polygon
    }

    fn push(&mut self, corner: Corner) {
        self.corners[self.len] = corner;
        self.len += 1;
    }

    fn get(&self) -> &[Corner] {
        &self.corners[..self.len]
    }

    /// The part where `sign` · place\[axis\] ≥ `sign` · `at`.
    fn clipped(&self, axis: usize, at: f64, sign: f64) -> Self {
        let mut out = Self::default();
        for k in 0..self.len {
            let (a, b) = (self.corners[k], self.corners[(k + 1) % self.len]);
            let (da, db) = (sign * (a.place[axis] - at), sign * (b.place[axis] - at));
            if da >= 0.0 {
                out.push(a);
            }
            if (da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0) {
                // From the corner inside, so that both triangles at an edge round alike.
                let (a, b, da, db) = if da > 0.0 { (a, b, da, db) } else { (b, a, db, da) };
                let t = da / (da - db);
                let mut place = [0, 1].map(|x| a.place[x] + (b.place[x] - a.place[x]) * t);
                place[axis] = at;
                out.push(Corner { place, line: a.line + (b.line - a.line) * t });
            }
        }
        out
    }

    fn extent(&self, axis: usize) -> [f64; 2] {
        self.get().iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[lo, hi], c| {
            [lo.min(c.place[axis]), hi.max(c.place[axis])]
        })
    }

    /// Its section by the line y = `at`: the corners that lie there, leftmost and rightmost.
    fn section(&self, at: f64) -> Option<[Corner; 2]> {
        let on = || self.get().iter().filter(|c| c.place[1] == at);
        let by = |a: &&Corner, b: &&Corner| a.place[0].total_cmp(&b.place[0]);
        Some([*on().min_by(by)?, *on().max_by(by)?])
    }
}

impl<'a> HeightMap<'a> {
    /// A map of these rows and columns; every number must be finite.
    pub fn new(
        texels: Texels<'a>,
        [height, width]: [usize; 2],
        wrap: [Wrap; 2],
        rows: [[f64; 3]; 2],
    ) -> Result<Self> {
        if width * height == 0 || !(texels.len() == width * height || texels.len() == 3 * width * height) {
            return Err(Error::argument("height", "expected (H, W) or (H, W, 3), not empty"));
        }
        let channels = texels.len() / (width * height);
        // The error of the first such row, however many threads look.
        let ranges: Vec<Result<[[f64; 3]; 2]>> = (0..height)
            .into_par_iter()
            .map(|y| {
                let mut range = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
                for k in 0..width * channels {
                    let value = texels.get(y * width * channels + k);
                    if !value.is_finite() {
                        let message = format!("{value} at row {y}, column {}", k / channels);
                        return Err(Error::argument("height", message));
                    }
                    let c = k % channels;
                    range[0][c] = range[0][c].min(value);
                    range[1][c] = range[1][c].max(value);
                }
                Ok(range)
            })
            .collect();
        let mut range = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for row in ranges {
            let [lo, hi] = row?;
            for c in 0..channels {
                (range[0][c], range[1][c]) = (range[0][c].min(lo[c]), range[1][c].max(hi[c]));
            }
        }
        for c in channels..3 {
            (range[0][c], range[1][c]) = (0.0, 0.0);
        }
        Ok(Self { texels, width, height, wrap, rows, range })
    }

    /// 1 of heights, 3 of vectors.
    pub fn channels(&self) -> usize {
        self.texels.len() / (self.width * self.height)
    }

    /// Where (u, v) lies, in texels, centres at whole numbers.
    pub(super) fn place(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let at = |row: [f64; 3], n: usize| (row[0] * u + row[1] * v + row[2]) * n as f64 - 0.5;
        [at(self.rows[0], self.width), at(self.rows[1], self.height)]
    }

    /// How many whole maps lie below (u, v), where that makes no difference.
    pub(super) fn whole(&self, uv: [f64; 2]) -> [f64; 2] {
        let upright = self.rows == UPRIGHT;
        [0, 1].map(|k| if upright && self.wrap[k] == Wrap::Repeat { uv[k].floor() } else { 0.0 })
    }

    fn texel(&self, x: i64, y: i64) -> DVec3 {
        let x = wrapped(self.wrap[0], x, self.width);
        let y = wrapped(self.wrap[1], y, self.height);
        let k = y * self.width + x;
        match self.channels() {
            1 => DVec3::new(self.texels.get(k), 0.0, 0.0),
            _ => DVec3::new(self.texels.get(3 * k), self.texels.get(3 * k + 1), self.texels.get(3 * k + 2)),
        }
    }

    fn cell(&self, i: i64, j: i64) -> [DVec3; 4] {
        [self.texel(i, j), self.texel(i + 1, j), self.texel(i, j + 1), self.texel(i + 1, j + 1)]
    }

    /// The value there; a height is the first of the three.
    pub(super) fn value(&self, place: [f64; 2]) -> DVec3 {
        let [i, j] = place.map(f64::floor);
        bilinear(&self.cell(i as i64, j as i64), place[0] - i, place[1] - j)
    }

    /// Largest |h − line| over a cell's polygon.
    fn in_cell(&self, i: i64, j: i64, polygon: &Polygon) -> f64 {
        let cell = self.cell(i, j);
        let twist = (cell[0] - cell[1] - cell[2] + cell[3]).length();
        let off =
            |c: &Corner| (bilinear(&cell, c.place[0] - i as f64, c.place[1] - j as f64) - c.line).length();
        let corners = polygon.get();
        let Some(mut last) = corners.last() else { return 0.0 };
        let (mut most, mut last_off) = (0.0_f64, off(last));
        for corner in corners {
            let here = off(corner);
            let [dx, dy] = [0, 1].map(|x| corner.place[x] - last.place[x]);
            most = most.max(here.max(last_off) + 0.25 * twist * (dx * dy).abs());
            (last, last_off) = (corner, here);
        }
        most
    }

    /// Largest |h − line| over the row of cells j, which `strip` lies in.
    fn in_row(&self, j: i64, strip: &Polygon, enough: f64) -> f64 {
        let [left, right] = strip.extent(0).map(|x| x.floor() as i64);
        let (top, bottom) = (strip.section(j as f64), strip.section((j + 1) as f64));
        // Cells from `inner.0` up to, not including `inner.1` are inside.
        let inner = match (top, bottom) {
            (Some(a), Some(b)) => {
                let lo = a[0].place[0].max(b[0].place[0]).ceil() as i64;
                let hi = a[1].place[0].min(b[1].place[0]).floor() as i64;
                if hi > lo { (lo, hi) } else { (right + 1, right + 1) }
            }
            _ => (right + 1, right + 1),
        };
        let mut most = 0.0_f64;
        if inner.0 < inner.1 {
            for (y, section) in [(j, top), (j + 1, bottom)] {
                let Some([a, b]) = section else { continue };
                let slope = (b.line - a.line) / (b.place[0] - a.place[0]);
                for x in inner.0..=inner.1 {
                    let line = a.line + slope * (x as f64 - a.place[0]);
                    most = most.max((self.texel(x, y) - line).length());
                }
                if most > enough {
                    return most;
                }
            }
        }
        let mut i = left;
        while i <= right {
            if i == inner.0 {
                i = inner.1;
                continue;
            }
            let part = strip.clipped(0, i as f64, 1.0).clipped(0, (i + 1) as f64, -1.0);
            most = most.max(self.in_cell(i, j, &part));
            if most > enough {
                break;
            }
            i += 1;
        }
        most
    }

    /// Largest |h − line| over a segment or triangle; of what exceeds `enough`, something that does so, too.
    pub(super) fn deviation(&self, corners: &[Corner], enough: f64) -> f64 {
        let whole = Polygon::new(corners);
        let mut spread = DVec3::ZERO;
        for c in corners {
            let [lo, hi] = self.range.map(DVec3::from_array);
            spread = spread.max((hi - c.line).max(c.line - lo));
        }
        let spread = spread.length();
        let (x, y) = (whole.extent(0), whole.extent(1));
        let cells = (x[1] - x[0] + 1.0) * (y[1] - y[0] + 1.0);
        if cells > MOST_REPEATS * (self.width * self.height + (1 << 16)) as f64 {
            return spread;
        }
        let rows = y.map(|y| y.floor() as i64);
        let stride = if rows[1] - rows[0] >= 2 * COARSE_ROWS { COARSE_ROWS } else { 1 };
        let mut most = 0.0_f64;
        for first in 0..stride {
            for j in (rows[0] + first..=rows[1]).step_by(stride as usize) {
                let strip = whole.clipped(1, j as f64, 1.0).clipped(1, (j + 1) as f64, -1.0);
                if strip.len > 0 {
                    most = most.max(self.in_row(j, &strip, enough));
                }
                if most > enough {
                    return most.min(spread);
                }
            }
        }
        most.min(spread)
    }
}

fn bilinear(cell: &[DVec3; 4], x: f64, y: f64) -> DVec3 {
    let top = cell[0] + (cell[1] - cell[0]) * x;
    let bottom = cell[2] + (cell[3] - cell[2]) * x;
    top + (bottom - top) * y
}
