//! The look of an instance: metallic-roughness materials.

use std::sync::Arc;

use super::texture::Texture;
use crate::config::Shading;
use crate::error::{Error, Result};
use crate::limits::LEAST_ROUGHNESS;

/// The textures of a material, by their place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// Colour, and alpha.
    BaseColor,
    /// Roughness in green, metallic in blue.
    MetallicRoughness,
    /// Normals in tangent space.
    Normal,
    /// Of light from everywhere, how much arrives, in red.
    Occlusion,
    /// Emitted light.
    Emissive,
}

impl Slot {
    /// How many there are.
    pub const COUNT: usize = 5;
    /// All of them, in their order.
    pub const ALL: [Self; Self::COUNT] =
        [Self::BaseColor, Self::MetallicRoughness, Self::Normal, Self::Occlusion, Self::Emissive];

    /// The name by which callers give it.
    pub fn name(self) -> &'static str {
        match self {
            Self::BaseColor => "base_color_texture",
            Self::MetallicRoughness => "metallic_roughness_texture",
            Self::Normal => "normal_texture",
            Self::Occlusion => "occlusion_texture",
            Self::Emissive => "emissive_texture",
        }
    }
}

/// Factors of glTF's metallic-roughness model, linear, and the textures that multiply them.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Base colour, linear RGB, 0 to 1.
    pub base_color: [f32; 3],
    /// 0 to 1.
    pub alpha: f32,
    /// 0 dielectric to 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1; clamped to 0.04 and above when shaded.
    pub roughness: f32,
    /// Emitted light, linear RGB.
    pub emissive: [f32; 3],
    /// Draw back faces too.
    pub double_sided: bool,
    /// Shade with interpolated vertex normals; otherwise with the normal of each face.
    pub smooth: bool,
    /// Shown as its base colour, whatever the light (`KHR_materials_unlit`).
    pub unlit: bool,
    /// Times X and Y of the normal texture.
    pub normal_scale: f32,
    /// How much of the occlusion texture counts, 0 to 1.
    pub occlusion_strength: f32,
    /// The alpha cutoff: where alpha is below it, nothing is drawn. `None` of an opaque material.
    pub alpha_cutoff: Option<f32>,
    /// What is behind it is seen as far as alpha lets it.
    pub blends: bool,
    /// By [`Slot`].
    pub textures: [Option<Texture>; Slot::COUNT],
}

impl Default for Material {
    fn default() -> Self {
        Self {
            base_color: [0.3; 3],
            alpha: 1.0,
            metallic: 0.2,
            roughness: 0.8,
            emissive: [0.0; 3],
            double_sided: false,
            smooth: true,
            unlit: false,
            normal_scale: 1.0,
            occlusion_strength: 1.0,
            alpha_cutoff: None,
            blends: false,
            textures: Default::default(),
        }
    }
}

/// The materials of an instance: that of cluster material n is the n-th, or the last where there are fewer.
#[derive(Clone, Debug, PartialEq)]
pub struct Materials {
    list: Arc<[Material]>,
    /// A bit for each of the first numbers; the last stands for all from there on.
    double_sided: u32,
    /// The same for alpha tests.
    alpha_tested: u32,
    /// The same for what is blended; and for that whose alpha is below 1 by itself.
    blends: u32,
    translucent: u32,
    /// Any of them is smooth.
    smooth: bool,
    /// There is one, with neither textures nor alpha test. Asked for every few pixels.
    plain: bool,
}

impl From<Material> for Materials {
    fn from(material: Material) -> Self {
        Self::from(vec![material])
    }
}

impl From<Vec<Material>> for Materials {
    fn from(list: Vec<Material>) -> Self {
        let list: Arc<[Material]> = if list.is_empty() { [Material::default()].into() } else { list.into() };
        let smooth = list.iter().any(|material| material.smooth);
        let double_sided = bits(&list, |material| material.double_sided);
        let alpha_tested = bits(&list, Material::is_alpha_tested);
        let blends = bits(&list, |material| material.blends);
        let translucent = bits(&list, Material::is_translucent);
        let plain = list.len() == 1 && list[0].textures.iter().all(Option::is_none) && alpha_tested == 0;
        Self { list, double_sided, alpha_tested, blends, translucent, smooth, plain }
    }
}

/// A bit for each of the first numbers of materials; the last stands for all from there on.
fn bits(list: &[Material], is: impl Fn(&Material) -> bool) -> u32 {
    let (own, rest) = list.split_at(list.len().min(u32::BITS as usize - 1));
    let any = if rest.is_empty() { own.last().is_some_and(&is) } else { rest.iter().any(&is) };
    let bit = |k: usize| u32::from(own.get(k).map_or(any, &is)) << k;
    (0..u32::BITS as usize).map(bit).sum()
}

/// The bit of a number among those that [`bits`] made.
#[inline]
fn bit(bits: u32, number: i32) -> bool {
    bits >> number.cast_unsigned().min(u32::BITS - 1) & 1 != 0
}

impl Materials {
    /// Whether they are these very ones, and not equal ones.
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.list, &other.list)
    }

    /// Whether normals are interpolated anywhere.
    #[inline]
    pub fn smooth(&self) -> bool {
        self.smooth
    }

    /// The material of clusters with this number.
    #[inline]
    pub fn of(&self, number: i32) -> &Material {
        &self.list[self.index(number)]
    }

    /// Place among them of the material of clusters with this number.
    #[inline]
    pub fn index(&self, number: i32) -> usize {
        (number.cast_unsigned() as usize).min(self.list.len() - 1)
    }

    /// All of them.
    pub fn list(&self) -> &[Material] {
        &self.list
    }

    /// The only one, where it has neither textures nor alpha test.
    #[inline]
    pub fn plain(&self) -> Option<&Material> {
        self.plain.then(|| self.of(0))
    }

    /// Whether clusters with a number show their back faces: a bit each, the last for all from there on.
    #[inline]
    pub fn double_sided_bits(&self) -> u32 {
        self.double_sided
    }

    /// Whether clusters with this number show their back faces.
    #[inline]
    pub fn double_sided(&self, number: i32) -> bool {
        bit(self.double_sided, number)
    }

    /// Whether clusters with a number are alpha-tested: a bit each, in the same way.
    #[inline]
    pub fn alpha_tested_bits(&self) -> u32 {
        self.alpha_tested
    }

    /// Whether clusters with this number are alpha-tested.
    #[inline]
    pub fn alpha_tested(&self, number: i32) -> bool {
        bit(self.alpha_tested, number)
    }

    /// Whether clusters with this number are blended: those of a mesh with alpha in its colours, or of all.
    #[inline]
    pub fn blended(&self, number: i32, alpha_in_colors: bool) -> bool {
        bit(self.blends, number) && (alpha_in_colors || bit(self.translucent, number))
    }

    /// Whether any may be.
    pub fn any_blended(&self, alpha_in_colors: bool) -> bool {
        self.blends & if alpha_in_colors { u32::MAX } else { self.translucent } != 0
    }

    /// Checks each of them.
    pub fn validate(&self) -> Result<()> {
        self.list.iter().try_for_each(Material::validate)
    }
}

impl Material {
    /// Perceptual roughness where a texture has this, as it is shaded.
    #[inline(always)]
    pub fn shaded_roughness(&self, texture: f32) -> f32 {
        (self.roughness * texture).clamp(LEAST_ROUGHNESS, 1.0)
    }

    /// What it gives off where a texture has 1, as it is shaded: pyrender multiplies by it twice.
    #[inline(always)]
    pub fn shaded_emission(&self, shading: Shading) -> [f32; 3] {
        match shading {
            Shading::Pyrender => self.emissive.map(|c| c * c),
            _ => self.emissive,
        }
    }

    /// Below zero where light does not count, and otherwise above.
    #[inline(always)]
    pub fn lit(&self) -> f32 {
        if self.unlit { -1.0 } else { 1.0 }
    }

    /// Whether alpha is below the cutoff anywhere, as far as one can tell without looking at each texel.
    pub fn is_alpha_tested(&self) -> bool {
        self.alpha_cutoff.is_some_and(|cutoff| self.alpha_varies() || self.alpha < cutoff)
    }

    /// Whether alpha is below 1 anywhere, in the same way.
    fn is_translucent(&self) -> bool {
        self.alpha_varies() || self.alpha < 1.0
    }

    fn alpha_varies(&self) -> bool {
        let texture = self.textures[Slot::BaseColor as usize].as_ref();
        texture.is_some_and(|texture| !texture.image.opaque())
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
        unit("alpha", self.alpha)?;
        unit("metallic", self.metallic)?;
        unit("roughness", self.roughness)?;
        if let Some(bad) = self.emissive.iter().find(|c| !(c.is_finite() && **c >= 0.0)) {
            return Err(Error::argument("emissive", format!("must be finite and not negative, not {bad}")));
        }
        unit("occlusion_strength", self.occlusion_strength)?;
        for (name, value) in [("normal_scale", Some(self.normal_scale)), ("alpha_cutoff", self.alpha_cutoff)]
        {
            if let Some(value) = value.filter(|value| !value.is_finite()) {
                return Err(Error::argument(name, format!("must be finite, not {value}")));
            }
        }
        self.textures.iter().flatten().try_for_each(Texture::validate)
    }
}
