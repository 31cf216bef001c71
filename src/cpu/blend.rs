//! Layers of blended surfaces and what is opaque behind them → light: each lets through what its alpha leaves, in linear light,
//! from front to back (Porter and Duff, "Compositing Digital Images", SIGGRAPH 1984; glTF 2.0, section 3.9.4).

use rayon::prelude::*;

use super::material::alpha;
use super::peel::Layers;
use super::shade::{self, Light};
use super::surface::{Pixels, one};
use crate::scene::Slot;
use crate::scene::placement::Eye;
use crate::views::{InstanceView, Screen, Visible, decode};

/// What is composited, before it is encoded.
#[derive(Debug)]
pub struct Blended {
    /// RGB of all.
    pub light: Vec<f32>,
    /// The same of meshes alone: light times coverage, and coverage.
    pub layer: Vec<[f32; 4]>,
}

/// Alpha of a cluster, where it is one everywhere.
fn constant_alpha(views: &[InstanceView], at: Visible) -> Option<f32> {
    let view = &views[at.instance as usize];
    let material = view.materials.of(view.pages.record(at.cluster).material);
    let textured = material.textures[Slot::BaseColor as usize].is_some();
    (!textured && !view.mesh.layout().colors.is_some()).then_some(material.alpha)
}

/// Composites `layers` over `opaque`, what [`shade::linear`] makes of all else, of which `covered` says where meshes are.
pub fn run(
    layers: &Layers,
    views: &[InstanceView],
    screen: &Screen,
    eye: &Eye,
    light: &Light<'_>,
    opaque: &[f32],
    covered: &[u64],
) -> Blended {
    // Light that is gathered, and the part that is let through.
    let mut gathered = vec![[0.0f32, 0.0, 0.0, 1.0]; covered.len()];
    // What is behind comes last, and once.
    let mut lighting = light.lighting.clone();
    if let Some(environment) = &mut lighting.environment {
        environment.background = false;
    }
    let light = Light { lighting: &lighting, ..*light };
    let constant: Vec<Option<f32>> = layers.visible.iter().map(|at| constant_alpha(views, *at)).collect();
    for words in &layers.words {
        let pixels = Pixels { words, visible: &layers.visible, views, screen };
        let colors = shade::linear(pixels, eye, &light);
        let colors = colors.as_chunks::<3>().0;
        gathered.par_iter_mut().enumerate().with_min_len(1 << 12).for_each(|(pixel, gathered)| {
            let Some(hit) = decode(words[pixel]) else { return };
            let known = constant[hit.visible as usize];
            let alpha = known.unwrap_or_else(|| alpha(&one(pixels, pixel, hit)));
            let part = gathered[3] * alpha;
            for k in 0..3 {
                gathered[k] += part * colors[pixel][k];
            }
            gathered[3] *= 1.0 - alpha;
        });
    }
    let behind = opaque.as_chunks::<3>().0;
    let out = |pixel: usize| {
        let ([r, g, b, rest], behind) = (gathered[pixel], behind[pixel]);
        let over = [r + rest * behind[0], g + rest * behind[1], b + rest * behind[2]];
        let mesh = match covered[pixel] != 0 {
            true => [over[0], over[1], over[2], 1.0],
            false => [r, g, b, 1.0 - rest],
        };
        (over, mesh)
    };
    let (light, layer): (Vec<[f32; 3]>, Vec<[f32; 4]>) =
        (0..covered.len()).into_par_iter().with_min_len(1 << 12).map(out).unzip();
    Blended { light: light.into_flattened(), layer }
}
