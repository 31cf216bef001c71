//! The light of a scene as seen from a view, in the precision of shading.

use super::{LightKind, Scene, View};
use crate::config::Transfer;

/// A light in camera space.
#[derive(Clone, Copy, Debug)]
pub struct ShadeLight {
    /// Towards the light, unit (directional), or its position.
    pub vector: [f32; 3],
    /// Colour times intensity.
    pub radiance: [f32; 3],
    /// `None` for directional; 1/range for a point light, 0 without range.
    pub point: Option<f32>,
}

/// Lights and background of a scene as seen from a view.
#[derive(Clone, Debug)]
pub struct Lighting {
    /// All lights.
    pub lights: Vec<ShadeLight>,
    /// Light from everywhere.
    pub ambient: [f32; 3],
    /// The background as it is written.
    pub background: [u8; 3],
    /// How colours are encoded.
    pub transfer: Transfer,
}

impl Lighting {
    /// Moves a scene's lights to camera space.
    pub fn new(scene: &Scene, view: &View, transfer: Transfer) -> Self {
        let rotate = view.pose.matrix3.inverse();
        let lights = scene.lights().iter().map(|(_, light)| {
            let (vector, point) = match light.kind {
                LightKind::Directional => ((rotate * light.pose.matrix3.z_axis).normalize_or_zero(), None),
                LightKind::Point { range } => {
                    (rotate * (light.pose.translation - view.eye()), Some(range.map_or(0.0, |r| 1.0 / r)))
                }
            };
            let radiance = light.color.map(|c| c * light.intensity);
            ShadeLight { vector: vector.as_vec3().to_array(), radiance, point }
        });
        let byte = |c: f32| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        Self {
            lights: lights.collect(),
            ambient: scene.ambient_light(),
            background: scene.bg_color().map(byte),
            transfer,
        }
    }

    /// The light that the background is written for.
    pub fn behind(&self) -> [f32; 3] {
        self.background.map(|byte| self.transfer.light(byte))
    }
}
