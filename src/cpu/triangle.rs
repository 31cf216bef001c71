//! What the two rasterizers share about triangles: projection, snapping, pixel ranges and the top-left rule.

use super::lanes::{LANES, Lanes};
use crate::limits::{CLUSTER_MAX_VERTICES, SNAP_ROUNDER, SUBPIXEL_BITS};
use crate::model::packing::{Positions, coordinate_of};
use crate::views::Screen;

/// Room for the vertices of a cluster, in whole lanes.
pub const VERTICES: usize = (CLUSTER_MAX_VERTICES + 1).next_multiple_of(LANES);

/// Homogeneous screen coordinates of vertices, eight at a time, with the number of the first: the operations of
/// [`crate::views::homogeneous`] in the same order.
#[inline(always)]
pub fn homogeneous_rows(
    positions: Positions<'_>,
    rows: &[[f32; 4]; 3],
    mut take: impl FnMut(usize, [Lanes; 3]),
) {
    let step = positions.packing().step;
    for first in (0..positions.len()).step_by(LANES) {
        let mut numbers = [[0i32; LANES]; 3];
        for (lane, vertex) in (first..positions.len()).take(LANES).enumerate() {
            let number = positions.numbers(vertex);
            (0..3).for_each(|k| numbers[k][lane] = number[k]);
        }
        let p = numbers.map(|axis| Lanes(axis.map(|number| coordinate_of(number, step))));
        let mut h = [Lanes::splat(0.0); 3];
        for r in 0..3 {
            let m = &rows[r];
            h[r] = p[0] * m[0] + p[1] * m[1] + p[2] * m[2] + m[3];
        }
        take(first, h);
    }
}

/// Units per pixel of snapped coordinates.
pub const UNIT: i32 = 1 << SUBPIXEL_BITS;

/// Snaps a screen coordinate, inside the guard band, to 1/256 pixel.
#[inline(always)]
pub fn snap(v: f32) -> i32 {
    ((v * UNIT as f32 + SNAP_ROUNDER).to_bits() as i32).wrapping_sub(SNAP_ROUNDER.to_bits() as i32)
}

/// Screen position and depth value of a point at or behind the near plane.
#[inline(always)]
pub fn project(screen: &Screen, [x, y, d]: [f32; 3]) -> [f32; 3] {
    if screen.orthographic {
        [x, y, d]
    } else {
        let r = 1.0 / d;
        [x * r, y * r, screen.near * r]
    }
}

/// First and last pixel whose centre lies between two snapped coordinates; empty when first > last.
#[inline(always)]
pub fn pixels(low: i32, high: i32) -> (i32, i32) {
    let half = UNIT / 2;
    ((low + half - 1) >> SUBPIXEL_BITS, (high - half) >> SUBPIXEL_BITS)
}

/// The top-left rule: what an edge function adds so that "≥ 0" means "covered". `dx`, `dy` lead along the edge
/// with the inside on its right (y down).
#[inline(always)]
pub fn edge_bias(dx: i32, dy: i32) -> i32 {
    if dy < 0 || (dy == 0 && dx > 0) { 0 } else { -1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn snapping_rounds_to_the_nearest_unit() {
        for i in -40_000..40_000 {
            let v = i as f32 * 0.399_871;
            assert_eq!(snap(v), (f64::from(v) * 256.0).round_ties_even() as i32, "{v}");
        }
    }

    #[test]
    fn pixel_ranges_hold_exactly_the_centres_between() {
        for (low, high) in [(0, 127), (0, 128), (128, 128), (129, 300), (-700, -129), (-128, 400), (384, 384)]
        {
            let (first, last) = pixels(low, high);
            for p in -10..10 {
                let center = p * UNIT + UNIT / 2;
                assert_eq!(
                    (first..=last).contains(&p),
                    (low..=high).contains(&center),
                    "{p} in {low}..{high}"
                );
            }
        }
    }
}
