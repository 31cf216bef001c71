//! Stage 3. Clusters of groups → the visible list in scene order, and what of it each rasterizer draws. The second phase
//! lists the clusters of both and draws those that are new.

use super::frame::Recorder;
use super::shaders::{Bits, Kernel, Phase};

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, m, own, first) = (r.buffers, r.meshes, r.own(), r.first());
    // The first phase reads nothing of an earlier one; what it writes cannot be bound there.
    let (first_drawn, first_marks) = match r.phase {
        Phase::First => (&own.candidates, &own.candidates),
        Phase::Second => (&first.drawn, &first.marks),
    };
    let [pages, pages_1, pages_2, pages_3] = m.pages();
    let bindings = [
        &b.view,
        r.seen,
        m.page_offsets(),
        pages,
        &own.candidates,
        &own.culling,
        &own.drawn,
        &own.marks,
        &own.counters,
        r.pyramid(),
        first_drawn,
        first_marks,
        pages_1,
        pages_2,
        pages_3,
    ];
    r.run_indirect(Kernel::ClusterCull(r.phase), &bindings, &own.culling, 0);
    r.run_indirect(
        Kernel::CountBits(Bits::Clusters),
        &[&own.drawn, &own.counting, &own.cluster_sums, &own.drawn],
        &own.counting,
        0,
    );
    r.run(Kernel::ScanBlocks(Bits::Clusters), &[&own.counting, &own.cluster_sums], 1);
    let bindings = [
        &own.candidates,
        &own.counting,
        &own.drawn,
        &own.marks,
        &own.cluster_sums,
        &b.visible,
        &own.numbers,
        &own.draws,
        &own.counters,
        first_marks,
        &b.renumbered,
        &own.calls,
    ];
    r.run_indirect(Kernel::ListClusters(r.phase), &bindings, &own.counting, 0);
}
