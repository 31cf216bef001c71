//! The internal space: object = origin + 2^k · internal, with every internal coordinate within ±1.
//!
//! Dividing by a power of two changes no mantissa, so an f32 source stays exact and a build does not depend on
//! the caller's units. A source that needs f64 is stored as f32 about the centre of its box, and so is, exactly, an f32
//! source that lies so far from its origin that what is computed in f32 would have too few digits.

use rayon::prelude::*;

use super::source::Positions;
use crate::math::Aabb;
use crate::model::CoordinateFrame;

/// Coordinates are at most 2 to this power, which is also the largest scale, and the inverse of the smallest.
pub const LARGEST_EXPONENT: i32 = 1000;

/// An axis along which a source lies farther from its origin than so many times its size is stored about its centre. Up to
/// there f32 has 14 bits or more for the size, which is a sixteenth of a pixel of a picture of a thousand.
const FAR: f64 = 512.0;

/// Which of so many vertices faces refer to. Others have no place in a frame: nothing is seen of them, and one far away would
/// take digits from all.
pub fn referenced(faces: &[[u32; 3]], vertices: usize) -> Vec<bool> {
    let mut out = vec![false; vertices];
    faces.as_flattened().iter().for_each(|v| out[*v as usize] = true);
    out
}

/// The frame of the positions that are referred to, all of them finite, with the largest distance by which it moves one.
pub fn of(positions: Positions<'_>, referenced: &[bool]) -> CoordinateFrame {
    let counted = || (0..positions.len()).into_par_iter().filter(|i| referenced[*i]);
    let exact = match positions {
        Positions::F32(_) => true,
        Positions::F64(p) => counted().all(|i| p[i].iter().all(|x| f64::from(*x as f32) == *x)),
    };
    let (low, high) = counted()
        .map(|i| (positions.get(i), positions.get(i)))
        .reduce_with(|a, b| {
            (std::array::from_fn(|k| a.0[k].min(b.0[k])), std::array::from_fn(|k| a.1[k].max(b.1[k])))
        })
        .unwrap_or_default();
    let extent = (0..3).map(|k| high[k] * 0.5 - low[k] * 0.5).fold(0.0, f64::max);
    // Differences of f32 numbers of one sign that are near each other are f32 numbers.
    let far = |k: usize| low[k].abs().min(high[k].abs()) > FAR * extent && low[k] * high[k] > 0.0;
    let origin: [f64; 3] = std::array::from_fn(|k| {
        if exact && (extent == 0.0 || !far(k)) { 0.0 } else { low[k] * 0.5 + high[k] * 0.5 }
    });
    let largest =
        (0..3).map(|k| (low[k] - origin[k]).abs().max((high[k] - origin[k]).abs())).fold(0.0, f64::max);
    let frame = CoordinateFrame { origin, scale: power_of_two_above(largest), rounding: 0.0 };
    let moved = |i: usize| {
        let p = positions.get(i);
        let q = frame.to_object(internal(&frame, p));
        (0..3).map(|k| ((p[k] - q[k]) / frame.scale).powi(2)).sum::<f64>().sqrt() * frame.scale
    };
    let rounding = counted().map(moved).reduce(|| 0.0, f64::max);
    CoordinateFrame { rounding: rounding * (1.0 + 1.0e-15), ..frame }
}

/// A position in a frame.
pub fn internal(frame: &CoordinateFrame, p: [f64; 3]) -> [f32; 3] {
    // Adding zero turns −0 into +0, so that equal positions have equal bits.
    std::array::from_fn(|k| ((p[k] - frame.origin[k]) / frame.scale) as f32 + 0.0)
}

/// Internal positions and their frame. Those that are not referred to are zero.
pub fn to_internal(positions: Positions<'_>, referenced: &[bool]) -> (Vec<[f32; 3]>, CoordinateFrame) {
    let frame = of(positions, referenced);
    let place = |i: usize| if referenced[i] { internal(&frame, positions.get(i)) } else { [0.0; 3] };
    ((0..positions.len()).into_par_iter().map(place).collect(), frame)
}

/// The smallest power of two not below a positive number; 1 for zero. Stays within the normal range of f64.
pub fn power_of_two_above(x: f64) -> f64 {
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
            let (internal, frame) = to_internal(Positions::F32(&p), &[true; 64][..p.len()]);
            assert!(internal.iter().flatten().all(|x| x.abs() <= 1.0));
            for (a, b) in p.iter().zip(&internal) {
                assert_eq!(a.map(f64::from), frame.to_object(*b));
            }
            assert_eq!((frame.origin, frame.rounding), ([0.0; 3], 0.0));
        }
    }

    #[test]
    fn far_f32_sources_are_exact_about_their_centre() {
        for far in [4_200_000.0f32, -7.0e5, 3.0e37] {
            let step = far.abs() * f32::EPSILON;
            let p: Vec<[f32; 3]> = (0..64)
                .map(|i| [far + step * (i % 7) as f32, 0.3 * step * i as f32, -far + step * (i % 5) as f32])
                .collect();
            let (internal, frame) = to_internal(Positions::F32(&p), &[true; 64][..p.len()]);
            for (a, b) in p.iter().zip(&internal) {
                assert_eq!(a.map(f64::from), frame.to_object(*b));
            }
            assert!(frame.origin[0] != 0.0 && frame.origin[1] == 0.0 && frame.origin[2] != 0.0);
            assert_eq!(frame.rounding, 0.0);
            assert!(frame.scale <= f64::from(step) * 64.0, "{far}: {}", frame.scale);
        }
        let near = [[100.0f32, 0.0, 0.0], [101.0, 1.0, 0.0], [100.0, 1.0, 1.0]];
        assert_eq!(to_internal(Positions::F32(&near), &[true; 64][..near.len()]).1.origin, [0.0; 3]);
    }

    #[test]
    fn georeferenced_f64_keeps_its_precision() {
        let p = [[500_000.001, 4_200_000.002, 12.0], [500_003.004, 4_200_001.0, 15.5]];
        let (internal, frame) = to_internal(Positions::F64(&p), &[true; 64][..p.len()]);
        for (a, b) in p.iter().zip(&internal) {
            let back = frame.to_object(*b);
            assert!((0..3).all(|k| (a[k] - back[k]).abs() < 1e-6));
        }
        assert!(frame.rounding < 1e-6 && frame.scale == 2.0);
        assert_eq!(to_internal(Positions::F64(&[[0.5, 0.25, 1.0]]), &[true]).1.origin, [0.0; 3]);
    }

    #[test]
    fn vertices_that_no_face_has_take_no_digits() {
        let p = [[0.1, 0.2, 0.3], [0.7, 0.2, -0.4], [1.0e300, 0.0, 0.0], [0.4, 0.9, 0.0]];
        let referenced = referenced(&[[0, 1, 3]], 4);
        let (internal, frame) = to_internal(Positions::F64(&p), &referenced);
        assert!(frame.scale == 0.5 && frame.rounding < 1e-7, "{frame:?}");
        assert_eq!(internal[2], [0.0; 3]);
        let without = to_internal(Positions::F64(&[p[0], p[1], p[3]]), &[true; 3]);
        assert_eq!((without.1, &without.0[2]), (frame, &internal[3]));
    }
}
