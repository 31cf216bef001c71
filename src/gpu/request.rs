//! What is asked of a device for a view, and what it answers.

use std::sync::Arc;

use super::buffers::DeviceVisibility;
use super::kernel::CullPass;
use crate::config::{Output, Outputs, Raster, Shading, Transfer};
use crate::gpu_types::{self, Array, CandidateGroup, Counters, Lighting, View, VisibleCluster};
use crate::scene::EnvironmentMap;
use crate::stages::Stage;
use crate::stream::Needs;

/// What may be done in other ways, with the same picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ways {
    /// One 64-bit maximum instead of two 32-bit passes, where the device has it.
    pub int64_atomics: bool,
    /// Leaves out what is hidden, in two passes.
    pub occlusion: bool,
    /// Which rasterizers draw; the only one of these ways by which a picture may differ.
    pub raster: Raster,
    /// What colours are.
    pub shading: Shading,
    /// This stage and those behind it do not run; what the one before passed on comes back.
    pub until: Option<Stage>,
    /// Arrays wait for [`super::DeviceRenderer::shade`], since shadows are to be found before.
    pub waits: bool,
}

/// A view to draw, and the arrays to make of its picture.
#[derive(Debug)]
pub struct ViewRequest<'a> {
    /// Its identity: what it keeps on the device is found by it.
    pub id: u64,
    /// The view.
    pub view: View,
    /// Keys alone are drawn, and of them depth at most is made.
    pub depth_only: bool,
    /// What is filled: the visibility buffer, the low half of each word first. Of depth alone a number per pixel: its depth
    /// where that is to be made, else its key.
    pub words: &'a mut [u32],
    /// The visibility buffer may stay on the device, see [`Drawn::visibility`]; then none is filled.
    pub keep_on_device: bool,
    /// The arrays.
    pub outputs: Outputs,
    /// All but the lights.
    pub lighting: Lighting,
    /// The lights.
    pub lights: Vec<gpu_types::Light>,
    /// How colours are encoded.
    pub transfer: Transfer,
    /// The environment map, of which `lighting` has the rest.
    pub environment: Option<Arc<EnvironmentMap>>,
}

impl<'a> ViewRequest<'a> {
    /// A view of which nothing is made but the visibility buffer.
    pub fn new(view: View, words: &'a mut [u64]) -> Self {
        let (outputs, lighting) = (Outputs::default(), bytemuck::Zeroable::zeroed());
        let words = bytemuck::cast_slice_mut(words);
        let transfer = Transfer::default();
        Self {
            id: 0,
            depth_only: false,
            view,
            words,
            keep_on_device: false,
            outputs,
            lighting,
            lights: Vec::new(),
            transfer,
            environment: None,
        }
    }
}

/// What a pass counted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counted {
    /// Nodes to start from.
    pub starts: u64,
    /// Nodes and groups looked at.
    pub visited: u64,
    /// Groups of the list, for the second pass with those of the first.
    pub groups: u64,
    /// Clusters that this pass draws.
    pub clusters: u64,
    /// Instances that the pyramid of this frame hides.
    pub hidden_instances: u64,
    /// The rest.
    pub counters: Counters,
}

/// The arrays made of a view's picture.
pub type Made = Vec<(Output, Array)>;

/// Stage, pass and milliseconds of each pass on the device; NaN where it takes no time.
pub type StageTimes = Vec<(Stage, CullPass, f64)>;

/// What a frame leaves: its visible list and what each stage received and passed on.
#[derive(Debug, Default)]
pub struct Drawn {
    /// Triangles at full detail of the instances on the screen.
    pub source_triangles: u64,
    /// The visible list, in scene order.
    pub visible: Vec<VisibleCluster>,
    /// Slots of the instances that culling of instances passed on, in any order.
    pub roots: Vec<u32>,
    /// With [`Ways::until`] at the culling of clusters, the groups whose clusters it would have culled.
    pub groups: Vec<CandidateGroup>,
    /// By entries of the tables of pages, how much those are missed that are not there: the bits of pixels.
    pub wanted: Vec<u32>,
    /// The same by meshes.
    pub needs: Needs,
    /// The arrays asked for.
    pub made: Made,
    /// The visibility buffer, where it was left on the device.
    pub visibility: Option<DeviceVisibility>,
    /// Bytes of instances written to the device.
    pub uploaded_bytes: u64,
    /// Bytes of meshes written to the device.
    pub uploaded_mesh_bytes: u64,
    /// Images that lack their largest levels there.
    pub reduced_images: u64,
    /// Which rasterizers drew it.
    pub raster: Raster,
    /// The first pass started from what the frame before drew.
    pub listed: bool,
    /// One pass, or two.
    pub cull_passes: Vec<Counted>,
    /// What the stages took.
    pub times: StageTimes,
}
