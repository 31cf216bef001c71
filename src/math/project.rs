//! From an error in object units to an error in pixels.

use super::Sphere;

/// What the level-of-detail test needs of a view and an instance: how far a sphere is, and how large a unit
/// of error looks there. All lengths are in camera-relative world units.
#[derive(Clone, Copy, Debug)]
pub struct LodView {
    /// Rows of the affine map from the mesh's internal space to camera-relative world space.
    pub object_to_eye: [[f32; 4]; 3],
    /// An upper bound of the largest singular value of its linear part.
    pub scale: f32,
    /// Pixels per unit of tangent, times sec² of the view's half diagonal (perspective), or pixels per world
    /// unit (orthographic).
    pub focal: f32,
    /// Distance of the near plane; 0 selects the orthographic form.
    pub near: f32,
}

impl LodView {
    /// An upper bound, in pixels, of how far a displacement of `error` anywhere on `sphere` moves on the
    /// screen. DESIGN: px = E·s·f·sec²θ ÷ max(|c − eye| − r·s − E·s, near).
    ///
    /// Monotone in `error` and under enclosing spheres, rounding included: see `model::rule`.
    pub fn pixels(&self, sphere: &Sphere, error: f32) -> f32 {
        if error <= 0.0 {
            return error;
        }
        let world = error * self.scale;
        if self.near == 0.0 {
            return world * self.focal;
        }
        let m = &self.object_to_eye;
        let c = sphere.center;
        let at = |r: usize| m[r][0] * c[0] + m[r][1] * c[1] + m[r][2] * c[2] + m[r][3];
        let (x, y, z) = (at(0), at(1), at(2));
        let distance = (x * x + y * y + z * z).sqrt() - sphere.radius * self.scale - world;
        world * self.focal / distance.max(self.near)
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
