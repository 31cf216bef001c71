//! Kernels by themselves, on tables made by hand: what goes in is written down, and what has to come out was worked out
//! on paper, not by the CPU twin.

mod cluster_cull;
mod instance_cull;
mod lists;
mod node_cull;
mod occlusion;
mod raster;

use bytemuck::{Pod, Zeroable, cast_slice};
use nanite_rs::gpu::Context;
use nanite_rs::gpu::kernels::{
    Bits, COUNT_COVERED, CullPass, INSTANCE_CULL, IndirectEntry, Kernel, LOOP_PROBE, List, Onto, RENUMBER,
    Words, cluster_cull, count_bits, hzb, list_clusters, list_groups, node_cull, prepare_indirect,
    raster_large, raster_small, scan_blocks,
};
use nanite_rs::gpu_types::{
    CandidateGroup, Counters, Dispatch, DrawArgs, Group, HISTORY_LIST, Instance, InstanceTransform, Marks,
    Node, TILES, TraversalItem, View, VisibleCluster,
};
use nanite_rs::limits::{PYRAMID_ABOVE, PYRAMID_LEVELS};
use nanite_rs::math::Sphere;
use nanite_rs::model::cluster::RECORD_WORDS;
use nanite_rs::model::packing::{VertexRow, vertex_row, write_triangles};
use nanite_rs::model::rule::SOURCE_ERROR;
use nanite_rs::model::{AttributeLayout, ClusterAddress, ClusterRecord, Packing};

use crate::gpu_parity::device;

/// No earlier place.
const NONE: u32 = u32::MAX;

fn words<T: Pod>(entries: &[T]) -> &[u32] {
    cast_slice(entries)
}

fn entries<T: Pod>(words: &[u32]) -> Vec<T> {
    cast_slice(words).to_vec()
}

fn entry<T: Pod>(words: &[u32]) -> T {
    entries(words)[0]
}

/// Runs a kernel in one workgroup.
fn run(device: &Context, kernel: Kernel, bindings: &[&[u32]]) -> Vec<Vec<u32>> {
    device.run(kernel, bindings, 1).unwrap()
}

fn dispatch(x: u32, y: u32, count: u32) -> Dispatch {
    Dispatch { x, y, z: u32::from(x > 0), count, ..Dispatch::default() }
}

/// 100 × 80 pixels from the origin along −z, between distances 1 and 20: across, x = ±d is the edge of the picture; up
/// and down, y = ±d.
fn view() -> View {
    let mut pyramid = [[0; 4]; PYRAMID_LEVELS];
    pyramid[..8].copy_from_slice(&[
        [100, 80, 0, 100],
        [50, 40, 8000, 52],
        [25, 20, 10_080, 28],
        [13, 10, 10_640, 16],
        [7, 5, 10_800, 8],
        [4, 3, 10_840, 4],
        [2, 2, 10_852, 4],
        [1, 1, 10_860, 4],
    ]);
    View {
        width: 100,
        height: 80,
        near: 1.0,
        far: 20.0,
        // Of the depth value 1 / 20.
        far_key: 0.05f32.to_bits(),
        levels: 8,
        pyramid,
        rotate: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        forward: [0.0, 0.0, -1.0],
        focal: [50.0, -40.0],
        center: [50.0, 40.0],
        lod_focal: 64.0,
        lod_near: 1.0,
        lod_widest: 1.0,
        ..View::zeroed()
    }
}

/// Keys of the pyramid of that view.
const KEYS: usize = 10_864;

/// A mesh in a box of half extent 1 about a place.
fn instance_transform(x: f32, y: f32, z: f32) -> InstanceTransform {
    InstanceTransform {
        linear: [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]],
        inverse: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        lod_scale: 1.0,
        extent: [1.0; 3],
        visible: 1,
        ..InstanceTransform::zeroed()
    }
}

/// An instance at distance 10 in the middle of that view, as it was in the frame before.
fn seen() -> Instance {
    let screen = [[50.0, 0.0, -50.0, 500.0], [0.0, -40.0, -40.0, 400.0], [0.0, 0.0, -1.0, 10.0]];
    Instance {
        screen,
        before: screen,
        object_to_eye: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -10.0]],
        lod_scale: 1.0,
        lod_focal: 64.0,
        near_key: u32::MAX,
        eye: [0.0, 0.0, 10.0],
        ..Instance::zeroed()
    }
}

/// The depth key of a distance in a view with near distance 1.
fn key(distance: f32) -> u32 {
    (1.0 / distance).to_bits()
}

/// A sphere and an error at distance 10 that make exactly a pixel: 0.125 · 64 / (10 − 1.875 − 0.125).
const LISTS: usize = List::COUNT as usize;

const SPHERE: Sphere = Sphere { center: [0.0; 3], radius: 1.875 };

const PIXEL: f32 = 0.125;

/// The next smaller error: 0.125 − 2⁻²⁷ makes 1 − 2⁻²⁴ pixels, the next smaller f32.
const LESS: f32 = 0.125 - 1.0 / 134_217_728.0;

/// That many pixels: the threshold that the one exceeds and the other does not.
const TAU: f32 = 1.0 - 1.0 / 16_777_216.0;

fn node(max_parent_error: f32, first: u32, count: u16, is_leaf: bool) -> Node {
    Node {
        center: [0.0; 3],
        extent: [1.0; 3],
        lod_sphere: SPHERE,
        max_parent_error,
        min_own_error: SOURCE_ERROR,
        first,
        count,
        is_leaf: u16::from(is_leaf),
        unused: [0; 2],
    }
}

fn group(error: f32, x: f32) -> Group {
    let center = [x, 0.0, 0.0];
    let min_own_error = SOURCE_ERROR;
    Group { lod_sphere: SPHERE, error, center, extent: [0.5; 3], min_own_error, ..Group::zeroed() }
}

/// Words of bits, with a bit for each that is not zero behind them.
fn with_filled(bits: &[u32]) -> Vec<u32> {
    let filled =
        bits.chunks(32).map(|words| (0..).zip(words).map(|(k, word)| u32::from(*word != 0) << k).sum());
    bits.iter().copied().chain(filled).collect()
}
