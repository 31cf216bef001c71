//! Point to triangle.

use super::closest;

type Vec3 = [f32; 3];

/// Triangles with an angle whose squared sine is below this are left to f64: in f32 the nearest point is off by some
/// 2⁻²² of their length over the squared sine.
const SLIVER: f32 = 1.0e-3;

fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn along(origin: Vec3, direction: Vec3, t: f32) -> Vec3 {
    [origin[0] + direction[0] * t, origin[1] + direction[1] * t, origin[2] + direction[2] * t]
}

/// Square of the distance from a point to the nearest point of a segment.
fn squared_to_segment(p: Vec3, a: Vec3, b: Vec3) -> f32 {
    let ab = sub(b, a);
    let length = dot(ab, ab);
    let t = if length > 0.0 { (dot(sub(p, a), ab) / length).clamp(0.0, 1.0) } else { 0.0 };
    let d = sub(p, along(a, ab, t));
    dot(d, d)
}

/// Square of the distance from a point to a triangle. Never below the true one by more than rounding: it is that to
/// some point of the triangle.
///
/// Regions after Ericson, "Real-Time Collision Detection" (2005), §5.1.5.
pub fn squared_distance(p: Vec3, [a, b, c]: [Vec3; 3]) -> f32 {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return dot(ap, ap);
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return dot(bp, bp);
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return dot(cp, cp);
    }
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    let sum = va + vb + vc;
    let is_broad = sum > SLIVER * dot(ab, ab) * dot(ac, ac) && sum > f32::MIN_POSITIVE;
    if !is_broad {
        let exact = |v: Vec3| v.map(f64::from);
        return closest::squared_distance(exact(p), [a, b, c].map(exact)) as f32;
    }
    if va > 0.0 && vb > 0.0 && vc > 0.0 {
        let (v, w) = (vb / sum, vc / sum);
        let d = sub(p, along(along(a, ab, v), ac, w));
        return dot(d, d);
    }
    squared_to_segment(p, a, b).min(squared_to_segment(p, b, c)).min(squared_to_segment(p, c, a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions() {
        let t = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        let cases = [
            ([0.5, 0.5, 3.0], 9.0),
            ([-1.0, -1.0, 0.0], 2.0),
            ([3.0, 0.0, 0.0], 1.0),
            ([0.0, 4.0, 1.0], 5.0),
            ([1.0, -2.0, 0.0], 4.0),
            ([2.0, 2.0, 0.0], 2.0),
            ([-3.0, 1.0, 0.0], 9.0),
        ];
        for (p, expected) in cases {
            assert!((squared_distance(p, t) - expected).abs() < 1e-5, "{p:?}");
        }
        let sliver = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.0, 0.0]];
        assert!((squared_distance([0.25, 1.0, 0.0], sliver) - 1.0).abs() < 1e-6);
        for turn in 0..3 {
            let mut thin = [[0.0, 0.3, 0.7], [2.0, 0.3, 0.7], [1.9, 0.30002, 0.7]];
            thin.rotate_left(turn);
            for i in 1..100 {
                let on_an_edge = [i as f32 / 50.0, 0.3, 0.7];
                let found = squared_distance(on_an_edge, thin).sqrt();
                assert!(found < 1.0e-6, "{found} at {on_an_edge:?}");
            }
        }
        let point = [[1.0, 1.0, 1.0]; 3];
        assert!((squared_distance([1.0, 1.0, 3.0], point) - 4.0).abs() < 1e-6);
    }
}
