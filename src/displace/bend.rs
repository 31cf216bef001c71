//! How far a product of heights and unit normals is from linear.
//!
//! With linear functions ℓa, ℓn through the ends, |a − ℓa| ≤ α and |n − ℓn| ≤ ν:
//! a n − Σ λᵢ aᵢ nᵢ = (a − ℓa) n + ℓa (n − ℓn) + (ℓa ℓn − Σ λᵢ aᵢ nᵢ), and the last is
//! −Σ λᵢ λⱼ (aᵢ − aⱼ)(nᵢ − nⱼ) over pairs, whose weights add up to ¼ of a segment and ⅓ of a triangle at most.

use glam::DVec3;

/// Unit vectors never differ by more.
const OPPOSITE: f64 = 2.0;

/// A vector of length 1; zero of what has no direction.
pub(super) fn unit(v: DVec3) -> DVec3 {
    v.try_normalize().unwrap_or(DVec3::ZERO)
}

/// Largest sum of λᵢ λⱼ over pairs of so many corners.
fn pairs(corners: usize) -> f64 {
    if corners == 2 { 0.25 } else { 1.0 / 3.0 }
}

/// The largest value over pairs of corners.
fn most_of_pairs(n: usize, value: impl Fn(usize, usize) -> f64) -> f64 {
    let all = (0..n).flat_map(|i| (0..i).map(move |j| (i, j)));
    all.map(|(i, j)| value(i, j)).fold(0.0, f64::max)
}

/// A lower bound of the length of what is interpolated between vectors.
pub(super) fn least_length(vectors: &[DVec3]) -> f64 {
    let middle = unit(vectors.iter().copied().map(unit).sum());
    vectors.iter().map(|v| v.dot(middle)).fold(f64::INFINITY, f64::min).max(0.0)
}

/// How far the direction N/|N| of a linear function N is from the linear function through the directions nᵢ of its corners.
///
/// With rᵢ = |Nᵢ| it is Σ λᵢ nᵢ (rᵢ − |N|)/|N| ≤ (|Σ λᵢ rᵢ − |N|| + max |rᵢ − |N|| · max |nᵢ − nⱼ|)/|N|. The second derivative
/// of |N| along d is |d|²/|N| at most, so that its interpolation is off by ½ Σ λᵢ λⱼ |Nᵢ − Nⱼ|²/|N|. |N| is convex, and lies
/// between its least and max rᵢ; it differs from rᵢ by no more than max |Nᵢ − Nⱼ|.
pub(super) fn direction_bend(vectors: &[DVec3]) -> f64 {
    let n = vectors.len();
    let step = most_of_pairs(n, |i, j| vectors[i].distance(vectors[j]));
    if step == 0.0 {
        return 0.0;
    }
    let least = least_length(vectors);
    if least == 0.0 {
        return OPPOSITE;
    }
    let turn = most_of_pairs(n, |i, j| unit(vectors[i]).distance(unit(vectors[j])));
    let range = vectors.iter().map(|v| v.length()).fold(0.0, f64::max) - least;
    let sag = (0.5 * pairs(n) * step * step / least).min(range);
    ((sag + step.min(range) * turn) / least).min(OPPOSITE)
}

/// How far the direction of a function is from the linear one through its corners' directions, where the function is within
/// `off` of linear itself. Directions of x and y differ by 2 |x − y|/(|x| + |y|) at most.
pub(super) fn direction_bend_near(vectors: &[DVec3], off: f64) -> f64 {
    let least = least_length(vectors);
    if off == 0.0 {
        return direction_bend(vectors);
    }
    if least == 0.0 {
        return OPPOSITE;
    }
    (direction_bend(vectors) + 2.0 * off / least).min(OPPOSITE)
}

/// How far heights along unit normals are from linear: heights by `off`, directions by `bend`.
pub(super) fn product_bend(heights: &[f64], directions: &[DVec3], off: f64, bend: f64) -> f64 {
    let n = heights.len();
    let tallest = heights.iter().fold(0.0_f64, |most, a| most.max(a.abs()));
    let mixed =
        most_of_pairs(n, |i, j| (heights[i] - heights[j]).abs() * directions[i].distance(directions[j]));
    off + tallest * bend + pairs(n) * mixed
}

#[cfg(test)]
mod tests {
    use super::*;

    fn along(vectors: &[DVec3], weights: &[f64]) -> DVec3 {
        vectors.iter().zip(weights).map(|(v, w)| *v * *w).sum()
    }

    #[test]
    fn directions_stay_within_their_bend() {
        let cases = [
            [DVec3::X, DVec3::new(0.9, 0.3, 0.0), DVec3::new(0.8, -0.1, 0.4)],
            [DVec3::X * 3.0, DVec3::new(0.1, 1.0, 0.0), DVec3::new(0.1, 0.2, 0.4)],
            [DVec3::X, DVec3::X, DVec3::X],
            [DVec3::X, -DVec3::X, DVec3::Y],
        ];
        for vectors in cases {
            let ends = vectors.map(unit);
            let bound = direction_bend(&vectors);
            let mut most = 0.0_f64;
            for i in 0..=20 {
                for j in 0..=20 - i {
                    let w = [f64::from(i) / 20.0, f64::from(j) / 20.0, f64::from(20 - i - j) / 20.0];
                    most = most.max(unit(along(&vectors, &w)).distance(along(&ends, &w)));
                }
            }
            assert!(most <= bound + 1e-15, "{vectors:?}: {most} > {bound}");
        }
        assert_eq!(direction_bend(&[DVec3::X; 3]), 0.0);
    }
}
