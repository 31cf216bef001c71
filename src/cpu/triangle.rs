//! What the two rasterizers and shading share about one triangle: snapping, facing, and a pixel's barycentric
//! coordinates.

use super::project::Screen;
use crate::limits::SUBPIXEL_BITS;

/// Units per pixel of snapped coordinates.
pub const UNIT: i32 = 1 << SUBPIXEL_BITS;

/// Adding this to an f32 below 2²² in size leaves its nearest integer in the low bits.
const MAGIC: f32 = 12_582_912.0;

/// Snaps a screen coordinate, inside the guard band, to 1/256 pixel.
#[inline(always)]
pub fn snap(v: f32) -> i32 {
    ((v * UNIT as f32 + MAGIC).to_bits() as i32).wrapping_sub(MAGIC.to_bits() as i32)
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

/// Perspective-correct barycentric coordinates of a point of the screen on a triangle given in homogeneous
/// screen coordinates, also where it reaches behind the eye: the solution λ of Σ λᵢ (xᵢ, yᵢ) = p Σ λᵢ dᵢ.
///
/// Points just outside (by snapping) are moved to the nearest edge. After Olano and Greer, "Triangle scan
/// conversion using 2D homogeneous coordinates", Graphics Hardware 1997.
#[inline(always)]
pub fn barycentric(corners: &[[f32; 3]; 3], orthographic: bool, point: [f32; 2]) -> [f32; 3] {
    let along = |k: usize| -> [f32; 3] {
        std::array::from_fn(|i| {
            if orthographic { corners[i][k] - point[k] } else { corners[i][k] - point[k] * corners[i][2] }
        })
    };
    let (x, y) = (along(0), along(1));
    let l = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
    let inverse = 1.0 / (l[0] + l[1] + l[2]);
    if !inverse.is_finite() {
        return [1.0 / 3.0; 3];
    }
    let l = l.map(|v| v * inverse);
    if l[0].min(l[1]).min(l[2]) >= 0.0 {
        return l;
    }
    let l = l.map(|v| v.clamp(0.0, 1.0));
    let inverse = 1.0 / (l[0] + l[1] + l[2]);
    if inverse.is_finite() { l.map(|v| v * inverse) } else { [1.0 / 3.0; 3] }
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

    #[test]
    fn barycentric_coordinates_are_perspective_correct() {
        // Corners at distances 1, 2, 4; a point of the plane with weights (.2, .3, .5).
        let corners = [[10.0, 20.0, 1.0], [200.0, 30.0, 2.0], [100.0, 480.0, 4.0]];
        let weights = [0.2f32, 0.3, 0.5];
        let sum = |k: usize| (0..3).map(|i| weights[i] * corners[i][k]).sum::<f32>();
        let point = [sum(0) / sum(2), sum(1) / sum(2)];
        let l = barycentric(&corners, false, point);
        for i in 0..3 {
            assert!((l[i] - weights[i]).abs() < 1e-5, "{l:?}");
        }
        assert_eq!(barycentric(&[[0.0; 3]; 3], false, [0.5, 0.5]), [1.0 / 3.0; 3]);
    }
}
