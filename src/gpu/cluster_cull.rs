//! Stage 3. Clusters of groups → the visible list in scene order, and what of it each rasterizer draws. The second pass
//! lists the clusters of both and draws those that are new.

use super::recorder::Recorder;
use super::shaders::{Bits, CullPass, Kernel};

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, m, own, first) = (r.buffers, r.meshes, r.own(), r.first());
    let groups = &own.groups;
    // The first pass reads nothing of an earlier one; what it writes cannot be bound there.
    let (first_drawn, first_marks) = match r.cull_pass {
        CullPass::First => (&groups.candidate_groups, &groups.candidate_groups),
        CullPass::Second => (&first.groups.drawn, &first.marks),
    };
    let [pages, pages_1, pages_2, pages_3] = m.pages();
    let bindings = [
        &b.view,
        r.seen,
        m.page_offsets(),
        pages,
        &groups.candidate_groups,
        &groups.culling,
        &groups.drawn,
        &own.marks,
        &own.counters,
        r.pyramid(),
        first_drawn,
        m.groups(),
        pages_1,
        pages_2,
        pages_3,
    ];
    r.run_indirect(Kernel::ClusterCull(r.cull_pass), &bindings, &groups.culling, 0);
    r.run_indirect(
        Kernel::CountBits(Bits::Clusters),
        &[&groups.drawn, &groups.counting, &own.cluster_sums],
        &groups.counting,
        0,
    );
    r.run(Kernel::ScanBlocks(Bits::Clusters), &[&groups.counting, &own.cluster_sums], 1);
    let bindings = [
        &b.view,
        &groups.candidate_groups,
        &groups.counting,
        &groups.drawn,
        &own.marks,
        &own.cluster_sums,
        &b.visible,
        &own.numbers,
        &own.draws,
        &own.counters,
        first_marks,
        &b.renumbered,
        &own.draw_args,
        r.seen,
        r.deferred_groups(),
    ];
    r.run_indirect(Kernel::ListClusters(r.cull_pass), &bindings, &groups.counting, 0);
}
