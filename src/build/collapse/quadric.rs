//! Sums of squared affine forms (Garland and Heckbert, "Surface Simplification Using Quadric Error Metrics", 1997).

use std::ops::{Add, AddAssign, SubAssign};

use glam::{DVec3, DVec4};

/// x ↦ Σ weight · (form · (x, 1))²: the upper triangle of a symmetric 4 × 4 matrix, row after row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quadric([f64; 10]);

impl Quadric {
    /// The square of a form, weighted.
    #[inline]
    pub fn of_square(form: DVec4, weight: f64) -> Self {
        let mut new = Self::default();
        new.add_square(form, weight);
        new
    }

    /// Adds the square of a form, weighted; a negative weight takes it away again.
    #[inline]
    pub fn add_square(&mut self, form: DVec4, weight: f64) {
        let [x, y, z, w] = form.to_array();
        let [a, b, c, d] = (form * weight).to_array();
        let squares = [a * x, a * y, a * z, a * w, b * y, b * z, b * w, c * z, c * w, d * w];
        for k in 0..10 {
            self.0[k] += squares[k];
        }
    }

    /// The same with every weight times `factor`.
    pub fn scaled(self, factor: f64) -> Self {
        Self(self.0.map(|q| q * factor))
    }

    /// The value at a point; rounding may leave it a little below zero.
    #[inline]
    pub fn at(&self, p: DVec3) -> f64 {
        let [xx, xy, xz, xw, yy, yz, yw, zz, zw, ww] = self.0;
        let x = p.x * (xx * p.x + 2.0 * (xy * p.y + xz * p.z + xw));
        let y = p.y * (yy * p.y + 2.0 * (yz * p.z + yw));
        x + y + p.z * (zz * p.z + 2.0 * zw) + ww
    }

    /// The offset from `origin` to the minimum of this plus `ridge` · |offset|². None if the ridge is so small
    /// that rounding leaves no minimum.
    #[inline]
    pub fn minimum_near(&self, origin: DVec3, ridge: f64) -> Option<DVec3> {
        let [xx, xy, xz, xw, yy, yz, yw, zz, zw, _] = self.0;
        let g = [
            xx * origin.x + xy * origin.y + xz * origin.z + xw,
            xy * origin.x + yy * origin.y + yz * origin.z + yw,
            xz * origin.x + yz * origin.y + zz * origin.z + zw,
        ];
        // L D Lᵀ; the ridge keeps the pivots positive.
        let d0 = xx + ridge;
        let (l10, l20) = (xy / d0, xz / d0);
        let d1 = yy + ridge - l10 * xy;
        let l21 = (yz - l20 * xy) / d1;
        let d2 = zz + ridge - l20 * xz - l21 * l21 * d1;
        if !(d0 > 0.0 && d1 > 0.0 && d2 > 0.0) {
            return None;
        }
        let y0 = -g[0];
        let y1 = -g[1] - l10 * y0;
        let y2 = -g[2] - l20 * y0 - l21 * y1;
        let z = y2 / d2;
        let y = y1 / d1 - l21 * z;
        let x = y0 / d0 - l10 * y - l20 * z;
        Some(DVec3::new(x, y, z)).filter(|p| p.is_finite())
    }

    /// The parameter of the minimum along origin + t · direction, if there is one.
    pub fn minimum_along(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        let [xx, xy, xz, xw, yy, yz, yw, zz, zw, _] = self.0;
        let slope = |p: DVec3, w: f64| {
            DVec3::new(
                xx * p.x + xy * p.y + xz * p.z + w * xw,
                xy * p.x + yy * p.y + yz * p.z + w * yw,
                xz * p.x + yz * p.y + zz * p.z + w * zw,
            )
        };
        let t = -slope(origin, 1.0).dot(direction) / slope(direction, 0.0).dot(direction);
        Some(t).filter(|t| t.is_finite())
    }
}

impl AddAssign for Quadric {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        for k in 0..10 {
            self.0[k] += other.0[k];
        }
    }
}

impl SubAssign for Quadric {
    #[inline]
    fn sub_assign(&mut self, other: Self) {
        for k in 0..10 {
            self.0[k] -= other.0[k];
        }
    }
}

impl Add for Quadric {
    type Output = Self;

    #[inline]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_planes_meet_where_the_value_is_zero() {
        let corner = DVec3::new(0.25, -3.0, 7.5);
        let mut quadric = Quadric::default();
        for (normal, weight) in [(DVec3::X, 2.0), (DVec3::new(0.6, 0.8, 0.0), 0.5), (DVec3::Z, 10.0)] {
            quadric.add_square(normal.extend(-normal.dot(corner)), weight);
        }
        let origin = DVec3::new(1.0, 1.0, 1.0);
        let found = origin + quadric.minimum_near(origin, 1e-14).unwrap();
        assert!((found - corner).length() < 1e-9, "{found}");
        assert!(quadric.at(corner).abs() < 1e-12);
        assert!((quadric.at(corner + DVec3::Z) - 10.0).abs() < 1e-12);
        let t = quadric.minimum_along(corner - 2.0 * DVec3::Z, DVec3::Z).unwrap();
        assert!((t - 2.0).abs() < 1e-12);
    }

    #[test]
    fn no_planes_stay_where_they_are() {
        let origin = DVec3::new(1.0, 2.0, 3.0);
        assert_eq!(Quadric::default().minimum_near(origin, 0.0), None);
        assert_eq!(Quadric::default().minimum_near(origin, 1e-9), Some(DVec3::ZERO));
        assert_eq!(Quadric::default().minimum_along(origin, DVec3::X), None);
    }
}
