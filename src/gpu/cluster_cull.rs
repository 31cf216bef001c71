//! Stage 3. Clusters of groups → the visible list in scene order, and what of it each rasterizer draws. The second pass
//! lists the clusters of both and draws those that are new.

use super::kernel::{Bindings, CullPass, Kernel, bind, bindings};
use super::lists::{Bits, CountBits, ScanBlocks, count_bits, scan_blocks};
use super::recorder::Recorder;

bindings! {
    /// What `cluster_cull` binds.
    ClusterCull {
        view: Uniform, instances: Read, page_offsets: Read, pages: Read, candidate_groups: Read,
        culling: Read, drawn: Write, marks: Write, counters: Write, pyramid: Read, first_drawn: Read,
        groups: Read, pages_1: Read, pages_2: Read, pages_3: Read,
    }
}

bindings! {
    /// What `list_clusters` binds.
    ListClusters {
        view: Uniform, candidate_groups: Read, blocks: Read, drawn: Read, marks: Write, sums: Read,
        visible: Write, numbers: Write, draws: Write, counters: Write, first_marks: Read, renumbered: Write,
        draw_args: Write, instances: Read, group_bits: Write,
    }
}

/// Groups → bits of clusters.
pub const fn cluster_cull(cull_pass: CullPass) -> Kernel {
    Kernel::new("cluster_cull", &[ClusterCull::BINDINGS]).of(cull_pass)
}

/// Bits of clusters → the visible list.
pub const fn list_clusters(cull_pass: CullPass) -> Kernel {
    let kernel = Kernel::new("list_clusters", &[ListClusters::BINDINGS]);
    kernel.constants([cull_pass.constant(), Bits::Clusters.block_constant()])
}

pub(super) fn kernels() -> Vec<Kernel> {
    CullPass::BOTH
        .into_iter()
        .flat_map(|cull_pass| [cluster_cull(cull_pass), list_clusters(cull_pass)])
        .collect()
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
    let bindings = bind!(ClusterCull {
        view: &b.view,
        instances: r.seen,
        page_offsets: m.page_offsets(),
        pages: pages,
        candidate_groups: &groups.candidate_groups,
        culling: groups.culling(),
        drawn: &groups.drawn,
        marks: &own.marks,
        counters: &own.counters,
        pyramid: r.pyramid(),
        first_drawn: first_drawn,
        groups: m.groups(),
        pages_1: pages_1,
        pages_2: pages_2,
        pages_3: pages_3,
    });
    r.run_indirect(cluster_cull(r.cull_pass), &bindings.buffers(), groups.culling(), 0);
    let (blocks, sums) = (groups.counting(), &own.cluster_sums);
    let bits = bind!(CountBits { bits: &groups.drawn, blocks: blocks, sums: sums });
    r.run_indirect(count_bits(Bits::Clusters), &bits.buffers(), blocks, 0);
    r.run(scan_blocks(Bits::Clusters), &bind!(ScanBlocks { blocks: blocks, sums: sums }).buffers(), 1);
    let bindings = bind!(ListClusters {
        view: &b.view,
        candidate_groups: &groups.candidate_groups,
        blocks: blocks,
        drawn: &groups.drawn,
        marks: &own.marks,
        sums: sums,
        visible: &b.visible,
        numbers: &own.numbers,
        draws: own.draws(),
        counters: &own.counters,
        first_marks: first_marks,
        renumbered: &b.renumbered,
        draw_args: own.draw_args(),
        instances: r.seen,
        group_bits: r.deferred_groups(),
    });
    r.run_indirect(list_clusters(r.cull_pass), &bindings.buffers(), blocks, 0);
}
