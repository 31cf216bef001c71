//! Lights. There is no default light: a scene without lights and ambient is black, as in pyrender.

use std::f64::consts::FRAC_PI_2;

use glam::DAffine3;

use crate::error::{Error, Result};

/// Shape of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// Shines along the −Z of its pose everywhere, with `intensity` in lux.
    Directional,
    /// Shines from the origin of its pose, with `intensity` in candela, falling off with the square of the
    /// distance; with `range`, smoothly to zero there (glTF's window).
    Point {
        /// Distance at which the light ends; `None` never.
        range: Option<f32>,
    },
    /// As a point, but within a cone about the −Z of its pose: whole up to the inner angle, nothing from the outer one
    /// on (`KHR_lights_punctual`).
    Spot {
        /// Distance at which the light ends; `None` never.
        range: Option<f32>,
        /// Angle from the axis at which the light begins to fall off, radians.
        inner: f64,
        /// Angle from the axis at which it has ended, radians, at most π/2.
        outer: f64,
    },
}

/// A light with its pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Shape.
    pub kind: LightKind,
    /// Linear RGB.
    pub color: [f32; 3],
    /// Lux, or candela of points and spots.
    pub intensity: f32,
    /// Light-to-world; only its rotation (directional) or its position (point) counts, or both (spot).
    pub pose: DAffine3,
    /// False where it is switched off.
    pub visible: bool,
    /// What is in its way throws shadows, where frames have such.
    pub casts_shadows: bool,
    /// How large it is, which makes its shadows soft: the radius in world units or, of a directional light, the tangent of
    /// half the angle that it is seen at, which is its radius at distance 1. 0 throws sharp shadows.
    pub radius: f64,
}

/// A white directional light of one lux along the −Z of the world, which throws sharp shadows.
impl Default for Light {
    fn default() -> Self {
        Self {
            kind: LightKind::Directional,
            color: [1.0; 3],
            intensity: 1.0,
            pose: DAffine3::IDENTITY,
            visible: true,
            casts_shadows: true,
            radius: 0.0,
        }
    }
}

impl Light {
    /// Checks every range; the error names the field.
    pub fn validate(&self) -> Result<()> {
        if let Some(bad) = self.color.iter().find(|c| !(c.is_finite() && **c >= 0.0)) {
            return Err(Error::argument("color", format!("must be finite and not negative, not {bad}")));
        }
        if !(self.intensity.is_finite() && self.intensity >= 0.0) {
            return Err(Error::argument(
                "intensity",
                format!("must be finite and not negative, not {}", self.intensity),
            ));
        }
        if !(self.radius.is_finite() && self.radius >= 0.0) {
            return Err(Error::argument(
                "radius",
                format!("must be finite and not negative, not {}", self.radius),
            ));
        }
        if let LightKind::Point { range: Some(range) } | LightKind::Spot { range: Some(range), .. } =
            self.kind
            && !(range.is_finite() && range > 0.0)
        {
            return Err(Error::argument("range", format!("must be positive, not {range}")));
        }
        if let LightKind::Spot { inner, outer, .. } = self.kind {
            if !(outer > 0.0 && outer <= FRAC_PI_2) {
                return Err(Error::argument(
                    "outerConeAngle",
                    format!("must be above 0 and at most π/2, not {outer}"),
                ));
            }
            if !(inner >= 0.0 && inner < outer) {
                let message = format!("must be from 0 up to below {outer}, the outer one, not {inner}");
                return Err(Error::argument("innerConeAngle", message));
            }
        }
        Ok(())
    }
}
