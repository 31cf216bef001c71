//! Where instances and eyes are, in the precision of the stages: positions as sums of two f32, so that their difference
//! keeps its digits far from the world's origin; everything else as f32.

use glam::{DAffine3, DMat3, DVec3};

use super::camera::View;
use super::pose;
use crate::math::sphere::round_up;
use crate::model::CoordinateFrame;

/// A number as the sum of two f32, some 48 bits.
fn split(v: f64) -> (f32, f32) {
    let high = v as f32;
    (high, if high.is_finite() { (v - f64::from(high)) as f32 } else { 0.0 })
}

fn split_vector(v: DVec3) -> ([f32; 3], [f32; 3]) {
    let parts = v.to_array().map(split);
    (parts.map(|p| p.0), parts.map(|p| p.1))
}

/// An instance: the map from its mesh's internal space to the world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Placement {
    /// Rows of the linear part.
    pub linear: [[f32; 3]; 3],
    /// Rows of its inverse.
    pub inverse: [[f32; 3]; 3],
    /// Rows of the map of normals to the world; not normalized.
    pub normal: [[f32; 3]; 3],
    /// `normal` keeps angles: interpolated normals may be mapped after interpolation.
    pub conformal: bool,
    /// The origin of internal space.
    pub high: [f32; 3],
    /// What `high` leaves.
    pub low: [f32; 3],
    /// An upper bound of the largest singular value of the linear part.
    pub lod_scale: f32,
    /// See [`crate::math::LodView::rounding`].
    pub rounding: f32,
    /// It reverses orientation.
    pub mirrored: bool,
}

impl Placement {
    /// Of an instance at a pose that stretches lengths by up to `scale`; `rounding` is that of its mesh, object units.
    pub fn new(pose: &DAffine3, frame: &CoordinateFrame, rounding: f64, scale: f64) -> Self {
        let linear = pose.matrix3 * frame.scale;
        let (high, low) = split_vector(pose.transform_point3(DVec3::from_array(frame.origin)));
        let rows = |m| pose::linear_rows(&m).map(|row: [f64; 3]| row.map(|v| v as f32));
        let normal = pose.matrix3.inverse().transpose();
        // Up to a common factor: keeps f32 in range whatever the scale.
        let normal = normal * (1.0 / normal.x_axis.length().max(f64::MIN_POSITIVE));
        Self {
            linear: rows(linear),
            inverse: rows(linear.inverse()),
            normal: rows(normal),
            conformal: is_conformal(&normal),
            high,
            low,
            lod_scale: round_up(scale * frame.scale * (1.0 + 1.0e-6)),
            rounding: round_up(rounding / frame.scale),
            mirrored: linear.determinant() < 0.0,
        }
    }
}

/// True when the linear map is a multiple of a rotation or reflection.
fn is_conformal(m: &DMat3) -> bool {
    let g = m.transpose() * *m;
    let s = g.x_axis.x;
    (g - DMat3::from_diagonal(DVec3::splat(s))).to_cols_array().iter().all(|v| v.abs() <= 1.0e-6 * s)
}

/// An eye: the map from the world to its picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// Rows of the rotation from the world to camera space (x right, y up, −z forward).
    pub rotate: [[f32; 3]; 3],
    /// The direction of sight, world space.
    pub forward: [f32; 3],
    /// Its place.
    pub high: [f32; 3],
    /// What `high` leaves.
    pub low: [f32; 3],
    /// Pixels per unit of tangent (pinhole) or per world unit (parallel); down the picture for y.
    pub focal: [f32; 2],
    /// One over what is used for `focal`, up the picture for y.
    pub inverse_focal: [f32; 2],
    /// Pixels to the right per unit of tangent up the picture.
    pub skew: f32,
    /// Where the optical axis meets the picture, pixels.
    pub center: [f32; 2],
    /// See [`crate::math::LodView::focal`].
    pub lod_focal: f32,
    /// See [`crate::math::LodView::widest`].
    pub lod_widest: f32,
    /// See [`crate::math::LodView::near`].
    pub lod_near: f32,
    /// `rotate` reverses orientation.
    pub mirrored: bool,
}

impl Eye {
    /// The eye of a view.
    pub fn new(view: &View) -> Self {
        let rotate = view.pose.matrix3.inverse();
        let (high, low) = split_vector(view.eye());
        let (lod_focal, lod_widest, lod_near) = view.lod_constants();
        Self {
            rotate: pose::linear_rows(&rotate).map(|row| row.map(|v| v as f32)),
            forward: (-view.pose.matrix3.z_axis).to_array().map(|v| v as f32),
            high,
            low,
            focal: [view.focal[0] as f32, -view.focal[1] as f32],
            inverse_focal: view.focal.map(|f| (1.0 / f) as f32),
            skew: -view.skew as f32,
            center: view.center.map(|v| v as f32),
            lod_focal,
            lod_widest,
            lod_near,
            mirrored: rotate.determinant() < 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_floats_keep_what_one_loses() {
        for v in [1.0e7 + 0.123_456_7, -3.0e-5, 0.0, 16_777_217.0] {
            let (high, low) = split(v);
            assert!((f64::from(high) + f64::from(low) - v).abs() <= v.abs() * 2f64.powi(-47));
        }
        assert_eq!(split(1.0e300), (f32::INFINITY, 0.0));
    }
}
