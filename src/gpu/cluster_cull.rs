//! Stage 3. Clusters of groups → the visible list in scene order, and what of it each rasterizer draws. The second pass
//! lists the clusters of both and draws those that are new.

use super::bindings::{Bindings, CountBits, ScanBlocks, bindings};
use super::recorder::Recorder;
use super::shaders::{Bits, CullPass, Kernel};

bindings! {
    /// What `cluster_cull` binds.
    ClusterCull {
        view, instances, page_offsets, pages, candidate_groups, culling, drawn, marks, counters, pyramid, first_drawn,
        groups, pages_1, pages_2, pages_3,
    }
}

bindings! {
    /// What `list_clusters` binds.
    ListClusters {
        view, candidate_groups, blocks, drawn, marks, sums, visible, numbers, draws, counters, first_marks, renumbered,
        draw_args, instances, group_bits,
    }
}

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, m, own, first) = (r.buffers, r.meshes, r.own(), r.first());
    let groups = &own.groups;
    // The first pass reads nothing of an earlier one; what it writes cannot be bound there.
    let (first_drawn, first_marks) = match r.cull_pass {
        CullPass::First => (&groups.candidate_groups, &groups.candidate_groups),
        CullPass::Second => (&first.groups.drawn, &first.marks),
    };
    let [pages, pages_1, pages_2, pages_3] = m.pages();
    let bindings = ClusterCull {
        view: &b.view,
        instances: r.seen,
        page_offsets: m.page_offsets(),
        pages,
        candidate_groups: &groups.candidate_groups,
        culling: &groups.culling,
        drawn: &groups.drawn,
        marks: &own.marks,
        counters: &own.counters,
        pyramid: r.pyramid(),
        first_drawn,
        groups: m.groups(),
        pages_1,
        pages_2,
        pages_3,
    };
    r.run_indirect(Kernel::ClusterCull(r.cull_pass), &bindings.buffers(), &groups.culling, 0);
    let (blocks, sums) = (&groups.counting, &own.cluster_sums);
    let bits = CountBits { bits: &groups.drawn, blocks, sums };
    r.run_indirect(Kernel::CountBits(Bits::Clusters), &bits.buffers(), blocks, 0);
    r.run(Kernel::ScanBlocks(Bits::Clusters), &ScanBlocks { blocks, sums }.buffers(), 1);
    let bindings = ListClusters {
        view: &b.view,
        candidate_groups: &groups.candidate_groups,
        blocks,
        drawn: &groups.drawn,
        marks: &own.marks,
        sums,
        visible: &b.visible,
        numbers: &own.numbers,
        draws: &own.draws,
        counters: &own.counters,
        first_marks,
        renumbered: &b.renumbered,
        draw_args: &own.draw_args,
        instances: r.seen,
        group_bits: r.deferred_groups(),
    };
    r.run_indirect(Kernel::ListClusters(r.cull_pass), &bindings.buffers(), blocks, 0);
}
