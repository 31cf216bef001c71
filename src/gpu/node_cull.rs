//! Stage 2. Walks the hierarchies of instances, one dispatch per level, and lists the groups found in scene order.
//!
//! Nodes of a level come in any order; groups are bits of a set, and listing it restores the order. The second phase
//! resumes at the nodes that the first one put off, and lists the groups of both.

use super::frame::Recorder;
use super::shaders::{Bits, Kernel, Phase, Step};

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, m, own, [later, later_level]) = (r.buffers, r.meshes, r.own(), r.later());
    for level in 0..b.shape.depth as usize {
        let from = if level == 0 { &own.starts } else { &b.visits[level % 2] };
        let (dispatch, next) = (&own.levels[level], &own.levels[level + 1]);
        let to = &b.visits[(level + 1) % 2];
        let bindings = [
            &b.view,
            r.seen,
            m.nodes(),
            m.groups(),
            from,
            dispatch,
            to,
            next,
            &own.group_bits,
            r.pyramid(),
            later,
            later_level,
            m.page_offsets(),
            &b.wanted,
        ];
        r.run_indirect(Kernel::NodeCull(r.phase), &bindings, dispatch, 0);
    }
    let first = r.first();
    let (blocks, number) = match r.phase {
        Phase::First => (&b.group_blocks, 0),
        Phase::Second => (&first.steps, Step::Groups.number()),
    };
    r.run_indirect(
        Kernel::CountBits(Bits::Groups),
        &[&own.group_bits, blocks, &own.group_sums, &first.group_bits],
        blocks,
        number,
    );
    r.run(Kernel::ScanBlocks(Bits::Groups), &[blocks, &own.group_sums], 1);
    let bindings = [
        &b.view,
        r.seen,
        m.groups(),
        &own.group_bits,
        blocks,
        &own.group_sums,
        &own.candidates,
        &own.culling,
        &own.counting,
        &first.group_bits,
        &first.group_sums,
    ];
    r.run_indirect(Kernel::ListGroups(r.phase), &bindings, blocks, number);
}
