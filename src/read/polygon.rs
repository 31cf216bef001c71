//! Polygons cut into triangles: by clipping ears, so that concave ones are covered once and nothing reaches outside.
//!
//! A polygon with n corners gives n - 2 triangles and every corner stays in use, those on straight sides too: its
//! neighbours may use them. It is looked at along the axis nearest to its normal (Newell's), which changes no coordinate.

use super::fault;
use crate::error::{Error, Result};

/// Triangles of polygons.
#[derive(Debug, Default, PartialEq)]
pub struct Triangles {
    /// Numbers of corners: places in the list of all polygons' corners.
    pub corners: Vec<[u32; 3]>,
    /// The polygon that each comes from.
    pub polygons: Vec<u32>,
    /// Polygons with fewer than three corners, which have none.
    pub without: usize,
}

/// Cuts polygons, each with `counts` of the `corners`, which are numbers of `points`.
pub fn triangulate(points: &[[f64; 3]], corners: &[u32], counts: &[u32]) -> Result<Triangles> {
    if u32::try_from(corners.len()).is_err() {
        return Err(Error::TooLarge(format!("{} corners of faces; 2^32 can be numbered", corners.len())));
    }
    let total = counts.iter().map(|c| (*c as usize).saturating_sub(2)).sum();
    let mut out = Triangles {
        corners: Vec::with_capacity(total),
        polygons: Vec::with_capacity(total),
        without: counts.iter().filter(|c| **c < 3).count(),
    };
    let mut clipper = Clipper::default();
    let mut first = 0;
    for (polygon, &count) in counts.iter().enumerate() {
        let end = first + count as usize;
        let Some(own) = corners.get(first..end) else {
            return Err(fault(format!("face {polygon}"), "it has more corners than are there"));
        };
        if let Some(bad) = own.iter().find(|c| **c as usize >= points.len()) {
            return Err(Error::IndexOutOfRange {
                face: polygon,
                index: i64::from(*bad),
                vertices: points.len(),
            });
        }
        let place = |k: usize| points[own[k] as usize];
        clipper.polygon(own.len(), place, |triangle| {
            out.corners.push(triangle.map(|k| first as u32 + k));
            out.polygons.push(polygon as u32);
        });
        first = end;
    }
    Ok(out)
}

/// Triangles of strips: each row is one strip or, where negative numbers part them, several.
pub fn strips(values: &[i64], lengths: &[u32]) -> Vec<[i64; 3]> {
    let mut out = Vec::with_capacity(values.len());
    let mut rest = values;
    for &length in lengths {
        let (row, after) = rest.split_at((length as usize).min(rest.len()));
        rest = after;
        for strip in row.split(|v| *v < 0) {
            for (k, w) in strip.windows(3).enumerate() {
                out.push(if k % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] });
            }
        }
    }
    out
}

/// Cuts one polygon after the other, keeping its memory.
#[derive(Default)]
pub(super) struct Clipper {
    flat: Vec<[f64; 2]>,
    next: Vec<u32>,
    before: Vec<u32>,
    /// Whether a corner is there and turns right, or not at all.
    hollow: Vec<bool>,
    grid: Grid,
}

/// Hollow corners by where they are.
#[derive(Default)]
struct Grid {
    low: [f64; 2],
    scale: [f64; 2],
    side: usize,
    /// For each cell, row by row, where its corners begin in the list.
    starts: Vec<u32>,
    corners: Vec<u32>,
}

impl Grid {
    fn fill(&mut self, flat: &[[f64; 2]], hollow: &[bool]) {
        let own = || (0..flat.len()).filter(|k| hollow[*k]);
        // A few to a cell; for most polygons one cell is enough.
        self.side = ((own().count() as f64 / 4.0).sqrt() as usize).clamp(1, MOST_CELLS);
        let mut high = [f64::NEG_INFINITY; 2];
        self.low = [f64::INFINITY; 2];
        for axis in 0..2 {
            for k in own() {
                self.low[axis] = self.low[axis].min(flat[k][axis]);
                high[axis] = high[axis].max(flat[k][axis]);
            }
            self.scale[axis] = self.side as f64 / (high[axis] - self.low[axis]);
        }
        self.starts.clear();
        self.starts.resize(self.side * self.side + 1, 0);
        for k in own() {
            let cell = self.cell(flat[k]);
            self.starts[cell + 1] += 1;
        }
        for cell in 1..self.starts.len() {
            self.starts[cell] += self.starts[cell - 1];
        }
        let mut place = self.starts.clone();
        self.corners.clear();
        self.corners.resize(place[place.len() - 1] as usize, 0);
        for k in own() {
            let to = &mut place[self.cell(flat[k])];
            self.corners[*to as usize] = k as u32;
            *to += 1;
        }
    }

    /// Column or row of a coordinate. It grows with it, whatever is rounded.
    fn along(&self, axis: usize, value: f64) -> usize {
        (((value - self.low[axis]) * self.scale[axis]) as usize).min(self.side - 1)
    }

    fn cell(&self, p: [f64; 2]) -> usize {
        self.along(1, p[1]) * self.side + self.along(0, p[0])
    }

    /// Corners of all cells that a box touches.
    fn within(&self, low: [f64; 2], high: [f64; 2]) -> impl Iterator<Item = u32> {
        let first = self.along(0, low[0]);
        // What is no number lies anywhere.
        let last = self.along(0, high[0]).max(first);
        (self.along(1, low[1])..=self.along(1, high[1])).flat_map(move |row| {
            let cells = row * self.side + first..row * self.side + last + 1;
            self.corners[self.starts[cells.start] as usize..self.starts[cells.end] as usize].iter().copied()
        })
    }
}

/// Most cells along a side of the grid.
const MOST_CELLS: usize = 1000;

/// Twice the area of a triangle, positive where it turns left.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

impl Clipper {
    /// Gives the triangles of a polygon, by numbers of its corners.
    pub(super) fn polygon(
        &mut self,
        count: usize,
        place: impl Fn(usize) -> [f64; 3],
        mut give: impl FnMut([u32; 3]),
    ) {
        match count {
            0..=2 => return,
            3 => return give([0, 1, 2]),
            _ => {}
        }
        self.flatten(count, &place);
        let p = &self.flat;
        if count == 4 {
            // Of the two ways the first that is inside, as most programs take it.
            for [a, b] in [[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]] {
                if [a, b].iter().all(|t: &[usize; 3]| turn(p[t[0]], p[t[1]], p[t[2]]) > 0.0) {
                    return [a, b].iter().for_each(|t| give(t.map(|k| k as u32)));
                }
            }
        } else if self.is_convex() {
            return (1..count as u32 - 1).for_each(|k| give([0, k, k + 1]));
        }
        self.clip(&mut give);
    }

    /// Looks along the normal: the corners in a plane, counter-clockwise.
    fn flatten(&mut self, count: usize, place: &impl Fn(usize) -> [f64; 3]) {
        // Relative to a corner, so that far coordinates do not cancel.
        let origin = place(0);
        let at = |k: usize| {
            let p = place(k);
            [p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]]
        };
        let mut normal = [0.0; 3];
        for k in 0..count {
            let (a, b) = (at(k), at((k + 1) % count));
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                normal[axis] += (a[u] - b[u]) * (a[v] + b[v]);
            }
        }
        let axis = (0..3).fold(0, |best, k| if normal[k].abs() > normal[best].abs() { k } else { best });
        let (mut u, mut v) = ((axis + 1) % 3, (axis + 2) % 3);
        if normal[axis] < 0.0 {
            (u, v) = (v, u);
        }
        self.flat.clear();
        self.flat.extend((0..count).map(|k| [at(k)[u], at(k)[v]]));
    }

    /// Whether the fan about the first corner covers the polygon once: every corner turns left, and so does every
    /// triangle of the fan.
    fn is_convex(&self) -> bool {
        let (p, n) = (&self.flat, self.flat.len());
        (0..n).all(|k| turn(p[k], p[(k + 1) % n], p[(k + 2) % n]) >= 0.0)
            && (1..n - 1).all(|k| turn(p[0], p[k], p[k + 1]) > 0.0)
    }

    fn clip(&mut self, give: &mut impl FnMut([u32; 3])) {
        let n = self.flat.len() as u32;
        self.next.clear();
        self.next.extend((1..n).chain([0]));
        self.before.clear();
        self.before.extend([n - 1].into_iter().chain(0..n - 1));
        // Only where the polygon does not turn left can a corner lie in an ear.
        // Only where the polygon does not turn left can a corner lie in an ear.
        self.hollow = (0..n).map(|k| self.turn_at(k) <= 0.0).collect();
        self.grid.fill(&self.flat, &self.hollow);
        let (mut at, mut left, mut tried) = (0u32, n, 0);
        while left > 3 {
            let ear = if tried < left {
                self.is_ear(at)
            } else if tried < 2 * left {
                // Nothing but corners without area, or a polygon that crosses itself.
                self.turn_at(at) == 0.0
            } else {
                true
            };
            if !ear {
                (at, tried) = (self.next[at as usize], tried + 1);
                continue;
            }
            let (before, next) = (self.before[at as usize], self.next[at as usize]);
            give([before, at, next]);
            self.next[before as usize] = next;
            self.before[next as usize] = before;
            for corner in [before, next] {
                let hollow = self.hollow[corner as usize] && self.turn_at(corner) <= 0.0;
                self.hollow[corner as usize] = hollow;
            }
            self.hollow[at as usize] = false;
            // From the next but one on: triangles are then less thin than about one corner.
            (at, left, tried) = (self.next[next as usize], left - 1, 0);
        }
        give([self.before[at as usize], at, self.next[at as usize]]);
    }

    fn turn_at(&self, k: u32) -> f64 {
        let p = |k: u32| self.flat[k as usize];
        turn(p(self.before[k as usize]), p(k), p(self.next[k as usize]))
    }

    /// Whether the triangle at a corner is inside the polygon, and no other corner in it or on it.
    fn is_ear(&self, tip: u32) -> bool {
        let p = |k: u32| self.flat[k as usize];
        let (before, next) = (self.before[tip as usize], self.next[tip as usize]);
        let (a, b, c) = (p(before), p(tip), p(next));
        if turn(a, b, c) <= 0.0 {
            return false;
        }
        let low = [a[0].min(b[0]).min(c[0]), a[1].min(b[1]).min(c[1])];
        let high = [a[0].max(b[0]).max(c[0]), a[1].max(b[1]).max(c[1])];
        self.grid.within(low, high).all(|k| {
            let q = p(k);
            if !self.hollow[k as usize] || k == tip || k == before || k == next {
                return true;
            }
            if q[0] < low[0] || q[0] > high[0] || q[1] < low[1] || q[1] > high[1] {
                return true;
            }
            if q == b {
                // Where the polygon touches itself: no side may go into the triangle from here.
                let inside = |r: [f64; 2]| turn(b, c, r) > 0.0 && turn(a, b, r) > 0.0;
                return !inside(p(self.before[k as usize])) && !inside(p(self.next[k as usize]));
            }
            q == a || q == c || turn(a, b, q) < 0.0 || turn(b, c, q) < 0.0 || turn(c, a, q) < 0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Areas of the triangles of one polygon in the plane, and its own.
    fn areas(polygon: &[[f64; 2]]) -> (Vec<f64>, f64) {
        let points: Vec<[f64; 3]> = polygon.iter().map(|p| [p[0], p[1], 0.5 * p[0] - p[1]]).collect();
        let corners: Vec<u32> = (0..points.len() as u32).collect();
        let found = triangulate(&points, &corners, &[points.len() as u32]).unwrap();
        assert_eq!(found.corners.len(), points.len() - 2);
        let at = |k: u32| polygon[k as usize];
        let each = found.corners.iter().map(|t| turn(at(t[0]), at(t[1]), at(t[2])) / 2.0).collect();
        let n = polygon.len();
        let whole = (0..n).map(|k| turn([0.0, 0.0], polygon[k], polygon[(k + 1) % n]) / 2.0).sum();
        (each, whole)
    }

    fn covers(polygon: &[[f64; 2]]) {
        for turned in 0..polygon.len() {
            for backwards in [false, true] {
                let mut own = polygon.to_vec();
                own.rotate_left(turned);
                if backwards {
                    own.reverse();
                }
                let (each, whole) = areas(&own);
                let sum: f64 = each.iter().map(|a| a.abs()).sum();
                assert!((sum - whole.abs()).abs() < 1e-9 * whole.abs(), "{own:?}: {each:?}, {whole}");
            }
        }
    }

    #[test]
    fn concave_polygons_are_covered_once() {
        covers(&[[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [1.0, 1.0]]);
        covers(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]]);
        // A comb, a corner on a straight side, and doubled corners.
        covers(&[
            [0.0, 0.0],
            [5.0, 0.0],
            [5.0, 3.0],
            [4.0, 1.0],
            [3.0, 3.0],
            [2.0, 1.0],
            [1.0, 3.0],
            [0.5, 1.0],
        ]);
        covers(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]);
        covers(&[[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.5], [1.0, 0.5]]);
        // A square with a square hole, joined by a bridge.
        let (o, i) = (
            [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]],
            [[1.0, 1.0], [1.0, 3.0], [3.0, 3.0], [3.0, 1.0]],
        );
        covers(&[o[0], o[1], o[2], o[3], o[0], i[0], i[1], i[2], i[3], i[0]]);
    }

    #[test]
    fn large_polygons_take_no_longer_than_many_small_ones() {
        let n = 50_000;
        let polygon: Vec<[f64; 2]> = (0..n)
            .map(|k| {
                let angle = f64::from(k) / f64::from(n) * std::f64::consts::TAU;
                let radius = if k % 2 == 0 { 1.0 } else { 0.6 + 0.2 * f64::from(k * 7919 % 1000) / 1000.0 };
                [radius * angle.cos(), radius * angle.sin()]
            })
            .collect();
        let (each, whole) = areas(&polygon);
        assert!((each.iter().map(|a| a.abs()).sum::<f64>() - whole).abs() < 1e-9);
    }

    #[test]
    fn corners_on_straight_sides_stay_in_use_with_area() {
        let (each, _) = areas(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]);
        assert!(each.iter().all(|a| *a > 0.0));
    }

    #[test]
    fn what_has_no_area_keeps_its_triangles() {
        let line: Vec<[f64; 2]> = (0..6).map(|k| [f64::from(k), 0.0]).collect();
        assert_eq!(areas(&line).0.len(), 4);
        assert_eq!(areas(&[[1.0, 1.0]; 5]).0.len(), 3);
        assert_eq!(triangulate(&[[0.0; 3]; 3], &[0, 1], &[2, 0]).unwrap().without, 2);
        assert!(triangulate(&[[0.0; 3]; 3], &[0, 1, 3], &[3]).is_err());
    }

    #[test]
    fn strips_turn_every_other_triangle() {
        assert_eq!(strips(&[0, 1, 2, 3, -1, 4, 5, 6], &[8]), [[0, 1, 2], [2, 1, 3], [4, 5, 6]]);
        assert_eq!(strips(&[0, 1, 2, 3], &[3, 1]), [[0, 1, 2]]);
    }

    proptest! {
        #[test]
        fn stars_of_any_shape_are_covered_once(radii in prop::collection::vec(0.05f64..1.0, 5..40)) {
            let n = radii.len() as f64;
            let polygon: Vec<[f64; 2]> = radii.iter().enumerate().map(|(k, r)| {
                let angle = k as f64 / n * std::f64::consts::TAU;
                [r * angle.cos(), r * angle.sin()]
            }).collect();
            let (each, whole) = areas(&polygon);
            prop_assert!(each.iter().all(|a| *a >= -1e-12));
            prop_assert!((each.iter().sum::<f64>() - whole).abs() < 1e-9);
        }

        #[test]
        fn any_corners_end(points in prop::collection::vec(prop::array::uniform2(-3i8..3), 4..20)) {
            let polygon: Vec<[f64; 2]> = points.iter().map(|p| [f64::from(p[0]), f64::from(p[1])]).collect();
            areas(&polygon);
        }
    }
}
