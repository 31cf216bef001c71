//! From an error in object units to an error in pixels.

use super::Sphere;

/// By how much less [`LodView::least_pixels`] is than exact numbers would say. Distances to two spheres are rounded by some
/// 2⁻²³ of the coordinates each; this is more while these are below some 2¹⁶ times the distance. Nearer than that, the
/// diameter of the inner sphere is more, by which the divisor is too large.
pub const LEAST_MARGIN: f32 = 1.0 / 64.0;

/// What the level-of-detail test needs of a view and an instance: how far a sphere is, and how large a unit
/// of error looks there. All lengths are in camera-relative world units.
#[derive(Clone, Copy, Debug)]
pub struct LodView {
    /// Rows of the affine map from the mesh's internal space to camera space (x right, y up, −z forward).
    pub object_to_eye: [[f32; 4]; 3],
    /// An upper bound of the largest singular value of its linear part.
    pub scale: f32,
    /// Largest distance, internal units, by which positions were moved where they were stored: added to every error above
    /// that of the source.
    pub rounding: f32,
    /// Pixels per unit of tangent (perspective), or per world unit (orthographic).
    pub focal: f32,
    /// sec² of the angle between the optical axis and the farthest corner of the picture, rounded up.
    pub widest: f32,
    /// Distance of the near plane; 0 selects the orthographic form.
    pub near: f32,
}

impl LodView {
    /// An upper bound, in pixels, of how far a displacement of `error` anywhere on `sphere` moves on the
    /// screen: px = E·s·f·sec²θ ÷ max(|c − eye| − r·s − E·s, near), E being `error` and what storing moved.
    ///
    /// A point at a distance d from the eye and an angle θ off the optical axis moves by f·sec²θ ÷ d pixels per unit
    /// at most. Of all the points between the two ends of a displacement, which lie in a ball of radius r·s + E·s, none
    /// is nearer than the divisor, and tan θ is at most the farthest from the axis ÷ the least depth; on the picture no
    /// θ is larger than its corner's. Each of the three is monotone under enclosing spheres and in `error`, and so is
    /// what is made of them, rounding included: see `model::rule`.
    pub fn pixels(&self, sphere: &Sphere, error: f32) -> f32 {
        if error <= 0.0 {
            return error;
        }
        let world = (error + self.rounding) * self.scale;
        if self.near == 0.0 {
            return world * self.focal;
        }
        let m = &self.object_to_eye;
        let c = sphere.center;
        let at = |r: usize| m[r][0] * c[0] + m[r][1] * c[1] + m[r][2] * c[2] + m[r][3];
        let (x, y, z) = (at(0), at(1), at(2));
        let radius = sphere.radius * self.scale + world;
        let distance = (x * x + y * y + z * z).sqrt() - radius;
        let depth = -z - radius;
        let mut sec2 = self.widest;
        if depth > 0.0 {
            let tangent = ((x * x + y * y).sqrt() + radius) / depth;
            sec2 = (1.0 + tangent * tangent).min(sec2);
        }
        world * self.focal * sec2 / distance.max(self.near)
    }

    /// A lower bound of [`LodView::pixels`] of every error of at least `error` on every sphere inside of this one:
    /// px = E·s·f ÷ max(|c − eye| + r·s, near), less [`LEAST_MARGIN`] of it.
    ///
    /// Of a sphere inside, no point is farther than the divisor; [`LodView::pixels`] divides by the distance of one that is
    /// nearer than all of it, and sec²θ is at least 1.
    pub fn least_pixels(&self, sphere: &Sphere, error: f32) -> f32 {
        if error <= 0.0 {
            return error;
        }
        let world = (error + self.rounding) * self.scale;
        if self.near == 0.0 {
            return world * self.focal;
        }
        let m = &self.object_to_eye;
        let c = sphere.center;
        let at = |r: usize| m[r][0] * c[0] + m[r][1] * c[1] + m[r][2] * c[2] + m[r][3];
        let (x, y, z) = (at(0), at(1), at(2));
        let distance = (x * x + y * y + z * z).sqrt() + sphere.radius * self.scale;
        (1.0 - LEAST_MARGIN) * world * self.focal / distance.max(self.near)
    }
}

/// An upper bound of the largest singular value of a 3×3 matrix: the square root of the largest eigenvalue of
/// AᵀA by cyclic Jacobi rotations in f64, rounded up.
pub fn singular_value_bound(a: [[f64; 3]; 3]) -> f64 {
    let mut s = [[0.0; 3]; 3];
    for (i, row) in s.iter_mut().enumerate() {
        for (j, v) in row.iter_mut().enumerate() {
            *v = (0..3).map(|k| a[k][i] * a[k][j]).sum();
        }
    }
    for _ in 0..12 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if s[p][q] == 0.0 {
                continue;
            }
            let theta = (s[q][q] - s[p][p]) / (2.0 * s[p][q]);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let n = t * c;
            for k in 0..3 {
                let (x, y) = (s[k][p], s[k][q]);
                (s[k][p], s[k][q]) = (c * x - n * y, n * x + c * y);
            }
            for k in 0..3 {
                let (x, y) = (s[p][k], s[q][k]);
                (s[p][k], s[q][k]) = (c * x - n * y, n * x + c * y);
            }
        }
    }
    let largest = s[0][0].max(s[1][1]).max(s[2][2]).max(0.0);
    largest.sqrt() * (1.0 + 1.0e-12)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A view of 90° down an axis, and a ball somewhere before it.
    fn seen(seed: &mut u64) -> (LodView, Sphere, f32) {
        let object_to_eye = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        let view =
            LodView { object_to_eye, scale: 1.0, rounding: 0.0, focal: 500.0, widest: 3.0, near: 0.01 };
        let depth = 10f64.powf(3.0 * random(seed) - 1.0);
        let mut across = || ((2.4 * random(seed) - 1.2) * depth) as f32;
        let center = [across(), across(), -depth as f32];
        let radius = depth * 10f64.powf(-4.0 * random(seed)) * 0.9;
        let error = radius * 10f64.powf(-3.0 * random(seed));
        (view, Sphere { center, radius: radius as f32 }, error as f32)
    }

    #[test]
    fn nothing_on_the_picture_moves_farther_than_stated() {
        let seed = &mut 5;
        let (mut tested, mut tightest) = (0, 0.0f64);
        for _ in 0..200_000 {
            let (view, sphere, error) = seen(seed);
            let mut direction = || {
                let v: [f64; 3] = std::array::from_fn(|_| 2.0 * random(seed) - 1.0);
                let size = v.iter().map(|x| x * x).sum::<f64>().sqrt();
                v.map(|x| x / size)
            };
            let (to, step) = (direction(), direction());
            let at = |k: usize| f64::from(sphere.center[k]) + to[k] * f64::from(sphere.radius);
            let p: [f64; 3] = std::array::from_fn(at);
            let q: [f64; 3] = std::array::from_fn(|k| p[k] + step[k] * f64::from(error));
            let place = |p: [f64; 3]| [p[0] / -p[2], p[1] / -p[2]];
            let shown = |p: [f64; 3]| -p[2] > 0.01 && place(p).iter().all(|x| x.abs() <= 1.0);
            // The way from one to the other stays on the picture, which is convex.
            if !shown(p) || !shown(q) {
                continue;
            }
            let (a, b) = (place(p), place(q));
            let moved = 500.0 * (a[0] - b[0]).hypot(a[1] - b[1]);
            let stated = f64::from(view.pixels(&sphere, error));
            assert!(moved <= stated * (1.0 + 1e-5), "{sphere:?} {error}: {moved} {stated}");
            (tested, tightest) = (tested + 1, tightest.max(moved / stated));
        }
        assert!(tested > 50_000 && tightest > 0.9, "{tested} {tightest}");
    }

    #[test]
    fn a_ball_around_a_ball_states_no_less() {
        let seed = &mut 9;
        for _ in 0..200_000 {
            let (view, inner, error) = seen(seed);
            let part = random(seed).powi(4);
            let away: [f64; 3] =
                std::array::from_fn(|_| part * f64::from(inner.radius) * (random(seed) - 0.5));
            let center = std::array::from_fn(|k| (f64::from(inner.center[k]) + away[k]) as f32);
            let outer = Sphere::of_spheres(&[inner, Sphere { center, radius: inner.radius }]);
            let larger = error * (1.0 + 1.0 / 32768.0);
            assert!(view.pixels(&outer, larger) >= view.pixels(&inner, error), "{inner:?} {outer:?} {error}");
        }
    }

    /// Balls of all sizes, some of them points, inside of a ball, as seen from near and far; coordinates are up to 2¹⁴ times
    /// as large as the distance.
    #[test]
    fn whatever_is_inside_of_a_ball_states_no_less_than_the_least() {
        let seed = &mut 13;
        let (mut tested, mut nearest) = (0, f32::INFINITY);
        for _ in 0..200_000 {
            let (mut view, mut inner, error) = seen(seed);
            let away = f64::from(-inner.center[2]) * 2f64.powf(15.0 * random(seed) - 1.0);
            for (row, x) in view.object_to_eye.iter_mut().zip(&mut inner.center) {
                row[3] = (away * (random(seed) - 0.5)) as f32;
                *x -= row[3];
            }
            inner.radius *= (random(seed) * 2.0 - 1.0).max(0.0) as f32;
            let part = 3.0 * random(seed).powi(4);
            let center = inner.center.map(|x| x + (part * f64::from(error) * (random(seed) - 0.5)) as f32);
            let outer = Sphere::of_spheres(&[inner, Sphere { center, radius: inner.radius }]);
            let (least, own) = (view.least_pixels(&outer, error), view.pixels(&inner, error));
            assert!(least <= own, "{inner:?} {outer:?} {error}: {least} {own}");
            let larger = error * (1.0 + random(seed) as f32);
            assert!(least <= view.pixels(&inner, larger), "{inner:?} {outer:?} {error}");
            (tested, nearest) = (tested + 1, nearest.min(own / least));
        }
        assert!(tested == 200_000 && nearest < 1.02, "{nearest}");
        let (view, sphere) = (seen(seed).0, Sphere { center: [0.0, 0.0, -2.0], radius: 1.0 });
        assert_eq!([-1.0, 0.0].map(|error| view.least_pixels(&sphere, error)), [-1.0, 0.0]);
        let parallel = LodView { near: 0.0, ..view };
        assert_eq!(parallel.least_pixels(&sphere, 0.25), 125.0);
    }

    #[test]
    fn singular_value_of_scale_shear_and_rotation() {
        assert!(
            (singular_value_bound([[2.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, -5.0]]) - 5.0).abs() < 1e-9
        );
        let golden = f64::midpoint(1.0, 5f64.sqrt());
        assert!(
            (singular_value_bound([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) - golden).abs() < 1e-9
        );
    }
}
