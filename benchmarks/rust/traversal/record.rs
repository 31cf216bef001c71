//! The steps of every form, recorded: kernels of the product with bindings as in `src/gpu/`, and the benchmark's own.

use nanite_rs::gpu::CullPass;
use nanite_rs::gpu::kernels::{
    Bits, BoundBuffer, INSTANCE_CULL, Kernel, MAX_WORKGROUPS, WIDTH, cluster_cull, count_bits, list_clusters,
    list_groups, node_cull, scan_blocks,
};
use nanite_rs::gpu::wgpu::{BindGroupDescriptor, BindGroupEntry, Buffer, ComputePass};

use super::super::kernels::Own;
use super::{Arranged, Form, Forms};

/// Whose kernel.
#[derive(Clone, Copy, Debug)]
enum Use {
    Product(Kernel),
    Own(Own),
}

impl Forms {
    fn prepare(&self, pass: &mut ComputePass<'_>, kernel: Use, buffers: &[&Buffer]) {
        let group = match kernel {
            Use::Product(kernel) => {
                pass.set_pipeline(&self.context.pipeline(kernel, self.meshes.split()));
                let bound: Vec<_> = buffers.iter().map(|buffer| BoundBuffer::from(*buffer)).collect();
                self.context.bind(kernel, &bound)
            }
            Use::Own(kernel) => {
                let pipeline = &self.own[kernel as usize];
                pass.set_pipeline(pipeline);
                let whole = (0..).zip(buffers.iter().map(|buffer| buffer.as_entire_binding()));
                let entries: Vec<_> =
                    whole.map(|(binding, resource)| BindGroupEntry { binding, resource }).collect();
                let layout = &pipeline.get_bind_group_layout(0);
                let descriptor = BindGroupDescriptor { label: None, layout, entries: &entries };
                self.context.device().create_bind_group(&descriptor)
            }
        };
        pass.set_bind_group(0, &group, &[]);
    }

    fn run_kernel(&self, pass: &mut ComputePass<'_>, kernel: Use, buffers: &[&Buffer], workgroups: u32) {
        self.prepare(pass, kernel, buffers);
        let rows = workgroups.div_ceil(MAX_WORKGROUPS);
        pass.dispatch_workgroups(workgroups.min(MAX_WORKGROUPS), rows, 1);
    }

    fn run_as(&self, pass: &mut ComputePass<'_>, kernel: Use, buffers: &[&Buffer], dispatch: &Buffer) {
        self.prepare(pass, kernel, buffers);
        pass.dispatch_workgroups_indirect(dispatch, 0);
    }

    pub(super) fn instance_cull(&self, pass: &mut ComputePass<'_>, of: &Arranged) {
        let [occluded_queue, occluded_dispatch] = &self.unused_queue;
        // There is no earlier frame: any buffer does for its pyramid.
        let pyramid = &self.group_bases;
        let bindings = [
            &self.view,
            &of.instance_transform,
            &of.seen,
            &self.starts,
            &self.levels[0],
            pyramid,
            occluded_queue,
            occluded_dispatch,
        ];
        let kernel = Use::Product(INSTANCE_CULL);
        self.run_kernel(pass, kernel, &bindings, self.instances.div_ceil(WIDTH));
    }

    /// As `src/gpu/node_cull.rs`.
    pub(super) fn walk_levels(&self, pass: &mut ComputePass<'_>) {
        let [occluded_queue, occluded_dispatch] = &self.unused_queue;
        for level in 0..self.sizes.depth as usize {
            let from = if level == 0 { &self.starts } else { &self.lists.items[level % 2] };
            let bindings = [
                &self.view,
                &self.groups.seen,
                self.meshes.nodes(),
                self.meshes.groups(),
                from,
                &self.levels[level],
                &self.lists.items[(level + 1) % 2],
                &self.levels[level + 1],
                &self.groups.bits,
                &self.group_bases,
                occluded_queue,
                occluded_dispatch,
                self.meshes.page_offsets(),
                &self.wanted,
            ];
            let kernel = Use::Product(node_cull(CullPass::First));
            self.run_as(pass, kernel, &bindings, &self.levels[level]);
        }
    }

    pub(super) fn walk_queue(&self, pass: &mut ComputePass<'_>) {
        let bindings = [
            &self.view,
            &self.groups.seen,
            self.meshes.nodes(),
            self.meshes.groups(),
            &self.starts,
            &self.levels[0],
            &self.groups.bits,
            &self.queue,
            &self.slots,
        ];
        self.run_kernel(pass, Use::Own(Own::WorkQueue), &bindings, self.ring.workers);
    }

    pub(super) fn look_at_parts(&self, pass: &mut ComputePass<'_>) {
        self.run_kernel(pass, Use::Own(Own::PartDispatch), &[&self.levels[0], &self.looking], 1);
        let bindings =
            [&self.view, &self.parts.seen, &self.part_records, &self.starts, &self.looking, &self.parts.bits];
        self.run_as(pass, Use::Own(Own::PartCull), &bindings, &self.looking);
    }

    /// As `src/gpu/node_cull.rs`.
    pub(super) fn list(&self, pass: &mut ComputePass<'_>, form: Form) {
        let of = self.arranged(form);
        let (kernel, records) = match form {
            Form::Parts => (Use::Own(Own::ListParts), &self.part_records),
            _ => (Use::Product(list_groups(CullPass::First)), self.meshes.groups()),
        };
        let bindings = [&of.bits, &of.blocks, &of.sums];
        self.run_as(pass, Use::Product(count_bits(Bits::Groups)), &bindings, &of.blocks);
        self.run_kernel(pass, Use::Product(scan_blocks(Bits::Groups)), &[&of.blocks, &of.sums], 1);
        let bindings = [
            &self.view,
            &of.seen,
            records,
            &of.bits,
            &of.blocks,
            &of.sums,
            &self.lists.candidates,
            &self.culling,
            &self.counting,
            &of.bits,
            &of.sums,
        ];
        self.run_as(pass, kernel, &bindings, &of.blocks);
    }

    /// As `src/gpu/cluster_cull.rs`.
    pub(super) fn cull_clusters(&self, pass: &mut ComputePass<'_>, form: Form) {
        let (of, lists) = (self.arranged(form), &self.lists);
        let [pages, pages_1, pages_2, pages_3] = self.meshes.pages().map(|array| array.buffer);
        let common = [
            &self.view,
            &of.seen,
            self.meshes.page_offsets(),
            pages,
            &lists.candidates,
            &self.culling,
            &lists.drawn,
            &lists.marks,
            &self.counters,
        ];
        let (kernel, more) = match form {
            Form::Parts => (
                Use::Own(Own::PartClusters),
                vec![self.meshes.groups(), &self.group_bases, pages_1, pages_2, pages_3],
            ),
            // No pyramid, and nothing of another pass.
            _ => (
                Use::Product(cluster_cull(CullPass::First)),
                vec![
                    &self.unused_queue[0],
                    &lists.candidates,
                    self.meshes.groups(),
                    pages_1,
                    pages_2,
                    pages_3,
                ],
            ),
        };
        self.run_as(pass, kernel, &[&common[..], &more].concat(), &self.culling);
        let bindings = [&lists.drawn, &self.counting, &lists.sums];
        self.run_as(pass, Use::Product(count_bits(Bits::Clusters)), &bindings, &self.counting);
        self.run_kernel(pass, Use::Product(scan_blocks(Bits::Clusters)), &[&self.counting, &lists.sums], 1);
        let bindings = [
            &self.view,
            &lists.candidates,
            &self.counting,
            &lists.drawn,
            &lists.marks,
            &lists.sums,
            &lists.visible,
            &lists.numbers,
            &self.draws,
            &self.counters,
            &lists.candidates,
            &self.unused_queue[0],
            &self.draw_args,
            &of.seen,
            &self.unused_queue[1],
        ];
        let kernel = Use::Product(list_clusters(CullPass::First));
        self.run_as(pass, kernel, &bindings, &self.counting);
    }
}
