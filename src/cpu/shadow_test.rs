//! What pixels look up, and pages → how much of each light reaches each pixel.

use rayon::prelude::*;

use super::shadow_mark::{DARK, LIT, Marked};
use crate::limits::SHADOW_PAGE_TEXELS;
use crate::shadow::ShadowCache;

/// How much of lights reaches the pixels of a frame.
#[derive(Clone, Debug, Default)]
pub struct LightVisibility {
    /// For each light of the frame whether it throws shadows; then its place among those that do.
    pub lights: Vec<Option<usize>>,
    /// Pixels of the frame.
    pub pixels: usize,
    /// 0 in shadow, 1 in light: for each light that throws shadows all pixels, row by row.
    pub lit: Vec<u8>,
}

impl LightVisibility {
    /// That of a light, by its number in the frame; `None` where it reaches everything.
    #[inline]
    pub fn of(&self, light: usize) -> Option<&[u8]> {
        let at = (*self.lights.get(light)?)?;
        Some(&self.lit[at * self.pixels..][..self.pixels])
    }
}

/// Compares depths.
pub fn run(marked: &[Vec<Marked>], lights: Vec<Option<usize>>, cache: &ShadowCache) -> LightVisibility {
    let maps = lights.iter().flatten().count();
    let pixels: usize = marked.iter().filter_map(|stretch| stretch.first()).map(|one| one.places.len()).sum();
    let mut lit = vec![1u8; maps * pixels];
    for (number, lit) in lit.chunks_exact_mut(pixels.max(1)).enumerate() {
        let stretch =
            marked.first().and_then(|first| first.get(number)).map_or(1, |first| first.places.len());
        lit.par_chunks_mut(stretch.max(1))
            .zip(marked)
            .for_each(|(lit, marked)| compare(&marked[number], cache, lit));
    }
    LightVisibility { lights, pixels, lit }
}

fn compare(marked: &Marked, cache: &ShadowCache, lit: &mut [u8]) {
    let pages: Vec<Option<&[u32]>> = marked.pages.iter().map(|key| cache.page(key)).collect();
    for (place, lit) in marked.places.iter().zip(lit) {
        *lit = match place.texel {
            LIT => 1,
            DARK => 0,
            at => {
                let (page, texel) = (at as usize / SHADOW_PAGE_TEXELS, at as usize % SHADOW_PAGE_TEXELS);
                u8::from(pages[page].is_none_or(|texels| texels[texel] <= place.key))
            }
        };
    }
}
