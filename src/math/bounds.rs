//! What culling knows of a cluster besides its error, all of it from positions and triangles, rounded outwards. The
//! one home of it: building, and files, which store of it what takes triangles to find, get the same bits.

use super::Aabb;
use super::sphere::round_up;

/// Bounds of points: a box, and a sphere about its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Centre of both.
    pub center: [f32; 3],
    /// Half extents of the box, rounded up.
    pub extent: [f32; 3],
    /// Radius about the centre that holds every point, rounded up.
    pub radius: f32,
}

impl Ball {
    /// The bounds of points.
    pub fn of(points: &[[f32; 3]]) -> Self {
        let less = |a: f32, b: f32| if b < a { b } else { a };
        let more = |a: f32, b: f32| if b > a { b } else { a };
        let (mut min, mut max) = ([f32::INFINITY; 12], [f32::NEG_INFINITY; 12]);
        for four in fours_of(points) {
            let four = four.as_flattened();
            for k in 0..12 {
                (min[k], max[k]) = (less(min[k], four[k]), more(max[k], four[k]));
            }
        }
        let box_of_all = Aabb {
            min: std::array::from_fn(|k| [min[k + 3], min[k + 6], min[k + 9]].into_iter().fold(min[k], less)),
            max: std::array::from_fn(|k| [max[k + 3], max[k + 6], max[k + 9]].into_iter().fold(max[k], more)),
        };
        Self::in_box(box_of_all, points)
    }

    /// The bounds of points of which the box is known.
    pub fn in_box(bounds: Aabb, points: &[[f32; 3]]) -> Self {
        let (center, extent) = bounds.center_extent();
        let mut farthest = [0f64; 4];
        for four in fours_of(points) {
            let squares = four.map(|p| difference(p, center).map(|d| d * d));
            for k in 0..4 {
                let squared = squares[k][0] + squares[k][1] + squares[k][2];
                farthest[k] = if squared > farthest[k] { squared } else { farthest[k] };
            }
        }
        let farthest = farthest.into_iter().fold(0.0, f64::max);
        Self { center, extent, radius: round_up(farthest.sqrt()) }
    }
}

/// Four points at a time, which are whole registers; the last one fills up the last four.
fn fours_of(points: &[[f32; 3]]) -> impl Iterator<Item = [[f32; 3]; 4]> {
    let (fours, rest) = points.as_chunks::<4>();
    let last = (!rest.is_empty()).then(|| [0, 1, 2, 3].map(|k| rest[k.min(rest.len() - 1)]));
    fours.iter().copied().chain(last)
}

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
        let Ball { center, extent, radius } = Ball::of(points);
        let mut longest = 0f64;
        let mut normals = Vec::with_capacity(triangles.len());
        for t in triangles {
            let [a, b, c] = [points[usize::from(t[0])], points[usize::from(t[1])], points[usize::from(t[2])]];
            let (u, v, w) = (difference(b, a), difference(c, a), difference(c, b));
            for e in [u, v, w] {
                longest = longest.max(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
            }
            let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            let inverse = 1.0 / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
            // Triangles without area are never drawn.
            if inverse.is_finite() {
                normals.push([n[0] * inverse, n[1] * inverse, n[2] * inverse]);
            }
        }
        Self { center, extent, radius, max_edge: round_up(longest.sqrt()), cone: cone(&normals) }
    }
}

#[inline(always)]
fn difference(a: [f32; 3], b: [f32; 3]) -> [f64; 3] {
    [f64::from(a[0]) - f64::from(b[0]), f64::from(a[1]) - f64::from(b[1]), f64::from(a[2]) - f64::from(b[2])]
}

/// Steps of the parts of a cone's axis and of its cutoff from 0 to 1.
pub const CONE_STEPS: f64 = i8::MAX as f64;

/// The backface cone: mean normal and the sine of the widest angle to it, in signed bytes rounded so that the
/// test stays safe. A cone wider than a half space gets cutoff 127, which never culls.
///
/// Olano and Kuehne's normal cones in the form of meshoptimizer's bounds: all triangles face away from `eye`
/// when dot(c − eye, axis) ≥ cutoff·|c − eye| + radius.
fn cone(normals: &[[f64; 3]]) -> [i8; 4] {
    const NEVER: [i8; 4] = [0, 0, 0, i8::MAX];
    let mut sum = [0.0; 3];
    for n in normals {
        sum = [sum[0] + n[0], sum[1] + n[1], sum[2] + n[2]];
    }
    let size = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
    if size < 1.0e-6 {
        return NEVER;
    }
    let packed = sum.map(|x| (x / size * CONE_STEPS).round() as i8);
    let axis = packed.map(|x| f64::from(x) / CONE_STEPS);
    let length = (axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]).sqrt();
    let mut narrowest = 1f64;
    for n in normals {
        narrowest = narrowest.min((n[0] * axis[0] + n[1] * axis[1] + n[2] * axis[2]) / length);
    }
    // Below a tenth the cone covers nearly a half space and would never cull anything.
    if narrowest <= 0.1 {
        return NEVER;
    }
    // With a unit axis the cutoff is the sine; the stored axis has length `length`, and so has the left side of
    // the test, while `radius` on its right side has not: divide where that is unsafe, then round up.
    let cutoff = (1.0 - narrowest * narrowest).max(0.0).sqrt() * length.max(1.0) + (length - 1.0).max(0.0);
    let stored = (cutoff * CONE_STEPS).ceil() + 1.0;
    if stored >= CONE_STEPS {
        return NEVER;
    }
    [packed[0], packed[1], packed[2], stored as i8]
}
