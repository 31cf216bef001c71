//! The light of a scene as seen from a view, in the precision of shading.

use super::{LightKind, Scene, Surroundings, View};
use crate::config::{Shading, Transfer};

/// The least difference of the cosines between which a spot falls off: glTF's and pyrender's.
const NARROWEST_RIM: f64 = 0.001;

/// A light in camera space.
#[derive(Clone, Copy, Debug)]
pub struct ShadeLight {
    /// Towards the light, unit (directional), or its position.
    pub vector: [f32; 3],
    /// Colour times intensity.
    pub radiance: [f32; 3],
    /// How it falls off from its position; `None` for directional.
    pub falloff: Option<Falloff>,
}

/// How a light with a position falls off, besides with the square of the distance.
#[derive(Clone, Copy, Debug)]
pub struct Falloff {
    /// One over the distance at which it ends; 0 never.
    pub inverse_range: f32,
    /// The way it shines, unit; zero where it shines in all directions.
    pub direction: [f32; 3],
    /// Times the cosine of the angle from there, plus the offset: the root of what is left of it, held to 0 and 1.
    pub cone_scale: f32,
    /// 1 where it shines in all directions.
    pub cone_offset: f32,
}

/// Lights and background of a scene as seen from a view.
#[derive(Clone, Debug)]
pub struct Lighting {
    /// All lights.
    pub lights: Vec<ShadeLight>,
    /// Light from everywhere.
    pub ambient: [f32; 3],
    /// The environment map, which glTF's shading alone uses.
    pub environment: Option<Surroundings>,
    /// The background as it is written.
    pub background: [u8; 3],
    /// What colours are.
    pub shading: Shading,
    /// How colours are encoded.
    pub transfer: Transfer,
}

impl Lighting {
    /// Moves a scene's lights to camera space.
    pub fn new(scene: &Scene, view: &View, shading: Shading, transfer: Transfer) -> Self {
        // Normals are no light.
        let transfer = if shading == Shading::Normals { Transfer::Linear } else { transfer };
        let rotate = view.pose.matrix3.inverse();
        let lights = scene.lights().iter().filter(|(_, light)| light.visible).map(|(_, light)| {
            let axis = (rotate * light.pose.matrix3.z_axis).normalize_or_zero();
            let position = rotate * (light.pose.translation - view.eye());
            let inverse = |range: Option<f32>| range.map_or(0.0, |r| 1.0 / r);
            let (vector, falloff) = match light.kind {
                LightKind::Directional => (axis, None),
                LightKind::Point { range } => {
                    let around = Falloff {
                        inverse_range: inverse(range),
                        direction: [0.0; 3],
                        cone_scale: 0.0,
                        cone_offset: 1.0,
                    };
                    (position, Some(around))
                }
                LightKind::Spot { range, inner, outer } => {
                    let scale = 1.0 / (inner.cos() - outer.cos()).max(NARROWEST_RIM);
                    let cone = Falloff {
                        inverse_range: inverse(range),
                        direction: (-axis).as_vec3().to_array(),
                        cone_scale: scale as f32,
                        cone_offset: (-outer.cos() * scale) as f32,
                    };
                    (position, Some(cone))
                }
            };
            let radiance = light.color.map(|c| c * light.intensity);
            ShadeLight { vector: vector.as_vec3().to_array(), radiance, falloff }
        });
        let environment = scene.environment().filter(|_| shading == Shading::Gltf);
        let byte = |c: f32| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        Self {
            lights: lights.collect(),
            ambient: scene.ambient_light(),
            environment: environment.map(|environment| Surroundings::new(environment, view)),
            background: scene.bg_color().map(byte),
            shading,
            transfer,
        }
    }

    /// The light that the background is written for.
    pub fn behind(&self) -> [f32; 3] {
        self.background.map(|byte| self.transfer.light(byte))
    }
}
