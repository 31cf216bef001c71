//! All kernels, each of which its stage declares.

use super::{
    cluster_cull, hzb, node_cull, occlusion, output, raster_large, raster_small, shade, shadow_raster,
};

pub use super::cluster_cull::{cluster_cull, list_clusters};
pub use super::context::LOOP_PROBE;
pub use super::hzb::hzb;
pub use super::instance_cull::INSTANCE_CULL;
pub use super::kernel::{Access, Binding, BoundBuffer, Constant, CullPass, Kernel, MAX_WORKGROUPS, WIDTH};
pub use super::lists::{
    Bits, GROUPS_PER_WORKGROUP, IndirectEntry, List, count_bits, group_bit_words, scan_blocks,
};
pub use super::node_cull::{CLEAR_GROUPS, list_groups, node_cull};
pub use super::occlusion::{RENUMBER, prepare_indirect};
pub use super::output::{COUNT_COVERED, output};
pub use super::raster::{Onto, Words};
pub use super::raster_hardware::raster_hardware;
pub use super::raster_large::{raster_alpha_tested, raster_large};
pub use super::raster_small::raster_small;
pub use super::shade::{Ibl, MaterialKind, Shadowing, shade};
pub use super::shadow_mark::SHADOW_MARK;
pub use super::shadow_raster::{SHADOW_TILE_RANGES, shadow_hidden, shadow_raster};
pub use super::shadow_test::SHADOW_TEST;
pub use super::write_runs::WRITE_RUNS;

/// Every kernel.
pub fn kernels() -> Vec<Kernel> {
    [
        vec![LOOP_PROBE, INSTANCE_CULL, SHADOW_MARK, SHADOW_TEST, WRITE_RUNS],
        super::lists::kernels(),
        node_cull::kernels(),
        cluster_cull::kernels(),
        raster_small::kernels(),
        raster_large::kernels(),
        super::raster_hardware::kernels(),
        occlusion::kernels(),
        hzb::kernels(),
        shadow_raster::kernels(),
        shade::kernels(),
        output::kernels(),
    ]
    .concat()
}
