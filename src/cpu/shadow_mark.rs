//! Visibility buffer → what its pixels look up in shadow maps, and the pages that they want.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::output::ROWS;
use super::shade::position;
use super::surface::{Detail, Pixels, Surfels, Walk};
use crate::limits::{SHADOW_PAGE_TEXELS, SHADOW_ROUNDING};
use crate::scene::placement::Eye;
use crate::shadow::receiver::RelativePage;
use crate::shadow::{LightView, Lookup, PageKey, Receiver};

/// A pixel that looks nothing up, and is lit.
pub const LIT: u32 = u32::MAX;
/// A pixel that looks nothing up, and is dark.
pub const DARK: u32 = u32::MAX - 1;

/// What a pixel looks up.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Page of [`Marked::pages`] times the texels of a page, plus the texel; [`LIT`] or [`DARK`].
    pub texel: u32,
    /// Its key: what is nearer to the light has a larger one.
    pub key: u32,
}

/// What some rows look up in the maps of one light.
#[derive(Clone, Debug, Default)]
pub struct Marked {
    /// Pages that are wanted, each once.
    pub pages: Vec<PageKey>,
    /// One for each pixel.
    pub places: Vec<Place>,
}

/// What pixels of a frame look up: by stretches of [`ROWS`] rows, then by light.
pub fn run(pixels: Pixels<'_>, eye: &Eye, lights: &[LightView]) -> Vec<Vec<Marked>> {
    let stretch = ROWS * pixels.screen.width as usize;
    let count = pixels.words.len();
    let starts: Vec<usize> = (0..count).step_by(stretch.max(1)).collect();
    starts.par_iter().map(|&start| mark(pixels, eye, lights, start..count.min(start + stretch))).collect()
}

/// What a stretch looks up in one light, while it is found.
#[derive(Default)]
struct Finder {
    numbers: FxHashMap<RelativePage, u32>,
    last: Option<(RelativePage, u32)>,
    marked: Marked,
}

impl Finder {
    fn note(&mut self, light: &LightView, pixel: usize, lookup: Lookup) {
        let place = match lookup {
            Lookup::Lit => return,
            Lookup::Dark => Place { texel: DARK, key: 0 },
            Lookup::Texel { page, texel, key } => {
                let number = match self.last {
                    Some((last, number)) if last == page => number,
                    _ => {
                        let pages = &mut self.marked.pages;
                        *self.numbers.entry(page).or_insert_with(|| {
                            pages.push(light.key(&page));
                            pages.len() as u32 - 1
                        })
                    }
                };
                self.last = Some((page, number));
                Place { texel: number * SHADOW_PAGE_TEXELS as u32 + texel, key }
            }
        };
        self.marked.places[pixel] = place;
    }
}

fn mark(pixels: Pixels<'_>, eye: &Eye, lights: &[LightView], range: std::ops::Range<usize>) -> Vec<Marked> {
    let start = range.start;
    let new = || {
        let mut finder = Finder::default();
        finder.marked.places = vec![Place { texel: LIT, key: 0 }; range.len()];
        finder
    };
    let mut finders: Vec<Finder> = lights.iter().map(|_| new()).collect();
    if let Some(mut walk) = Walk::new(pixels, range.clone()) {
        while let Some(surfels) = walk.step::<Detail>() {
            if !surfels.view.receives_shadows {
                continue;
            }
            let receivers = receivers(&surfels, eye, pixels.screen.orthographic);
            for (light, finder) in lights.iter().zip(&mut finders) {
                for lane in 0..surfels.count {
                    finder.note(
                        light,
                        surfels.pixels[lane] as usize - start,
                        light.look_up(&receivers[lane]),
                    );
                }
            }
        }
    }
    finders.into_iter().map(|finder| finder.marked).collect()
}

/// Surface points as receivers.
fn receivers(
    surfels: &Surfels<'_, Detail>,
    eye: &Eye,
    orthographic: bool,
) -> [Receiver; super::lanes::LANES] {
    let at = position(eye, orthographic, &surfels.point, surfels.distance);
    let view = surfels.view;
    let (face, smooth) = (&surfels.detail.face, &surfels.normal);
    std::array::from_fn(|lane| {
        let of = |v: &super::lanes::Vec3x8| v.map(|c| c.0[lane]);
        let (position, normal, smooth) = (of(&at), of(face), of(smooth));
        let away = match orthographic {
            true => normal[2] < 0.0,
            false => (0..3).map(|k| normal[k] * position[k]).sum::<f32>() > 0.0,
        };
        let sign = if away { -1.0 } else { 1.0 };
        // Lanes without a pixel have clusters of anything.
        let own =
            if lane < surfels.count { view.pages.record(surfels.clusters[lane]).error.max(0.0) } else { 0.0 };
        let error = view.lod.scale * (own + view.lod.rounding + SHADOW_ROUNDING);
        Receiver { position, normal: normal.map(|c| sign * c), smooth: smooth.map(|c| sign * c), error }
    })
}
