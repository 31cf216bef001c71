//! An image on a surface: which UV set, how it repeats, how it is filtered.

use std::sync::Arc;

use super::image::Image;
use crate::config::Shading;
use crate::error::{Error, Result};

/// What is beyond the edges of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// The image again.
    #[default]
    Repeat,
    /// The image again, every other time turned around.
    Mirror,
    /// Its edge.
    Clamp,
}

/// Which levels of an image are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mipmaps {
    /// The whole image alone.
    Off,
    /// The nearest level.
    Nearest,
    /// Two, in proportion.
    #[default]
    Linear,
}

/// Most samples along the longer axis of a pixel's footprint.
pub const MAX_ANISOTROPY: u32 = 16;

/// A texture of a material.
#[derive(Clone, Debug)]
pub struct Texture {
    /// What it shows.
    pub image: Arc<Image>,
    /// Which of the mesh's UV sets.
    pub uv_set: u8,
    /// Beyond the edges, along the rows and the columns of the image.
    pub wrap: [Wrap; 2],
    /// Between texels of a level: in proportion, or else the nearest.
    pub linear: bool,
    /// Between levels.
    pub mipmaps: Mipmaps,
    /// Most samples along the longer axis of a pixel's footprint, 1 to [`MAX_ANISOTROPY`].
    pub anisotropy: u32,
    /// Rows of the map from (u, v, 1) to places on the image in its sides, from its upper left corner.
    pub rows: [[f32; 3]; 2],
}

impl Texture {
    /// Rows of the map where v is 0 at the lower edge of the image.
    pub const UPRIGHT: [[f32; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, -1.0, 1.0]];

    /// The image once over (0, 0) to (1, 1), repeated, filtered in all ways.
    pub fn new(image: Arc<Image>) -> Self {
        Self {
            image,
            uv_set: 0,
            wrap: [Wrap::Repeat; 2],
            linear: true,
            mipmaps: Mipmaps::Linear,
            anisotropy: 8,
            rows: Self::UPRIGHT,
        }
    }

    /// The image as a frame shades it.
    pub fn image_for(&self, shading: Shading) -> &Arc<Image> {
        if shading == Shading::Pyrender { self.image.encoded() } else { &self.image }
    }

    /// Checks ranges; the error names the field.
    pub fn validate(&self) -> Result<()> {
        if !(1..=MAX_ANISOTROPY).contains(&self.anisotropy) {
            let message = format!("must be 1 to {MAX_ANISOTROPY}, not {}", self.anisotropy);
            return Err(Error::argument("anisotropy", message));
        }
        if let Some(bad) = self.rows.iter().flatten().find(|v| !v.is_finite()) {
            return Err(Error::argument("rows", format!("must be finite, not {bad}")));
        }
        Ok(())
    }
}

/// Images are equal where they are the same.
impl PartialEq for Texture {
    fn eq(&self, other: &Self) -> bool {
        let ways = |t: &Self| (t.uv_set, t.wrap, t.linear, t.mipmaps, t.anisotropy, t.rows);
        Arc::ptr_eq(&self.image, &other.image) && ways(self) == ways(other)
    }
}
