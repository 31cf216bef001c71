//! Cameras with pyrender's parameters, and the view they make with a pose and a picture size.
//!
//! Depth is reversed and infinite: the rasterizers interpolate near ÷ distance, so nothing needs a far plane;
//! `zfar` only cuts.

use glam::{DAffine3, DVec3};

use super::pose;
use crate::error::{Error, Result};
use crate::math::LodView;
use crate::math::sphere::round_up;
use crate::model::CoordinateFrame;

/// Largest width and height of a picture: with it, every edge function stays in range.
pub const MAX_VIEWPORT: u32 = 8192;

/// How points are projected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Pinhole by field of view.
    Perspective {
        /// Vertical field of view, radians.
        yfov: f64,
        /// Width over height of the field of view; `None` takes the picture's.
        aspect: Option<f64>,
    },
    /// Pinhole by focal lengths and centre in pixels; x right, y down from the upper left corner.
    Intrinsics {
        /// Focal length along x, pixels.
        fx: f64,
        /// Focal length along y, pixels.
        fy: f64,
        /// Optical centre, pixels from the left edge; half the width is the middle.
        cx: f64,
        /// Optical centre, pixels from the upper edge.
        cy: f64,
        /// Pixels to the right for each unit of tangent down.
        skew: f64,
    },
    /// Parallel.
    Orthographic {
        /// Half the width of the view, world units; `None` takes the picture's of that height.
        xmag: Option<f64>,
        /// Half the height of the view, world units.
        ymag: f64,
    },
}

/// A projection with its clip distances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// The projection.
    pub projection: Projection,
    /// Nothing nearer is drawn; positive.
    pub znear: f64,
    /// Nothing farther is drawn; `None` draws everything.
    pub zfar: Option<f64>,
}

/// A camera at a pose, for a picture of some size. All in f64; stages derive f32 matrices from it.
#[derive(Clone, Debug)]
pub struct View {
    /// Picture width, pixels.
    pub width: u32,
    /// Picture height, pixels.
    pub height: u32,
    /// Parallel instead of pinhole.
    pub orthographic: bool,
    /// Pixels per unit of tangent (pinhole) or per world unit (parallel), along x and y.
    pub focal: [f64; 2],
    /// Pixels to the right per unit of tangent down: sides of pixels that are not at right angles.
    pub skew: f64,
    /// Where the optical axis meets the picture, pixels from the upper left corner.
    pub center: [f64; 2],
    /// Near distance.
    pub near: f64,
    /// Far distance.
    pub far: Option<f64>,
    /// Camera to world: a rotation, and the eye.
    pub pose: DAffine3,
}

fn positive(argument: &'static str, value: f64) -> Result<()> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(Error::argument(argument, format!("must be positive and finite, not {value}")))
    }
}

impl Camera {
    /// Checks every parameter; the error names it.
    pub fn validate(&self) -> Result<()> {
        match self.projection {
            Projection::Perspective { yfov, aspect } => {
                if !(yfov > 0.0 && yfov < std::f64::consts::PI) {
                    return Err(Error::argument(
                        "yfov",
                        format!("must be between 0 and π radians, not {yfov}"),
                    ));
                }
                aspect.map_or(Ok(()), |a| positive("aspectRatio", a))?;
            }
            Projection::Intrinsics { fx, fy, cx, cy, skew } => {
                positive("fx", fx)?;
                positive("fy", fy)?;
                for (name, value) in [("cx", cx), ("cy", cy), ("skew", skew)] {
                    if !value.is_finite() {
                        return Err(Error::argument(name, format!("must be finite, not {value}")));
                    }
                }
            }
            Projection::Orthographic { xmag, ymag } => {
                xmag.map_or(Ok(()), |x| positive("xmag", x))?;
                positive("ymag", ymag)?;
            }
        }
        positive("znear", self.znear)?;
        if !(1.0e-30..=1.0e30).contains(&self.znear) {
            return Err(Error::argument(
                "znear",
                format!("must be between 1e-30 and 1e30, not {}", self.znear),
            ));
        }
        match self.zfar {
            Some(far) if !(far.is_finite() && far > self.znear) => Err(Error::argument(
                "zfar",
                format!("must be greater than znear ({}), not {far}", self.znear),
            )),
            _ => Ok(()),
        }
    }

    /// The view of this camera from a camera-to-world pose on a picture of `width` × `height` pixels.
    pub fn view(&self, pose: &[[f64; 4]; 4], width: u32, height: u32) -> Result<View> {
        self.validate()?;
        for (name, value) in [("width", width), ("height", height)] {
            if !(1..=MAX_VIEWPORT).contains(&value) {
                return Err(Error::argument(
                    name,
                    format!("must be between 1 and {MAX_VIEWPORT}, not {value}"),
                ));
            }
        }
        let (pose, _) = pose::rigid("pose", pose)?;
        let (w, h) = (f64::from(width), f64::from(height));
        let skew = if let Projection::Intrinsics { skew, .. } = self.projection { skew } else { 0.0 };
        let (orthographic, focal, center) = match self.projection {
            Projection::Perspective { yfov, aspect } => {
                let t = (0.5 * yfov).tan();
                (false, [0.5 * w / (aspect.unwrap_or(w / h) * t), 0.5 * h / t], [0.5 * w, 0.5 * h])
            }
            Projection::Intrinsics { fx, fy, cx, cy, .. } => (false, [fx, fy], [cx, cy]),
            Projection::Orthographic { xmag, ymag } => {
                let high = 0.5 * h / ymag;
                (true, [xmag.map_or(high, |xmag| 0.5 * w / xmag), high], [0.5 * w, 0.5 * h])
            }
        };
        let (near, far) = (self.znear, self.zfar);
        Ok(View { width, height, orthographic, focal, skew, center, near, far, pose })
    }
}

impl View {
    /// The eye, world space.
    pub fn eye(&self) -> DVec3 {
        self.pose.translation
    }

    /// The view after as many further steps like that from `before` to this one; nothing where it did not move.
    pub fn ahead(&self, before: &Self, steps: usize) -> Option<Self> {
        let step = before.pose.inverse() * self.pose;
        let pose = (0..steps).fold(self.pose, |pose, _| pose * step);
        let moves = self.pose != before.pose && pose.is_finite();
        moves.then(|| Self { pose, ..self.clone() })
    }

    /// The affine map from a mesh's internal space to camera space (x right, y up, −z forward) for an
    /// instance at `pose`. The eye is subtracted before anything is rotated, so nothing shakes far from the
    /// world's origin.
    pub fn object_to_view(&self, pose: &DAffine3, frame: &CoordinateFrame) -> DAffine3 {
        let rotate = self.pose.matrix3.inverse();
        let origin = pose.matrix3 * DVec3::from_array(frame.origin) + (pose.translation - self.eye());
        DAffine3 { matrix3: rotate * pose.matrix3 * frame.scale, translation: rotate * origin }
    }

    /// The half spaces that hold everything on the picture, one pixel wider, as planes (n, d) about the eye:
    /// a sphere (c, r) is outside when n·(c − eye) + d < −r for any.
    pub fn planes(&self) -> Vec<(DVec3, f64)> {
        let m = &self.pose.matrix3;
        let mut planes = vec![(-m.z_axis, -self.near)];
        planes.extend(self.far.map(|far| (m.z_axis, far)));
        let right = m.x_axis - self.skew / self.focal[0] * m.y_axis;
        for (axis, k, size) in [(right, 0, self.width), (-m.y_axis, 1, self.height)] {
            let low = -1.0 - self.center[k];
            let high = f64::from(size) + 1.0 - self.center[k];
            // low·d ≤ focal·a ≤ high·d, with a along the axis and d the distance.
            let (f, forward) = (self.focal[k], -m.z_axis);
            if self.orthographic {
                planes.push((axis, -low / f));
                planes.push((-axis, high / f));
            } else {
                planes.push(((f * axis - low * forward).normalize(), 0.0));
                planes.push(((high * forward - f * axis).normalize(), 0.0));
            }
        }
        planes
    }

    /// sec² of the angle between the optical axis and the farthest corner of the picture.
    fn sec2(&self) -> f64 {
        let reach = |k: usize, size: u32| {
            let c = self.center[k];
            c.abs().max((f64::from(size) - c).abs()) / self.focal[k]
        };
        let (across, down) = (reach(0, self.width), reach(1, self.height));
        let across = across + self.skew.abs() / self.focal[0] * down;
        1.0 + across * across + down * down
    }

    /// Focal length, widest angle and near distance of [`LodView`].
    pub fn lod_constants(&self) -> (f32, f32, f32) {
        let focal = self.focal[0].max(self.focal[1]) + self.skew.abs();
        let (widest, near) = if self.orthographic { (1.0, 0.0) } else { (self.sec2(), self.near) };
        (round_up(focal), round_up(widest), near as f32)
    }

    /// What the rule of the cut needs for an instance: `object_to_view` from [`View::object_to_view`],
    /// `rounding` that of the mesh, object units, `scale` a bound of the largest singular value of the instance's pose.
    pub fn lod_view(
        &self,
        object_to_view: &DAffine3,
        frame: &CoordinateFrame,
        rounding: f64,
        scale: f64,
    ) -> LodView {
        let (focal, widest, near) = self.lod_constants();
        let rows = pose::rows(object_to_view);
        LodView {
            object_to_eye: std::array::from_fn(|r| rows[r].map(|v| v as f32)),
            scale: round_up(scale * frame.scale * (1.0 + 1.0e-6)),
            rounding: round_up(rounding / frame.scale),
            focal,
            widest,
            near,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: [[f64; 4]; 4] =
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

    #[test]
    fn field_of_view_and_intrinsics_agree() {
        let fov = Camera {
            projection: Projection::Perspective { yfov: 0.8, aspect: None },
            znear: 0.05,
            zfar: None,
        };
        let a = fov.view(&IDENTITY, 640, 360).unwrap();
        let projection =
            Projection::Intrinsics { fx: a.focal[0], fy: a.focal[1], cx: 320.0, cy: 180.0, skew: 0.0 };
        let b = Camera { projection, ..fov }.view(&IDENTITY, 640, 360).unwrap();
        assert_eq!((a.focal, a.center), (b.focal, b.center));
        assert!((a.focal[0] - a.focal[1]).abs() < 1e-9);
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = Camera {
            projection: Projection::Perspective { yfov: 0.8, aspect: None },
            znear: 0.05,
            zfar: None,
        };
        let fov = |yfov, aspect| Camera { projection: Projection::Perspective { yfov, aspect }, ..good };
        for (camera, name) in [
            (fov(0.0, None), "yfov"),
            (fov(f64::NAN, None), "yfov"),
            (fov(4.0, None), "yfov"),
            (fov(0.8, Some(0.0)), "aspectRatio"),
            (Camera { znear: 0.0, ..good }, "znear"),
            (Camera { zfar: Some(0.01), ..good }, "zfar"),
            (Camera { projection: Projection::Orthographic { xmag: Some(-1.0), ymag: 1.0 }, ..good }, "xmag"),
        ] {
            let message = camera.view(&IDENTITY, 8, 8).unwrap_err().to_string();
            assert!(message.starts_with(&format!("{name}: ")), "{message}");
        }
        assert!(good.view(&IDENTITY, 0, 8).is_err());
        assert!(good.view(&IDENTITY, 8, MAX_VIEWPORT + 1).is_err());
    }

    #[test]
    fn far_from_the_origin_the_relative_map_keeps_its_digits() {
        let far = 1.0e7;
        let mut eye = IDENTITY;
        eye[0][3] = far;
        let camera = Camera {
            projection: Projection::Perspective { yfov: 0.8, aspect: None },
            znear: 0.05,
            zfar: None,
        };
        let view = camera.view(&eye, 64, 64).unwrap();
        let object = DAffine3::from_translation(DVec3::new(far + 0.125, 0.0, -2.0));
        let frame = CoordinateFrame { origin: [0.0; 3], scale: 1.0, rounding: 0.0 };
        let map = view.object_to_view(&object, &frame);
        assert_eq!(map.translation.to_array(), [0.125, 0.0, -2.0]);
    }
}
