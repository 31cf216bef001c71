//! A rendered frame: its visibility buffer, and every array that is read from it when asked for.

use std::sync::{Arc, Mutex};

use super::stats::FrameStats;
use crate::cpu::output::{self, DebugView};
use crate::cpu::project::{InstanceView, Screen};
use crate::cpu::shade::{self, Lighting};
use crate::cpu::surface::Pixels;
use crate::cpu::visibility::Visible;
use crate::error::{Error, Result};
use crate::model::ClusterAddress;
use crate::scene::View;

/// Visibility buffers that wait to be used again.
pub(super) type Spare = Arc<Mutex<Vec<Vec<u64>>>>;

/// A picture of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageView {
    /// Lit surfaces.
    Shaded,
    /// Colours by identity.
    Debug(DebugView),
    /// Triangles per pixel.
    Overdraw,
}

impl ImageView {
    /// By name: shaded, triangles, clusters, groups, levels or overdraw.
    pub fn parse(name: &str) -> Result<Self> {
        Ok(match name {
            "shaded" => Self::Shaded,
            "triangles" => Self::Debug(DebugView::Triangles),
            "clusters" => Self::Debug(DebugView::Clusters),
            "groups" => Self::Debug(DebugView::Groups),
            "levels" => Self::Debug(DebugView::Levels),
            "overdraw" => Self::Overdraw,
            _ => {
                return Err(Error::argument(
                    "view",
                    format!("must be shaded, triangles, clusters, groups, levels or overdraw, not {name:?}"),
                ));
            }
        })
    }
}

/// The result of a frame. It keeps the meshes it shows alive and does not follow later edits of the scene.
#[derive(Debug)]
pub struct Frame {
    pub(super) words: Vec<u64>,
    pub(super) visible: Vec<Visible>,
    /// Which of `visible` went to the large rasterizer.
    pub(super) large: Vec<bool>,
    pub(super) views: Vec<InstanceView>,
    pub(super) screen: Screen,
    pub(super) view: View,
    pub(super) lighting: Lighting,
    pub(super) color: Option<Vec<u8>>,
    pub(super) depth: Option<Vec<f32>>,
    pub(super) spare: Spare,
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

    /// The view it was rendered from.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// The words of the visibility buffer, row by row from the top; see [`crate::cpu::visibility`].
    pub fn words(&self) -> &[u64] {
        &self.words
    }

    /// The clusters that were drawn, in scene order: slot number of the instance, and address. Words number them.
    pub fn visible(&self) -> Vec<(u32, ClusterAddress)> {
        self.visible.iter().map(|v| (self.views[v.instance as usize].slot, v.cluster)).collect()
    }

    fn pixels(&self) -> Pixels<'_> {
        Pixels { words: &self.words, visible: &self.visible, views: &self.views, screen: &self.screen }
    }

    /// Colour, RGB bytes. Made with the frame, or now.
    pub fn color(&self) -> Vec<u8> {
        self.color.clone().unwrap_or_else(|| {
            let mut out = vec![0; 3 * self.words.len()];
            shade::run(self.pixels(), &self.view, &self.lighting, &mut out);
            out
        })
    }

    /// Takes the colour made with the frame, or makes it now.
    pub fn take_color(&mut self) -> Vec<u8> {
        self.color.take().unwrap_or_else(|| self.color())
    }

    /// Distance along the view axis in world units; 0 where nothing is covered.
    pub fn depth(&self) -> Vec<f32> {
        self.depth.clone().unwrap_or_else(|| {
            let mut out = vec![0.0; self.words.len()];
            output::depth(self.pixels(), &mut out);
            out
        })
    }

    /// Takes the depth made with the frame, or makes it now.
    pub fn take_depth(&mut self) -> Vec<f32> {
        self.depth.take().unwrap_or_else(|| self.depth())
    }

    /// Unit world-space normals; zero where nothing is covered.
    pub fn normals(&self) -> Vec<[f32; 3]> {
        output::normals(self.pixels(), &self.view)
    }

    /// Slot numbers of instances; −1 where nothing is covered.
    pub fn instance_ids(&self) -> Vec<i32> {
        output::instance_ids(self.pixels())
    }

    /// Cluster addresses; [`output::NO_CLUSTER`] where nothing is covered.
    pub fn cluster_ids(&self) -> Vec<u32> {
        output::cluster_ids(self.pixels())
    }

    /// Triangles inside their clusters; −1 where nothing is covered.
    pub fn triangle_ids(&self) -> Vec<i32> {
        output::triangle_ids(self.pixels())
    }

    /// Rows of the caller's faces; −1 where nothing is covered or it is not known.
    pub fn face_ids(&self) -> Vec<i64> {
        output::face_ids(self.pixels())
    }

    /// Triangles that cover each pixel, hidden ones included, among the clusters that were drawn.
    pub fn overdraw(&self) -> Vec<u32> {
        output::overdraw(self.pixels(), &self.large)
    }

    /// A picture, RGB bytes.
    pub fn image(&self, what: ImageView) -> Vec<u8> {
        match what {
            ImageView::Shaded => self.color(),
            ImageView::Debug(debug) => output::debug(self.pixels(), debug).into_flattened(),
            ImageView::Overdraw => output::overdraw_colors(&self.overdraw()).into_flattened(),
        }
    }
}

impl Drop for Frame {
    fn drop(&mut self) {
        if let Ok(mut spare) = self.spare.lock()
            && spare.len() < 2
        {
            spare.push(std::mem::take(&mut self.words));
        }
    }
}
