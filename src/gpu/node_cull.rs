//! Stage 2. Walks the hierarchies of instances, one dispatch per level, and lists the groups found in scene order.
//!
//! Nodes of a level come in any order; groups are bits of a set, and listing it restores the order. The second pass
//! resumes at the nodes that the first one deferred, and lists the groups of both. A first pass that starts from the list
//! of the frame before does not walk.

use super::kernel::{Bindings, CullPass, Kernel, WIDTH, bind, bindings};
use super::lists::{Bits, CountBits, IndirectEntry, ScanBlocks, count_bits, scan_blocks};
use super::recorder::Recorder;

bindings! {
    /// What `clear_groups` binds.
    ClearGroups { blocks: Read, bits: Write }
}

bindings! {
    /// What `node_cull` binds.
    NodeCull {
        view: Uniform, instances: Read, nodes: Read, groups: Read, items: Read, level: Read,
        items_out: Write, next: Write, group_bits: Write, pyramid: Read, occluded_queue: Write,
        occluded_dispatch: Write, page_offsets: Read, wanted: Write,
    }
}

bindings! {
    /// What `list_groups` binds.
    ListGroups {
        view: Uniform, instances: Read, groups: Read, bits: Read, blocks: Read, sums: Read,
        candidate_groups: Write, culling: Write, counting: Write, first_bits: Read, first_sums: Read,
    }
}

/// Bits of groups → none.
pub const CLEAR_GROUPS: Kernel = Kernel::new("clear_groups", &[ClearGroups::BINDINGS]);

/// A level of nodes → the next, and the bits of groups.
pub const fn node_cull(cull_pass: CullPass) -> Kernel {
    Kernel::new("node_cull", &[NodeCull::BINDINGS]).of(cull_pass)
}

/// Bits of groups → the list of groups.
pub const fn list_groups(cull_pass: CullPass) -> Kernel {
    let kernel = Kernel::new("list_groups", &[ListGroups::BINDINGS]);
    kernel.constants([cull_pass.constant(), Bits::Groups.block_constant()])
}

pub(super) fn kernels() -> Vec<Kernel> {
    let of_passes =
        CullPass::BOTH.into_iter().flat_map(|cull_pass| [node_cull(cull_pass), list_groups(cull_pass)]);
    [CLEAR_GROUPS].into_iter().chain(of_passes).collect()
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
        let dispatch = own.levels.level(level);
        let bindings = bind!(NodeCull {
            view: &b.view,
            instances: r.seen,
            nodes: m.nodes(),
            groups: m.groups(),
            items: if level == 0 { &own.starts } else { &b.items[level % 2] },
            level: dispatch,
            items_out: &b.items[(level + 1) % 2],
            next: own.levels.level(level + 1),
            group_bits: &groups.bits,
            pyramid: r.pyramid(),
            occluded_queue: occluded_queue,
            occluded_dispatch: occluded_dispatch,
            page_offsets: m.page_offsets(),
            wanted: &b.wanted,
        });
        r.run_indirect(node_cull(r.cull_pass), &bindings.buffers(), dispatch, 0);
    }
    let first = r.first();
    let before = &first.groups;
    let (blocks, number) = match r.cull_pass {
        CullPass::First => (&b.group_blocks, 0),
        CullPass::Second => (&first.indirect, IndirectEntry::Groups.number()),
    };
    let bits = bind!(CountBits { bits: &groups.bits, blocks: blocks, sums: &groups.sums });
    r.run_indirect(count_bits(Bits::Groups), &bits.buffers(), blocks, number);
    let sums = bind!(ScanBlocks { blocks: blocks, sums: &groups.sums });
    r.run(scan_blocks(Bits::Groups), &sums.buffers(), 1);
    let bindings = bind!(ListGroups {
        view: &b.view,
        instances: r.seen,
        groups: m.groups(),
        bits: &groups.bits,
        blocks: blocks,
        sums: &groups.sums,
        candidate_groups: &groups.candidate_groups,
        culling: groups.culling(),
        counting: groups.counting(),
        first_bits: &before.bits,
        first_sums: &before.sums,
    });
    r.run_indirect(list_groups(r.cull_pass), &bindings.buffers(), blocks, number);
}

/// Leaves no bits of groups of an earlier frame, but for those of a list that the first pass starts from.
fn clear(r: &mut Recorder<'_>) {
    let b = r.buffers;
    let workgroups = b.shape.group_words.div_ceil(u32::BITS * WIDTH);
    for cull_pass in b.cull_passes.iter().skip(usize::from(r.listed)) {
        let bindings = bind!(ClearGroups { blocks: &b.group_blocks, bits: &cull_pass.groups.bits });
        r.run(CLEAR_GROUPS, &bindings.buffers(), workgroups);
    }
}
