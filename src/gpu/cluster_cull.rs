//! Stage 3. Clusters of groups → the visible list in scene order, and what of it each rasterizer draws.

use super::frame::Recorder;
use super::shaders::Kernel;

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, m) = (r.buffers, r.meshes);
    let bindings = [
        &b.view,
        &b.instances,
        m.page_offsets(),
        m.pages(),
        &b.candidates,
        &b.culling,
        &b.drawn,
        &b.large,
        &b.counters,
    ];
    r.run_indirect(Kernel::ClusterCull, &bindings, &b.culling, 0);
    r.run_indirect(Kernel::CountBits, &[&b.drawn, &b.counting, &b.cluster_sums], &b.counting, 0);
    r.run(Kernel::ScanBlocks, &[&b.counting, &b.cluster_sums], 1);
    let bindings =
        [&b.candidates, &b.counting, &b.drawn, &b.large, &b.cluster_sums, &b.visible, &b.numbers, &b.draws];
    r.run_indirect(Kernel::ListClusters, &bindings, &b.counting, 0);
}
