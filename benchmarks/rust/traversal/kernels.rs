//! The kernels that are the benchmark's own: their sources, with the constants of a scene.

use nanite_rs::gpu::CullPass;
use nanite_rs::gpu::kernels::{GROUPS_PER_WORKGROUP, WIDTH, list_groups};
use nanite_rs::gpu::shaders;

use super::parts::PART;

/// How the work queue is laid out.
#[derive(Clone, Copy, Debug)]
pub struct Ring {
    /// Slots, a power of two.
    pub slots: u32,
    /// Workgroups that stay.
    pub workers: u32,
    /// Attempts of a worker to find work, or to win it from others, before it leaves or takes it by force.
    pub patience: u32,
}

/// What fits software Vulkan and, as far as one can tell from there, a GPU.
pub const RING: Ring = Ring { slots: 1 << 16, workers: 16, patience: 64 };

/// Kernels of the benchmark's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Own {
    /// The work queue.
    WorkQueue,
    /// How many workgroups look at parts.
    PartDispatch,
    /// Parts of instances.
    PartCull,
    /// The product's list of groups, for parts.
    ListParts,
    /// Clusters of parts.
    PartClusters,
}

/// All of them.
pub const OWN: [Own; 5] =
    [Own::WorkQueue, Own::PartDispatch, Own::PartCull, Own::ListParts, Own::PartClusters];

/// Constants of a scene that the own kernels are compiled with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Instances.
    pub instances: u32,
    /// Nodes of the mesh that has most.
    pub nodes: u32,
    /// Levels of the deepest hierarchy.
    pub depth: u32,
    /// Parts of the mesh that has most.
    pub parts: u32,
}

impl Own {
    /// Name of its file; the list of parts is the product's of groups.
    pub fn name(self) -> &'static str {
        match self {
            Self::WorkQueue => "work_queue",
            Self::PartDispatch => "part_dispatch",
            Self::PartCull => "part_cull",
            Self::ListParts => "list_groups",
            Self::PartClusters => "part_clusters",
        }
    }
}

macro_rules! product {
    ($name:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/shared/", $name, ".wgsl"))
    };
}

impl Sizes {
    /// Bits of an item of the queue: an instance and a node, and one value for none.
    fn payload_bits(self) -> Option<u32> {
        let items = u64::from(self.instances) * u64::from(self.nodes) + 1;
        let bits = items.next_power_of_two().ilog2();
        (bits < u32::BITS).then_some(bits)
    }

    /// The source of an own kernel; none where an item of the queue would not fit a word.
    pub fn source(self, kernel: Own, ring: Ring, array_bits: Option<u32>) -> Option<String> {
        let payload_bits = self.payload_bits()?;
        let laps = (1u64 << (u32::BITS - payload_bits)) - 1;
        let tickets = (u64::from(ring.slots) * laps).min(1 << 31);
        let whole = |name: &str, value: u64| format!("const {name}: u32 = {value}u;\n");
        let constants = [
            shaders::constants(),
            whole("PAGE_ARRAYS", if array_bits.is_some() { shaders::PAGE_ARRAYS as u64 } else { 1 }),
            whole("PAGE_ARRAY_BITS", array_bits.unwrap_or(u32::BITS - 1).into()),
            whole("RING", ring.slots.into()),
            whole("TICKETS", tickets),
            whole("PAYLOAD_BITS", payload_bits.into()),
            whole("PATIENCE", ring.patience.into()),
            whole("MOST_NODES", self.nodes.max(1).into()),
            whole("DEPTH", u64::from(self.depth) + 1),
            whole("PART", PART as u64),
            whole("BLOCKS", self.parts.div_ceil(WIDTH).max(1).into()),
        ];
        let types = product!("types");
        let cull = concat!(product!("exact"), product!("cull"));
        let lod = product!("lod");
        let bits = product!("group_bits");
        let files = match kernel {
            Own::WorkQueue => vec![types, cull, lod, bits, include_str!("work_queue.wgsl")],
            Own::PartDispatch => vec![types, include_str!("part_dispatch.wgsl")],
            Own::PartCull => vec![types, cull, lod, bits, include_str!("part_cull.wgsl")],
            // As many candidates to a workgroup of the next step as have their lanes there.
            Own::ListParts => {
                let line = |per: u32| format!("const GROUPS_PER_WORKGROUP: u32 = {per}u;\n");
                let product = list_groups(CullPass::First).source(None);
                return Some(product.replace(&line(GROUPS_PER_WORKGROUP), &line(WIDTH / PART as u32)));
            }
            Own::PartClusters => vec![
                types,
                cull,
                lod,
                product!("places"),
                product!("pages"),
                product!("cone"),
                include_str!("part_clusters.wgsl"),
            ],
        };
        Some(constants.concat() + &files.join("\n"))
    }
}
