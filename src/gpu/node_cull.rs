//! Stage 2. Walks the hierarchies of instances, one dispatch per level, and lists the groups found in scene order.
//!
//! Nodes of a level come in any order; groups are bits of a set, and listing it restores the order. The second pass
//! resumes at the nodes that the first one deferred, and lists the groups of both. A first pass that starts from the list
//! of the frame before does not walk.

use super::recorder::Recorder;
use super::shaders::{Bits, CullPass, IndirectEntry, Kernel, WIDTH};

pub(super) fn record(r: &mut Recorder<'_>) {
    if r.cull_pass == CullPass::First {
        clear(r);
        if r.listed {
            return;
        }
    }
    let (b, m, own, [occluded_queue, occluded_dispatch]) = (r.buffers, r.meshes, r.own(), r.occluded_queue());
    let groups = &own.groups;
    for level in 0..b.shape.depth as usize {
        let from = if level == 0 { &own.starts } else { &b.items[level % 2] };
        let (dispatch, next) = (&own.levels[level], &own.levels[level + 1]);
        let to = &b.items[(level + 1) % 2];
        let bindings = [
            &b.view,
            r.seen,
            m.nodes(),
            m.groups(),
            from,
            dispatch,
            to,
            next,
            &groups.bits,
            r.pyramid(),
            occluded_queue,
            occluded_dispatch,
            m.page_offsets(),
            &b.wanted,
        ];
        r.run_indirect(Kernel::NodeCull(r.cull_pass), &bindings, dispatch, 0);
    }
    let first = r.first();
    let before = &first.groups;
    let (blocks, number) = match r.cull_pass {
        CullPass::First => (&b.group_blocks, 0),
        CullPass::Second => (&first.indirect, IndirectEntry::Groups.number()),
    };
    r.run_indirect(Kernel::CountBits(Bits::Groups), &[&groups.bits, blocks, &groups.sums], blocks, number);
    r.run(Kernel::ScanBlocks(Bits::Groups), &[blocks, &groups.sums], 1);
    let bindings = [
        &b.view,
        r.seen,
        m.groups(),
        &groups.bits,
        blocks,
        &groups.sums,
        &groups.candidate_groups,
        &groups.culling,
        &groups.counting,
        &before.bits,
        &before.sums,
    ];
    r.run_indirect(Kernel::ListGroups(r.cull_pass), &bindings, blocks, number);
}

/// Leaves no bits of groups of an earlier frame, but for those of a list that the first pass starts from.
fn clear(r: &mut Recorder<'_>) {
    let b = r.buffers;
    let workgroups = b.shape.group_words.div_ceil(u32::BITS * WIDTH);
    for cull_pass in b.cull_passes.iter().skip(usize::from(r.listed)) {
        r.run(Kernel::ClearGroups, &[&b.group_blocks, &cull_pass.groups.bits], workgroups);
    }
}
