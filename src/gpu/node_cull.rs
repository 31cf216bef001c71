//! Stage 2. Walks the hierarchies of instances, one dispatch per level, and lists the groups found in scene order.
//!
//! Nodes of a level come in any order; groups are bits of a set, and listing it restores the order. The second pass
//! resumes at the nodes that the first one deferred, and lists the groups of both. A first pass that starts from the list
//! of the frame before does not walk.

use super::bindings::{Bindings, CountBits, ScanBlocks, bindings};
use super::recorder::Recorder;
use super::shaders::{Bits, CullPass, IndirectEntry, Kernel, WIDTH};

bindings! {
    /// What `clear_groups` binds.
    ClearGroups { blocks, bits }
}

bindings! {
    /// What `node_cull` binds.
    NodeCull {
        view, instances, nodes, groups, items, level, items_out, next, group_bits, pyramid, occluded_queue,
        occluded_dispatch, page_offsets, wanted,
    }
}

bindings! {
    /// What `list_groups` binds.
    ListGroups {
        view, instances, groups, bits, blocks, sums, candidate_groups, culling, counting, first_bits, first_sums,
    }
}

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
        let dispatch = &own.levels[level];
        let bindings = NodeCull {
            view: &b.view,
            instances: r.seen,
            nodes: m.nodes(),
            groups: m.groups(),
            items: if level == 0 { &own.starts } else { &b.items[level % 2] },
            level: dispatch,
            items_out: &b.items[(level + 1) % 2],
            next: &own.levels[level + 1],
            group_bits: &groups.bits,
            pyramid: r.pyramid(),
            occluded_queue,
            occluded_dispatch,
            page_offsets: m.page_offsets(),
            wanted: &b.wanted,
        };
        r.run_indirect(Kernel::NodeCull(r.cull_pass), &bindings.buffers(), dispatch, 0);
    }
    let first = r.first();
    let before = &first.groups;
    let (blocks, number) = match r.cull_pass {
        CullPass::First => (&b.group_blocks, 0),
        CullPass::Second => (&first.indirect, IndirectEntry::Groups.number()),
    };
    let bits = CountBits { bits: &groups.bits, blocks, sums: &groups.sums };
    r.run_indirect(Kernel::CountBits(Bits::Groups), &bits.buffers(), blocks, number);
    r.run(Kernel::ScanBlocks(Bits::Groups), &ScanBlocks { blocks, sums: &groups.sums }.buffers(), 1);
    let bindings = ListGroups {
        view: &b.view,
        instances: r.seen,
        groups: m.groups(),
        bits: &groups.bits,
        blocks,
        sums: &groups.sums,
        candidate_groups: &groups.candidate_groups,
        culling: &groups.culling,
        counting: &groups.counting,
        first_bits: &before.bits,
        first_sums: &before.sums,
    };
    r.run_indirect(Kernel::ListGroups(r.cull_pass), &bindings.buffers(), blocks, number);
}

/// Leaves no bits of groups of an earlier frame, but for those of a list that the first pass starts from.
fn clear(r: &mut Recorder<'_>) {
    let b = r.buffers;
    let workgroups = b.shape.group_words.div_ceil(u32::BITS * WIDTH);
    for cull_pass in b.cull_passes.iter().skip(usize::from(r.listed)) {
        let bindings = ClearGroups { blocks: &b.group_blocks, bits: &cull_pass.groups.bits };
        r.run(Kernel::ClearGroups, &bindings.buffers(), workgroups);
    }
}
