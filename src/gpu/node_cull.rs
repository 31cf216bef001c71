//! Stage 2. Walks the hierarchies of instances, one dispatch per level, and lists the groups found in scene order.
//!
//! Nodes of a level come in any order; groups are bits of a set, and listing it restores the order.

use super::frame::Recorder;
use super::shaders::{Kernel, SCAN_WIDTH};

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, m) = (r.buffers, r.meshes);
    for level in 0..b.shape.depth as usize {
        let from = if level == 0 { &b.roots } else { &b.visits[level % 2] };
        let (own, next) = (&b.levels[level], &b.levels[level + 1]);
        let to = &b.visits[(level + 1) % 2];
        let bindings = [&b.view, &b.instances, m.nodes(), m.groups(), from, own, to, next, &b.group_bits];
        r.run_indirect(Kernel::NodeCull, &bindings, own, 0);
    }
    let blocks = b.shape.group_words.div_ceil(SCAN_WIDTH);
    r.run(Kernel::CountBits, &[&b.group_bits, &b.group_blocks, &b.group_sums], blocks);
    r.run(Kernel::ScanBlocks, &[&b.group_blocks, &b.group_sums], 1);
    let bindings = [
        &b.view,
        &b.instances,
        m.groups(),
        &b.group_bits,
        &b.group_blocks,
        &b.group_sums,
        &b.candidates,
        &b.culling,
        &b.counting,
    ];
    r.run(Kernel::ListGroups, &bindings, blocks);
}
