//! The names of all that each kernel binds, of which the stages own the structs.

use super::bindings::{Bindings, CountBits, RasterBindings, ScanBlocks, SurfaceBindings};
use super::shaders::{Kernel, MaterialKind};
use super::{cluster_cull, hzb, instance_cull, node_cull, occlusion, output, raster_large, shade};

/// The names of all that a kernel binds, in order.
pub fn binding_names(kernel: Kernel) -> Vec<&'static str> {
    let lists: &[&[&str]] = match kernel {
        Kernel::InstanceCull => &[instance_cull::InstanceCull::NAMES],
        Kernel::ClearGroups => &[node_cull::ClearGroups::NAMES],
        Kernel::NodeCull(_) => &[node_cull::NodeCull::NAMES],
        Kernel::CountBits(_) => &[CountBits::NAMES],
        Kernel::ScanBlocks(_) => &[ScanBlocks::NAMES],
        Kernel::ListGroups(_) => &[node_cull::ListGroups::NAMES],
        Kernel::ClusterCull(_) => &[cluster_cull::ClusterCull::NAMES],
        Kernel::ListClusters(_) => &[cluster_cull::ListClusters::NAMES],
        Kernel::RasterSmall(_) | Kernel::RasterLarge(_) | Kernel::RasterHardware(..) => {
            &[RasterBindings::NAMES]
        }
        Kernel::RasterAlphaTested(_) => &[RasterBindings::NAMES, raster_large::AlphaTest::NAMES],
        Kernel::Hzb(_) => &[hzb::Hzb::NAMES],
        Kernel::PrepareIndirect(_) => &[occlusion::PrepareIndirect::NAMES],
        Kernel::Renumber => &[occlusion::Renumber::NAMES],
        Kernel::CountCovered => &[output::CountCovered::NAMES],
        Kernel::Shade(_, MaterialKind::Plain, _) => &[SurfaceBindings::NAMES, shade::Light::NAMES],
        Kernel::Shade(_, MaterialKind::Textured, _) => {
            &[SurfaceBindings::NAMES, shade::Light::NAMES, shade::Textures::NAMES]
        }
        Kernel::Output(_) => &[SurfaceBindings::NAMES],
        Kernel::LoopProbe => &[&["state"]],
    };
    lists.concat()
}
