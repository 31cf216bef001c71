//! The look of an instance: one metallic-roughness material.

use crate::error::{Error, Result};

/// Factors of glTF's metallic-roughness model, linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Base colour, linear RGB, 0 to 1.
    pub base_color: [f32; 3],
    /// 0 dielectric to 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1; clamped to 0.04 and above when shaded.
    pub roughness: f32,
    /// Light given off, linear RGB.
    pub emissive: [f32; 3],
    /// Draw back faces too.
    pub double_sided: bool,
    /// Shade with interpolated vertex normals; otherwise with the normal of each face.
    pub smooth: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            base_color: [0.8; 3],
            metallic: 0.0,
            roughness: 0.6,
            emissive: [0.0; 3],
            double_sided: false,
            smooth: true,
        }
    }
}

/// A material with all that does not depend on the pixel worked out, for pyrender's reflectance model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflectance {
    /// Base colour.
    pub base: [f32; 3],
    /// What is reflected in all directions.
    pub diffuse: [f32; 3],
    /// What is reflected at right angles.
    pub f0: [f32; 3],
    /// α² of GGX.
    pub alpha2: f32,
    /// k of Smith's G.
    pub k: f32,
    /// Light given off.
    pub emissive: [f32; 3],
}

impl Material {
    /// What shading needs of it.
    pub fn reflectance(&self) -> Reflectance {
        let roughness = self.roughness.clamp(0.04, 1.0);
        let metallic = self.metallic.clamp(0.0, 1.0);
        let base = self.base_color;
        Reflectance {
            base,
            diffuse: base.map(|c| c * 0.96 * (1.0 - metallic)),
            f0: base.map(|c| 0.04 * (1.0 - metallic) + c * metallic),
            alpha2: roughness.powi(4),
            k: (roughness + 1.0) * (roughness + 1.0) / 8.0,
            emissive: self.emissive,
        }
    }

    /// Checks every range; the error names the field.
    pub fn validate(&self) -> Result<()> {
        let unit = |name: &'static str, value: f32| {
            if (0.0..=1.0).contains(&value) {
                Ok(())
            } else {
                Err(Error::argument(name, format!("must be between 0 and 1, not {value}")))
            }
        };
        self.base_color.iter().try_for_each(|&c| unit("base_color", c))?;
        unit("metallic", self.metallic)?;
        unit("roughness", self.roughness)?;
        if let Some(bad) = self.emissive.iter().find(|c| !(c.is_finite() && **c >= 0.0)) {
            return Err(Error::argument("emissive", format!("must be finite and not negative, not {bad}")));
        }
        Ok(())
    }
}
