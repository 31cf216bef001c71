//! Bounding spheres, always rounded outwards.

use bytemuck::{Pod, Zeroable};

/// A sphere in the mesh's internal units.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Sphere {
    /// Centre.
    pub center: [f32; 3],
    /// Radius, never negative.
    pub radius: f32,
}

/// Outward margin of every computed sphere, far above the rounding of the f32 distances that the rule of
/// the cut evaluates: see `model::rule`.
pub const RADIUS_MARGIN: f64 = 1.0e-4;

/// Rounds a non-negative f64 to the next f32 not below it.
pub fn round_up(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) < value { nearest.next_up() } else { nearest }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
}

fn widen(p: [f32; 3]) -> [f64; 3] {
    p.map(f64::from)
}

impl Sphere {
    /// A near-minimal sphere around points: two passes of Ritter, then the exact radius about the centre.
    ///
    /// Ritter, "An efficient bounding sphere", Graphics Gems (1990).
    pub fn of_points(points: &[[f32; 3]]) -> Self {
        let as_spheres = |i: usize| Self { center: points[i], radius: 0.0 };
        Self::around(points.len(), as_spheres)
    }

    /// A near-minimal sphere around spheres, with [`RADIUS_MARGIN`] on its radius.
    pub fn of_spheres(spheres: &[Self]) -> Self {
        Self::around(spheres.len(), |i| spheres[i])
    }

    fn around(count: usize, get: impl Fn(usize) -> Self) -> Self {
        if count == 0 {
            return Self { center: [0.0; 3], radius: 0.0 };
        }
        // Start from the farthest pair found by two hops.
        let farthest = |from: [f64; 3]| {
            (0..count)
                .map(|i| (i, distance(widen(get(i).center), from) + f64::from(get(i).radius)))
                .fold((0, f64::NEG_INFINITY), |best, x| if x.1 > best.1 { x } else { best })
        };
        let (a, _) = farthest(widen(get(0).center));
        let (b, _) = farthest(widen(get(a).center));
        let mut center = widen(get(a).center);
        let mut radius = f64::from(get(a).radius);
        let mut grow = |s: Self| {
            let d = distance(widen(s.center), center);
            let r = f64::from(s.radius);
            if d + r <= radius {
                return;
            }
            if d + radius <= r {
                (center, radius) = (widen(s.center), r);
                return;
            }
            let grown = 0.5 * (radius + d + r);
            let t = (grown - radius) / d;
            let to = widen(s.center);
            center = std::array::from_fn(|k| center[k] + (to[k] - center[k]) * t);
            radius = grown;
        };
        grow(get(b));
        (0..count).for_each(|i| grow(get(i)));
        let center = center.map(|c| c as f32);
        let radius = (0..count)
            .map(|i| distance(widen(get(i).center), widen(center)) + f64::from(get(i).radius))
            .fold(0.0, f64::max);
        Self { center, radius: round_up(radius * (1.0 + RADIUS_MARGIN)) }
    }

    /// True when `inner` lies inside, without any tolerance (evaluated in f64).
    pub fn contains(&self, inner: &Self) -> bool {
        distance(widen(self.center), widen(inner.center)) + f64::from(inner.radius) <= f64::from(self.radius)
    }
}
