//! Stage 3. Clusters of groups → the visible list in scene order, and what of it each rasterizer draws. The second phase
//! lists the clusters of both and draws those that are new.

use super::frame::Recorder;
use super::shaders::{Bits, Kernel, Phase};

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, m, own, first) = (r.buffers, r.meshes, r.own(), r.first());
    let groups = &own.groups;
    // The first phase reads nothing of an earlier one; what it writes cannot be bound there.
    let (first_drawn, first_marks) = match r.phase {
        Phase::First => (&groups.candidates, &groups.candidates),
        Phase::Second => (&first.groups.drawn, &first.marks),
    };
    let [pages, pages_1, pages_2, pages_3] = m.pages();
    let bindings = [
        &b.view,
        r.seen,
        m.page_offsets(),
        pages,
        &groups.candidates,
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
    r.run_indirect(Kernel::ClusterCull(r.phase), &bindings, &groups.culling, 0);
    r.run_indirect(
        Kernel::CountBits(Bits::Clusters),
        &[&groups.drawn, &groups.counting, &own.cluster_sums],
        &groups.counting,
        0,
    );
    r.run(Kernel::ScanBlocks(Bits::Clusters), &[&groups.counting, &own.cluster_sums], 1);
    let bindings = [
        &b.view,
        &groups.candidates,
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
        &own.calls,
        r.seen,
        r.later_groups(),
    ];
    r.run_indirect(Kernel::ListClusters(r.phase), &bindings, &groups.counting, 0);
}
