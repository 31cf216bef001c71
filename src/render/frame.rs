//! A rendered frame: its visibility buffer, and every array that is read from it when asked for.

use std::sync::Arc;

use rayon::prelude::*;

use super::frame_shadows::FrameShadows;
use super::layers;
use super::motion::Before;
use super::stats::FrameStats;
use super::visibility_buffer::{ScratchPool, VisibilityBuffer};
use crate::config::{Output, Outputs};
use crate::cpu::blend;
use crate::cpu::output::{self, DebugView};
use crate::cpu::peel::Layers;
use crate::cpu::shade::{self, Light};
use crate::cpu::shadow_pages::Shadows;
use crate::cpu::shadow_test::{self, ShadowView};
use crate::cpu::surface::Pixels;
use crate::error::{Error, Result};
use crate::gpu_types::Array;
use crate::model::ClusterAddress;
use crate::scene::placement::Eye;
use crate::scene::{Lighting, Owners, View};
use crate::stages::Stage;
use crate::views::{InstanceView, Screen, Visible, decode, payload};

/// Colour of the edges of a wireframe, RGB bytes.
const EDGES: [u8; 3] = [20, 24, 32];

/// A picture of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageView {
    /// An array of RGB bytes.
    Rgb(Output),
    /// Edges of triangles, on blank surfaces.
    Wireframe,
    /// Triangles per pixel, in colours.
    Overdraw,
    /// What the rasterizers of small and of large triangles drew.
    Rasterizers,
    /// What pixels look up in the shadow maps of the first light that has any.
    Shadow(ShadowView),
}

impl ImageView {
    /// By name.
    pub fn parse(name: &str) -> Result<Self> {
        Ok(match name {
            "shaded" => Self::Rgb(Output::Color),
            "triangles" => Self::Rgb(Output::Triangles),
            "clusters" => Self::Rgb(Output::Clusters),
            "groups" => Self::Rgb(Output::Groups),
            "levels" => Self::Rgb(Output::Levels),
            "wireframe" => Self::Wireframe,
            "overdraw" => Self::Overdraw,
            "rasterizers" => Self::Rasterizers,
            "shadow_pages" => Self::Shadow(ShadowView::Pages),
            "shadow_levels" => Self::Shadow(ShadowView::Levels),
            "shadow_kept" => Self::Shadow(ShadowView::Kept),
            "shadow_cut" => Self::Shadow(ShadowView::Cut),
            _ => {
                return Err(Error::argument(
                    "view",
                    format!(
                        "must be shaded, wireframe, triangles, clusters, groups, levels, rasterizers, overdraw, \
                         shadow_pages, shadow_levels, shadow_kept or shadow_cut, not {name:?}"
                    ),
                ));
            }
        })
    }
}

/// The result of a frame. It keeps the meshes it shows alive and does not follow later edits of the scene. One of depth
/// alone has that and `stats`: everything that is made of the visibility buffer is an error.
#[derive(Debug)]
pub struct Frame {
    pub(super) picture: VisibilityBuffer,
    pub(super) visible: Vec<Visible>,
    /// Which of `visible` went to the large rasterizer.
    pub(super) large: Vec<bool>,
    pub(super) views: Vec<InstanceView>,
    /// Which of them are parts of which instances.
    pub(super) owners: Arc<Owners>,
    pub(super) screen: Screen,
    pub(super) view: View,
    pub(super) eye: Eye,
    pub(super) lighting: Lighting,
    /// Colour before it is encoded, where each pixel has several samples.
    pub(super) light: Option<Vec<f32>>,
    /// The same of meshes alone, see [`layers`].
    pub(super) layer: Option<Vec<[f32; 4]>>,
    /// What is in the way of each light, where lights throw shadows.
    pub(super) shadows: Option<FrameShadows>,
    /// What it shows as it was in the frame before, if that was noted.
    pub(super) before: Option<Before>,
    /// Whether it was to tell what moved.
    pub(super) tells_motion: bool,
    /// Arrays made so far.
    pub(super) made: Vec<(Output, Array)>,
    pub(super) scratch: ScratchPool,
    /// What the frame cost and skipped.
    pub stats: FrameStats,
}

impl Frame {
    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.screen.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.screen.height
    }

    /// Whether it has depth and nothing else.
    fn depth_only(&self) -> bool {
        match self.picture {
            VisibilityBuffer::Depth(_) => true,
            #[cfg(feature = "gpu")]
            VisibilityBuffer::DepthOnDevice(..) => true,
            _ => false,
        }
    }

    /// Whether what arrays are made of lies on a device.
    pub fn is_on_device(&self) -> bool {
        self.picture.is_on_device() || self.shadows.as_ref().is_some_and(FrameShadows::is_on_device)
    }

    /// The view it was rendered from.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// The words of the visibility buffer, row by row from the top; see [`crate::cpu::visibility`].
    pub fn words(&self) -> Result<&[u64]> {
        self.picture.words("visibility buffer")
    }

    /// The clusters that were drawn, in scene order: slot number of the instance, for parts of assemblies that of the whole, and
    /// address. Words number them.
    pub fn visible(&self) -> Vec<(u32, ClusterAddress)> {
        let slot = |v: &Visible| self.owners.of(self.views[v.instance as usize].slot);
        self.visible.iter().map(|v| (slot(v), v.cluster)).collect()
    }

    /// What `what` is made of.
    fn pixels(&self, what: &str) -> Result<Pixels<'_>> {
        let words = self.picture.words(what)?;
        Ok(Pixels { words, visible: &self.visible, views: &self.views, screen: &self.screen })
    }

    /// Its light, and where that reaches.
    fn light(&self) -> Result<Light<'_>> {
        let shadows = self.shadows.as_ref().map(FrameShadows::host).transpose()?;
        Ok(Light { lighting: &self.lighting, shadows })
    }

    /// Composites what is blended over the rest, from which all other arrays are made.
    pub(super) fn blend(&mut self, layers: &Layers) -> Result<()> {
        let (pixels, light) = (self.pixels("linear")?, self.light()?);
        let opaque = shade::linear(pixels, &self.eye, &light);
        let blended = blend::run(layers, &self.views, &self.screen, &self.eye, &light, &opaque, pixels.words);
        (self.light, self.layer) = (Some(blended.light), Some(blended.layer));
        Ok(())
    }

    /// Has depth, ids and normals show the nearest of what is blended, where anything is.
    pub(super) fn show_layers(&mut self, layers: Layers) {
        let (Some(nearest), VisibilityBuffer::Words(words)) = (layers.words.first(), &mut self.picture)
        else {
            return;
        };
        let first = self.visible.len() as u32;
        words.par_iter_mut().zip(nearest).with_min_len(1 << 14).for_each(|(word, layer)| {
            if let Some(hit) = decode(*layer) {
                let low = payload((first + hit.visible) as usize) - hit.triangle;
                *word = u64::from(hit.key) << 32 | u64::from(low);
            }
        });
        self.visible.extend(layers.visible);
        self.large.extend(layers.large);
    }

    /// How far what each pixel shows has moved since the frame before: pixels to the right and down. Zero where nothing is
    /// covered and in a first frame, NaN where it was at the eye or behind it.
    pub fn motion(&self) -> Result<Vec<[f32; 2]>> {
        if !self.tells_motion {
            return Err(Error::argument("motion", "the frame was rendered without"));
        }
        let pixels = self.pixels("motion")?;
        Ok(match &self.before {
            Some(before) => output::motion(pixels, &before.views, &before.screen),
            None => vec![[0.0; 2]; pixels.words.len()],
        })
    }

    /// How much of each light, switched on, reaches each pixel, row by row: all of the first pixel first. 1 where nothing is
    /// covered.
    pub fn shadow(&self) -> Result<Vec<f32>> {
        Ok(shadow_test::run(self.pixels("shadow")?, &self.eye, self.shadows()?))
    }

    /// What is in the way of each light, where lights throw shadows.
    pub fn shadow_maps(&self) -> Option<&Shadows> {
        self.shadows().ok()
    }

    fn shadows(&self) -> Result<&Shadows> {
        let none = || Error::argument("shadows", "the frame was rendered without");
        self.shadows.as_ref().ok_or_else(none)?.host()
    }

    /// Has instances that a device numbered be those of the scene.
    pub(super) fn name_owners(&mut self) {
        for (output, array) in &mut self.made {
            if *output == Output::InstanceId {
                let slots = std::mem::replace(array, Array::from(Vec::<i32>::new()));
                *array = owned(Vec::from(slots), &self.owners).into();
            }
        }
    }

    /// Makes what of `outputs` is not there.
    pub(super) fn finish(&mut self, outputs: Outputs) -> Result<()> {
        if self.depth_only() {
            return Ok(());
        }
        let pixels = u64::from(self.width()) * u64::from(self.height());
        let mut stats = std::mem::take(&mut self.stats);
        for output in outputs.iter() {
            if self.made.iter().any(|(made, _)| *made == output) {
                continue;
            }
            let (stage, passed) = match output {
                shaded if shaded.shaded() => (Stage::Shade, stats.covered_pixels),
                _ => (Stage::Output, pixels),
            };
            let array = stats.time(stage, 1, || (self.make(output), pixels, passed))?;
            self.made.push((output, array));
        }
        self.stats = stats;
        Ok(())
    }

    /// Makes an array from the visibility buffer, whether or not there is one made with the frame.
    pub fn make(&self, output: Output) -> Result<Array> {
        if output == Output::Depth
            && let Some(depth) = self.picture.depth(&self.screen)?
        {
            return Ok(depth.to_vec().into());
        }
        match (&self.light, output) {
            (Some(light), Output::Color) => return Ok(shade::encode(light, self.lighting.transfer).into()),
            (Some(light), Output::Linear) => return Ok(light.clone().into()),
            _ => {}
        }
        let pixels = self.pixels(output.name())?;
        let debug = |view| Array::from(output::debug(pixels, view).into_flattened());
        Ok(match output {
            Output::Color => shade::color(pixels, &self.eye, &self.light()?).into(),
            Output::Linear => shade::linear(pixels, &self.eye, &self.light()?).into(),
            Output::BaseColor | Output::ShadingNormal | Output::Orm | Output::Emissive => {
                shade::surface(pixels, &self.eye, &self.light()?, output).into()
            }
            Output::Depth => {
                let mut out = vec![0.0; pixels.words.len()];
                output::depth(pixels, &mut out);
                out.into()
            }
            Output::Normal => output::normals(pixels, &self.eye).into_flattened().into(),
            Output::InstanceId => owned(output::instance_ids(pixels), &self.owners).into(),
            Output::ClusterId => output::cluster_ids(pixels).into(),
            Output::TriangleId => output::triangle_ids(pixels).into(),
            Output::Overdraw => output::overdraw(pixels, &self.large).into(),
            Output::Triangles => debug(DebugView::Triangles),
            Output::Clusters => debug(DebugView::Clusters),
            Output::Groups => debug(DebugView::Groups),
            Output::Levels => debug(DebugView::Levels),
        })
    }

    /// Takes an array made with the frame, or makes it now.
    pub fn take(&mut self, output: Output) -> Result<Array> {
        match self.made.iter().position(|(made, _)| *made == output) {
            Some(at) => Ok(self.made.swap_remove(at).1),
            None => self.make(output),
        }
    }

    /// A copy of an array made with the frame, or makes it now.
    pub fn array(&self, output: Output) -> Result<Array> {
        let made = self.made.iter().find(|(made, _)| *made == output);
        made.map_or_else(|| self.make(output), |(_, array)| Ok(array.clone()))
    }

    /// Colour, RGB bytes.
    pub fn color(&self) -> Result<Vec<u8>> {
        self.array(Output::Color).map(Vec::from)
    }

    /// Colour before it is encoded: linear light, RGB.
    pub fn linear(&self) -> Result<Vec<f32>> {
        self.array(Output::Linear).map(Vec::from)
    }

    /// Colour with 16 bits, RGB.
    pub fn deep_color(&self) -> Result<Vec<u16>> {
        let transfer = self.lighting.transfer;
        Ok(self.linear()?.into_par_iter().map(|c| transfer.word(c)).collect())
    }

    /// What is seen of meshes alone: linear light times coverage, and coverage, which is 0 or 1 for one sample.
    pub fn layer(&self) -> Result<Vec<[f32; 4]>> {
        if let Some(layer) = &self.layer {
            return Ok(layer.clone());
        }
        let (light, depth) = (self.linear()?, self.depth()?);
        let mut layer = vec![[0.0; 4]; depth.len()];
        layers::add(&mut layer, &light, &depth, 1.0);
        Ok(layer)
    }

    /// The same as RGBA bytes: colours as [`Frame::color`] encodes them, not multiplied by coverage.
    pub fn rgba(&self) -> Result<Vec<u8>> {
        let encoder = self.lighting.transfer.encoder();
        Ok(layers::straight(&self.layer()?, |c| encoder.encode(c), |a| (a * 255.0 + 0.5) as u8))
    }

    /// The same with 16 bits.
    pub fn deep_rgba(&self) -> Result<Vec<u16>> {
        let transfer = self.lighting.transfer;
        Ok(layers::straight(&self.layer()?, |c| transfer.word(c), |a| (a * 65535.0 + 0.5) as u16))
    }

    /// Distance along the view axis in world units; 0 where nothing is covered.
    pub fn depth(&self) -> Result<Vec<f32>> {
        self.array(Output::Depth).map(Vec::from)
    }

    /// Unit world-space normals; zero where nothing is covered.
    pub fn normals(&self) -> Result<Vec<[f32; 3]>> {
        Ok(Vec::from(self.array(Output::Normal)?).as_chunks().0.to_vec())
    }

    /// Slot numbers of instances of the scene, for parts of assemblies that of the whole; −1 where nothing is covered.
    pub fn instance_ids(&self) -> Result<Vec<i32>> {
        self.array(Output::InstanceId).map(Vec::from)
    }

    /// Cluster addresses; [`output::NO_CLUSTER`] where nothing is covered.
    pub fn cluster_ids(&self) -> Result<Vec<u32>> {
        self.array(Output::ClusterId).map(Vec::from)
    }

    /// Triangles inside their clusters; −1 where nothing is covered.
    pub fn triangle_ids(&self) -> Result<Vec<i32>> {
        self.array(Output::TriangleId).map(Vec::from)
    }

    /// Rows of the caller's faces; −1 where nothing is covered or it is not known.
    pub fn face_ids(&self) -> Result<Vec<i64>> {
        self.pixels("face_id").and_then(output::face_ids)
    }

    /// Triangles that cover each pixel, hidden ones included, among the clusters that were drawn.
    pub fn overdraw(&self) -> Result<Vec<u32>> {
        self.array(Output::Overdraw).map(Vec::from)
    }

    /// A picture, RGB bytes; with `edges` those of triangles are drawn over it in this colour.
    pub fn image(&self, what: ImageView, edges: Option<[u8; 3]>) -> Result<Vec<u8>> {
        let edges = edges.or((what == ImageView::Wireframe).then_some(EDGES));
        let mut image = self.plain_image(what)?;
        if let Some(color) = edges {
            output::draw_edges(self.pixels("edges")?, color, &mut image);
        }
        Ok(image)
    }

    fn plain_image(&self, what: ImageView) -> Result<Vec<u8>> {
        Ok(match what {
            ImageView::Wireframe => output::blank(self.pixels("wireframe")?).into_flattened(),
            ImageView::Rgb(output) => self.array(output)?.into(),
            ImageView::Overdraw => output::overdraw_colors(&self.overdraw()?).into_flattened(),
            ImageView::Shadow(what) => {
                shadow_test::view(self.pixels("shadow view")?, &self.eye, self.shadows()?, what)
                    .into_flattened()
            }
            ImageView::Rasterizers => {
                output::rasterizers(self.pixels("rasterizers")?, &self.large).into_flattened()
            }
        })
    }
}

impl Drop for Frame {
    fn drop(&mut self) {
        self.scratch.give(std::mem::replace(&mut self.picture, VisibilityBuffer::Depth(Vec::new())));
        self.scratch.give_views(std::mem::take(&mut self.views));
    }
}

/// Slots of what was drawn as slots of the scene.
fn owned(mut slots: Vec<i32>, owners: &Owners) -> Vec<i32> {
    if !owners.is_empty() {
        let own = |slot: &mut i32| *slot = u32::try_from(*slot).map_or(-1, |known| owners.of(known) as i32);
        slots.par_iter_mut().with_min_len(1 << 14).for_each(own);
    }
    slots
}
