//! The materials of a scene on the device, and the images of their textures. Instances that have a plain one are without:
//! theirs lies in their [`crate::gpu_types::InstanceMaterial`].

use std::sync::Arc;

use rustc_hash::{FxHashMap, FxHashSet};
use wgpu::{Buffer, BufferUsages};

use super::context::Context;
use crate::config::Shading;
use crate::error::{Error, Result};
use crate::gpu_types::{
    MATERIAL_SMOOTH, MATERIAL_UNLIT, Material, TEXTURE_FORMAT, TEXTURE_LINEAR, TEXTURE_MIPMAPS, TEXTURE_WRAP,
    Texture,
};
use crate::scene::image::srgb_table;
use crate::scene::{self, Image, Materials, Slot};

/// What the arrays hold, for messages.
const WHAT: &str = "the materials and textures of the scene";

/// Where an image lies.
#[derive(Clone, Debug)]
struct Resident {
    image: Arc<Image>,
    /// Its first level there, words.
    start: u64,
    /// Levels left out, since all would take more than the device allows.
    skipped: u32,
}

/// The arrays on the device.
#[derive(Debug)]
pub(super) struct Buffers {
    pub(super) materials: Buffer,
    pub(super) texels: Buffer,
    /// Some material is alpha-tested.
    pub(super) alpha_tested: bool,
}

/// All materials, and all images.
#[derive(Debug, Default)]
pub(super) struct MaterialTable {
    /// By [`address`].
    images: FxHashMap<usize, Resident>,
    /// Words in use.
    used: u64,
    buffers: Option<Buffers>,
}

impl MaterialTable {
    /// Words before the first image: the light of sRGB bytes.
    const HEAD: u64 = 256;

    /// The arrays, once there is any material to be in them.
    pub(super) fn buffers(&self) -> Option<&Buffers> {
        self.buffers.as_ref()
    }

    /// How many images lack their largest levels, since the device has no room for them.
    pub(super) fn reduced_images(&self) -> u64 {
        self.images.values().filter(|resident| resident.skipped > 0).count() as u64
    }

    /// Puts the materials of all slots on the device, as frames with this shading want them. Returns for each slot the
    /// number of its first, and how many follow; `u32::MAX` for plain ones.
    pub(super) fn upload<'a>(
        &mut self,
        context: &Context,
        slots: impl Iterator<Item = Option<&'a Materials>> + Clone,
        shading: Shading,
    ) -> Result<Vec<[u32; 2]>> {
        let textures = slots.clone().flatten().flat_map(Materials::list).flat_map(|m| &m.textures);
        let images = textures.flatten().map(|texture| texture.image_for(shading));
        self.bring(context, images)?;
        let mut table: Vec<Material> = Vec::new();
        let mut known: FxHashMap<Vec<u8>, u32> = FxHashMap::default();
        let firsts = slots.clone().map(|materials| {
            let Some(materials) = materials else { return [u32::MAX, 0] };
            let own: Vec<Material> =
                materials.list().iter().map(|material| self.record(material, shading)).collect();
            let last = own.len() as u32 - 1;
            let first = *known.entry(bytemuck::cast_slice(&own).to_vec()).or_insert_with(|| {
                table.extend(&own);
                table.len() as u32 - 1 - last
            });
            [first, last]
        });
        let firsts: Vec<[u32; 2]> = firsts.collect();
        if let Some(Buffers { materials, alpha_tested, .. }) = &mut self.buffers {
            *alpha_tested = slots.flatten().any(|materials| materials.alpha_tested_bits() != 0);
            let bytes = size_of_val(&table[..]) as u64;
            if materials.size() < bytes {
                *materials = context.buffer(WHAT, bytes.next_power_of_two(), materials.usage())?;
            }
            context.write(WHAT, materials, 0, bytemuck::cast_slice(&table))?;
        }
        Ok(firsts)
    }

    /// Brings images; those that nobody shows any more leave when there is no room for new ones.
    fn bring<'a>(
        &mut self,
        context: &Context,
        images: impl Iterator<Item = &'a Arc<Image>> + Clone,
    ) -> Result<()> {
        let mut new: Vec<Resident> = Vec::new();
        let mut seen: FxHashSet<usize> = FxHashSet::default();
        for image in images.clone() {
            let at = address(image);
            if seen.insert(at) && !self.images.contains_key(&at) {
                new.push(Resident { image: Arc::clone(image), start: 0, skipped: 0 });
            }
        }
        let room = self.buffers.as_ref().map_or(0, |buffers| buffers.texels.size() / 4);
        if self.buffers.is_none() || self.used + total(&new) > room {
            // All that are shown, anew.
            let mut all: Vec<Resident> = Vec::new();
            seen.clear();
            for image in images {
                if seen.insert(address(image)) {
                    all.push(Resident { image: Arc::clone(image), start: 0, skipped: 0 });
                }
            }
            let most = context.largest_array() / 4 - Self::HEAD;
            fit(&mut all, most)?;
            let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
            let wanted = Self::HEAD + (total(&all) * 5 / 4).min(most);
            let materials = match self.buffers.take() {
                Some(Buffers { materials, .. }) => materials,
                None => context.buffer(WHAT, size_of::<Material>() as u64, storage)?,
            };
            self.images.clear();
            let texels = context.buffer(WHAT, 4 * wanted, storage)?;
            context.write(WHAT, &texels, 0, bytemuck::cast_slice(&srgb_table()[..]))?;
            self.used = Self::HEAD;
            self.buffers = Some(Buffers { materials, texels, alpha_tested: false });
            new = all;
        }
        let Some(Buffers { texels, .. }) = &self.buffers else { return Ok(()) };
        for mut resident in new {
            resident.start = self.used;
            let words = &resident.image.words()[resident.image.offset(resident.skipped)..];
            context.write(WHAT, texels, 4 * self.used, bytemuck::cast_slice(words))?;
            self.used += words.len() as u64;
            self.images.insert(address(&resident.image), resident);
        }
        Ok(())
    }

    /// A material as shaders read it.
    fn record(&self, material: &scene::Material, shading: Shading) -> Material {
        let textures = Slot::ALL.map(|slot| match &material.textures[slot as usize] {
            Some(texture) => self.texture(texture, shading),
            None => Texture { start: u32::MAX, ..bytemuck::Zeroable::zeroed() },
        });
        Material {
            base: material.base_color,
            alpha: material.alpha,
            emissive: material.emissive,
            metallic: material.metallic,
            roughness: material.roughness,
            normal_scale: material.normal_scale,
            occlusion_strength: material.occlusion_strength,
            alpha_cutoff: material.alpha_cutoff.unwrap_or(f32::NEG_INFINITY),
            flags: (u32::from(material.smooth) * MATERIAL_SMOOTH)
                | (u32::from(material.unlit) * MATERIAL_UNLIT),
            textures,
            ..bytemuck::Zeroable::zeroed()
        }
    }

    fn texture(&self, texture: &scene::Texture, shading: Shading) -> Texture {
        let Some(Resident { image, start, skipped }) = self.images.get(&address(texture.image_for(shading)))
        else {
            return Texture { start: u32::MAX, ..bytemuck::Zeroable::zeroed() };
        };
        let size = image.size(*skipped);
        let row = |k: usize| {
            let [u, v, rest] = texture.rows[k];
            [u, v, rest, size[k] as f32]
        };
        let [across, down] = texture.wrap.map(|wrap| wrap as u32);
        Texture {
            rows: [row(0), row(1)],
            start: *start as u32,
            levels: image.levels() - skipped,
            flags: u32::from(texture.uv_set)
                | across << TEXTURE_WRAP
                | down << (TEXTURE_WRAP + 2)
                | u32::from(texture.linear) << TEXTURE_LINEAR
                | (texture.mipmaps as u32) << TEXTURE_MIPMAPS
                | (image.format() as u32) << TEXTURE_FORMAT,
            anisotropy: texture.anisotropy as f32,
        }
    }
}

/// What images are told apart by.
fn address(image: &Arc<Image>) -> usize {
    Arc::as_ptr(image).addr()
}

impl Resident {
    /// How many it takes.
    fn words(&self) -> u64 {
        (self.image.words().len() - self.image.offset(self.skipped)) as u64
    }
}

/// Words of some images.
fn total(images: &[Resident]) -> u64 {
    images.iter().map(Resident::words).sum()
}

/// Leaves largest levels out, of the image that takes most at a time, until no more than so many words are left.
fn fit(images: &mut [Resident], most: u64) -> Result<()> {
    while total(images) > most {
        let largest = images.iter_mut().max_by_key(|resident| resident.words());
        let Some(largest) = largest.filter(|resident| resident.skipped + 1 < resident.image.levels()) else {
            return Err(Error::TooLarge("the device has no room for so many textures".to_owned()));
        };
        largest.skipped += 1;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::image::Pixels;

    #[test]
    fn the_largest_images_lose_levels_until_all_have_room() {
        let image = |side: u32| {
            let pixels = vec![7; (side * side) as usize];
            let image = Arc::new(Image::new(Pixels::Bytes(&pixels), side, side, 1, false).unwrap());
            Resident { image, start: 0, skipped: 0 }
        };
        let skipped = |most: u64| {
            let mut images = [image(8), image(4), image(1)];
            fit(&mut images, most).map(|()| images.map(|resident| resident.skipped))
        };
        // 64 + 16 + 4 + 1, 16 + 4 + 1 and 1.
        assert_eq!(skipped(107).unwrap(), [0, 0, 0]);
        assert_eq!(skipped(106).unwrap(), [1, 0, 0]);
        assert_eq!(skipped(30).unwrap().iter().sum::<u32>(), 2);
        assert_eq!(skipped(3).unwrap(), [3, 2, 0]);
        assert!(matches!(skipped(2), Err(Error::TooLarge(_))));
    }
}
