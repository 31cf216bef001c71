//! The internal space: object = origin + 2^k · internal, with every internal coordinate within ±1.
//!
//! Dividing by a power of two changes no mantissa, so an f32 source stays exact and a build does not depend on
//! the caller's units. A source that needs f64 is stored as f32 about the centre of its box.

use rayon::prelude::*;

use super::source::Positions;
use crate::math::Aabb;
use crate::model::CoordinateFrame;

/// Coordinates are at most 2 to this power, which is also the largest scale, and the inverse of the smallest.
pub const LARGEST_EXPONENT: i32 = 1000;

/// Internal positions and their frame.
pub fn to_internal(positions: Positions<'_>) -> (Vec<[f32; 3]>, CoordinateFrame) {
    let count = positions.len();
    let exact = match positions {
        Positions::F32(_) => true,
        Positions::F64(p) => p.par_iter().all(|p| p.iter().all(|x| f64::from(*x as f32) == *x)),
    };
    let (low, high) = (0..count)
        .into_par_iter()
        .map(|i| (positions.get(i), positions.get(i)))
        .reduce_with(|a, b| {
            (std::array::from_fn(|k| a.0[k].min(b.0[k])), std::array::from_fn(|k| a.1[k].max(b.1[k])))
        })
        .unwrap_or_default();
    let origin: [f64; 3] =
        if exact { [0.0; 3] } else { std::array::from_fn(|k| low[k] * 0.5 + high[k] * 0.5) };
    let largest =
        (0..3).map(|k| (low[k] - origin[k]).abs().max((high[k] - origin[k]).abs())).fold(0.0, f64::max);
    let scale = power_of_two_above(largest);
    let internal: Vec<[f32; 3]> = (0..count)
        .into_par_iter()
        .map(|i| {
            let p = positions.get(i);
            // Adding zero turns −0 into +0, so that equal positions have equal bits.
            std::array::from_fn(|k| ((p[k] - origin[k]) / scale) as f32 + 0.0)
        })
        .collect();
    let frame = CoordinateFrame { origin, scale, rounding: 0.0 };
    let rounding = (0..count)
        .into_par_iter()
        .map(|i| {
            let (p, q) = (positions.get(i), frame.to_object(internal[i]));
            (0..3).map(|k| ((p[k] - q[k]) / scale).powi(2)).sum::<f64>().sqrt() * scale
        })
        .reduce(|| 0.0, f64::max);
    (internal, CoordinateFrame { rounding: rounding * (1.0 + 1.0e-15), ..frame })
}

/// The smallest power of two not below a positive number; 1 for zero. Stays within the normal range of f64.
fn power_of_two_above(x: f64) -> f64 {
    if x == 0.0 {
        return 1.0;
    }
    let mut scale = 2f64.powi((x.log2().ceil() as i32).clamp(-LARGEST_EXPONENT, LARGEST_EXPONENT));
    while scale < x {
        scale *= 2.0;
    }
    scale
}

/// The box of internal points, with an extent that is never zero in all axes for a mesh with area.
pub fn bounds(positions: &[[f32; 3]]) -> Aabb {
    positions.par_chunks(1 << 16).map(Aabb::of_points).reduce(|| Aabb::EMPTY, |a, b| a.union(&b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn f32_sources_are_exact_at_any_scale() {
        for scale in [1.0e-38f32, 1.0e-30, 1.0, 7.0, 1.0e30, 3.0e38] {
            let p = [[0.1 * scale, -0.7 * scale, scale], [0.3 * scale, 0.0, -0.9 * scale]];
            let (internal, frame) = to_internal(Positions::F32(&p));
            assert!(internal.iter().flatten().all(|x| x.abs() <= 1.0));
            for (a, b) in p.iter().zip(&internal) {
                assert_eq!(a.map(f64::from), frame.to_object(*b));
            }
            assert_eq!((frame.origin, frame.rounding), ([0.0; 3], 0.0));
        }
    }

    #[test]
    fn georeferenced_f64_keeps_its_precision() {
        let p = [[500_000.001, 4_200_000.002, 12.0], [500_003.004, 4_200_001.0, 15.5]];
        let (internal, frame) = to_internal(Positions::F64(&p));
        for (a, b) in p.iter().zip(&internal) {
            let back = frame.to_object(*b);
            assert!((0..3).all(|k| (a[k] - back[k]).abs() < 1e-6));
        }
        assert!(frame.rounding < 1e-6 && frame.scale == 2.0);
        assert_eq!(to_internal(Positions::F64(&[[0.5, 0.25, 1.0]])).1.origin, [0.0; 3]);
    }
}
