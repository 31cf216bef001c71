//! The point of a triangle nearest to a given point, in f64.

/// A point or vector.
pub type Vec3 = [f64; 3];
/// Three corners.
pub type Triangle = [Vec3; 3];

pub(super) fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(super) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn along(origin: Vec3, direction: Vec3, t: f64) -> Vec3 {
    [origin[0] + direction[0] * t, origin[1] + direction[1] * t, origin[2] + direction[2] * t]
}

pub(super) fn squared(p: Vec3, q: Vec3) -> f64 {
    let d = sub(p, q);
    dot(d, d)
}

/// The normal of a triangle, counter-clockwise from the front, as long as twice its area.
pub(super) fn normal([a, b, c]: Triangle) -> Vec3 {
    cross(sub(b, a), sub(c, a))
}

/// Below this part of the largest squared sine a triangle is a sliver, whose edges are looked at as well.
const SLIVER: f64 = 1e-8;

fn on_segment(p: Vec3, a: Vec3, b: Vec3) -> Vec3 {
    let ab = sub(b, a);
    let length = dot(ab, ab);
    let t = if length > 0.0 { (dot(sub(p, a), ab) / length).clamp(0.0, 1.0) } else { 0.0 };
    along(a, ab, t)
}

/// The nearer of two points to `p`.
fn nearer(p: Vec3, q: Vec3, r: Vec3) -> Vec3 {
    if squared(p, r) < squared(p, q) { r } else { q }
}

/// The nearest point of one of the three edges.
fn on_edges(p: Vec3, [a, b, c]: Triangle) -> Vec3 {
    let q = nearer(p, on_segment(p, a, b), on_segment(p, b, c));
    nearer(p, q, on_segment(p, c, a))
}

/// The point of a triangle nearest to `p`.
///
/// The point returned is a convex combination of the corners whatever was decided on the way, so that the distance
/// to it is never below the true distance by more than rounding. Triangles may be degenerate.
///
/// Regions after Ericson, "Real-Time Collision Detection" (2005), §5.1.5.
pub fn closest_point(p: Vec3, triangle: Triangle) -> Vec3 {
    let [a, b, c] = triangle;
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    let sum = va + vb + vc;
    let interior = || along(along(a, ab, vb / sum), ac, vc / sum);
    if !(sum > SLIVER * dot(ab, ab) * dot(ac, ac) && sum > f64::MIN_POSITIVE) {
        let q = on_edges(p, triangle);
        let inside = va > 0.0 && vb > 0.0 && vc > 0.0 && sum > f64::MIN_POSITIVE;
        return if inside { nearer(p, q, interior()) } else { q };
    }
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return along(a, ab, d1 / (d1 - d3));
    }
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return along(a, ac, d2 / (d2 - d6));
    }
    let (d43, d56) = (d4 - d3, d5 - d6);
    if va <= 0.0 && d43 >= 0.0 && d56 >= 0.0 {
        return along(b, sub(c, b), d43 / (d43 + d56));
    }
    if va > 0.0 && vb > 0.0 && vc > 0.0 { interior() } else { on_edges(p, triangle) }
}

/// Square of the distance from a point to a triangle.
pub fn squared_distance(p: Vec3, triangle: Triangle) -> f64 {
    squared(p, closest_point(p, triangle))
}

/// A lower bound of the distance from `p` to a triangle, but for rounding: some plane has the triangle on its
/// far side. Whether `closest_point` decided well on the way does not matter.
pub fn distance_below(p: Vec3, triangle: Triangle) -> f64 {
    let towards = sub(p, closest_point(p, triangle));
    let length = dot(towards, towards).sqrt();
    if length > 0.0 {
        let least = triangle.map(|v| dot(towards, sub(p, v)));
        (least[0].min(least[1]).min(least[2]) / length).max(0.0)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions() {
        let t = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        let cases = [
            ([0.5, 0.5, 3.0], [0.5, 0.5, 0.0]),
            ([-1.0, -1.0, 0.0], [0.0, 0.0, 0.0]),
            ([3.0, 0.0, 0.0], [2.0, 0.0, 0.0]),
            ([0.0, 4.0, 1.0], [0.0, 2.0, 0.0]),
            ([1.0, -2.0, 0.0], [1.0, 0.0, 0.0]),
            ([2.0, 2.0, 0.0], [1.0, 1.0, 0.0]),
            ([-3.0, 1.0, 0.0], [0.0, 1.0, 0.0]),
        ];
        for (p, expected) in cases {
            assert!(squared(closest_point(p, t), expected) < 1e-30, "{p:?}");
            assert!((distance_below(p, t) - squared(p, expected).sqrt()).abs() < 1e-15, "{p:?}");
        }
    }

    #[test]
    fn degenerate_triangles_are_segments_and_points() {
        let segment = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.0, 0.0]];
        assert_eq!(squared_distance([0.25, 1.0, 0.0], segment), 1.0);
        assert_eq!(squared_distance([3.0, 0.0, 0.0], segment), 4.0);
        assert_eq!(squared_distance([1.0, 1.0, 3.0], [[1.0, 1.0, 1.0]; 3]), 4.0);
        assert_eq!(distance_below([1.0, 1.0, 1.0], [[1.0, 1.0, 1.0]; 3]), 0.0);
    }
}
