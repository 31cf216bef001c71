//! What culling knows of a cluster besides its error, all of it from positions and triangles, rounded outwards. The
//! one home of it: building and files that store positions alone get the same bits.

use super::Aabb;
use super::sphere::round_up;
use super::triangle::area_normal;

/// The bounds of a cluster.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Centre of the box and of the sphere.
    pub center: [f32; 3],
    /// Half extents of the box, rounded up.
    pub extent: [f32; 3],
    /// Radius about the centre that holds every point, rounded up.
    pub radius: f32,
    /// Longest edge of the triangles, rounded up.
    pub max_edge: f32,
    /// Backface cone: axis and cutoff, signed bytes over 127.
    pub cone: [i8; 4],
}

impl Bounds {
    /// The bounds of triangles over points.
    pub fn of(points: &[[f32; 3]], triangles: &[[u8; 3]]) -> Self {
        let (center, extent) = Aabb::of_points(points).center_extent();
        let squared = |p: &[f32; 3]| (0..3).map(|k| (f64::from(p[k]) - f64::from(center[k])).powi(2)).sum();
        let radius = round_up(points.iter().map(squared).fold(0.0, f64::max).sqrt());
        let max_edge = round_up(longest_edge(points, triangles));
        Self { center, extent, radius, max_edge, cone: cone(points, triangles) }
    }
}

fn longest_edge(points: &[[f32; 3]], triangles: &[[u8; 3]]) -> f64 {
    let squared = |a: u8, b: u8| {
        let (a, b) = (points[usize::from(a)], points[usize::from(b)]);
        (0..3).map(|k| (f64::from(a[k]) - f64::from(b[k])).powi(2)).sum::<f64>()
    };
    let edges =
        triangles.iter().flat_map(|t| [squared(t[0], t[1]), squared(t[1], t[2]), squared(t[2], t[0])]);
    edges.fold(0.0, f64::max).sqrt()
}

/// The backface cone: mean normal and the sine of the widest angle to it, in signed bytes rounded so that the
/// test stays safe. A cone wider than a half space gets cutoff 127, which never culls.
///
/// Olano and Kuehne's normal cones in the form of meshoptimizer's bounds: all triangles face away from `eye`
/// when dot(c − eye, axis) ≥ cutoff·|c − eye| + radius.
fn cone(points: &[[f32; 3]], triangles: &[[u8; 3]]) -> [i8; 4] {
    const NEVER: [i8; 4] = [0, 0, 0, 127];
    let normal = |t: &[u8; 3]| {
        let n = area_normal(t.map(|v| points[usize::from(v)]));
        let size = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        let inverse = 1.0 / size;
        inverse.is_finite().then(|| n.map(|x| x * inverse))
    };
    // Triangles without area are never drawn.
    let normals: Vec<[f64; 3]> = triangles.iter().filter_map(normal).collect();
    let sum = normals.iter().fold([0.0; 3], |s, n| [s[0] + n[0], s[1] + n[1], s[2] + n[2]]);
    let size = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
    if size < 1.0e-6 {
        return NEVER;
    }
    let packed = sum.map(|x| (x / size * 127.0).round() as i8);
    let axis = packed.map(|x| f64::from(x) / 127.0);
    let length = (axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]).sqrt();
    let dot = |n: &[f64; 3]| (n[0] * axis[0] + n[1] * axis[1] + n[2] * axis[2]) / length;
    let narrowest = normals.iter().map(dot).fold(1.0, f64::min);
    // Below a tenth the cone covers nearly a half space and would never cull anything.
    if narrowest <= 0.1 {
        return NEVER;
    }
    // With a unit axis the cutoff is the sine; the stored axis has length `length`, and so has the left side of
    // the test, while `radius` on its right side has not: divide where that is unsafe, then round up.
    let cutoff = (1.0 - narrowest * narrowest).max(0.0).sqrt() * length.max(1.0) + (length - 1.0).max(0.0);
    let stored = (cutoff * 127.0).ceil() + 1.0;
    if stored >= 127.0 {
        return NEVER;
    }
    [packed[0], packed[1], packed[2], stored as i8]
}
