//! Records a stage for a view: what it binds, and how often it runs.

use wgpu::{Buffer, ComputePass};

use super::buffers::{Buffers, PassBuffers, bytes};
use super::context::Context;
use super::instances::Slots;
use super::kernel::{Bindings, BoundBuffer, CullPass, Kernel, MAX_WORKGROUPS, WIDTH, bind};
use super::lights::Lights;
use super::materials;
use super::meshes::Meshes;
use super::pyramids::Pyramids;
use super::raster::{OneView, RasterBindings};
use super::shadow_table::ShadowBindings;
use super::surface::SurfaceBindings;
use crate::gpu_types::Dispatch;

/// What the rasterizers of a pass bind, which write into `words`.
pub(super) fn raster<'a>(
    buffers: &'a Buffers,
    meshes: &'a Meshes,
    seen: &'a Buffer,
    cull_pass: CullPass,
    words: &'a Buffer,
) -> Vec<BoundBuffer<'a>> {
    let own = &buffers.cull_passes[cull_pass as usize];
    let [pages, pages_1, pages_2, pages_3] = meshes.pages();
    let all = bind!(RasterBindings {
        instances: seen,
        page_offsets: meshes.page_offsets(),
        pages: pages,
        visible: &buffers.visible,
        draws: own.draws(),
        words: words,
        counters: &own.counters,
        pages_1: pages_1,
        pages_2: pages_2,
        pages_3: pages_3,
    });
    let view = bind!(OneView { view: &buffers.view, numbers: &own.numbers });
    [all.buffers(), view.buffers()].concat()
}

/// What shading and all other arrays bind, one of which goes to `out`.
pub(super) fn surface<'a>(
    buffers: &'a Buffers,
    meshes: &'a Meshes,
    seen: &'a Buffer,
    instances: &'a Slots,
    out: &'a Buffer,
) -> SurfaceBindings<'a> {
    let [pages, pages_1, pages_2, pages_3] = meshes.pages();
    bind!(SurfaceBindings {
        view: &buffers.view,
        instances: seen,
        page_offsets: meshes.page_offsets(),
        pages: pages,
        pages_1: pages_1,
        pages_2: pages_2,
        pages_3: pages_3,
        visible: &buffers.visible,
        instance_materials: &instances.instance_materials,
        words: &buffers.words,
        out: out,
    })
}

/// Records a stage for a view, in a pass.
pub(super) struct Recorder<'a> {
    pub(super) context: &'a Context,
    pub(super) meshes: &'a Meshes,
    /// The instances of the scene, and how many slots there are.
    pub(super) instances: &'a Slots,
    pub(super) slots: u32,
    /// The same as seen from the view.
    pub(super) seen: &'a Buffer,
    pub(super) buffers: &'a Buffers,
    pub(super) pyramids: &'a Pyramids,
    pub(super) lights: &'a Lights,
    /// Materials, where an instance has others than a plain one.
    pub(super) materials: Option<&'a materials::Buffers>,
    /// The shadow maps of the lights, where these throw shadows.
    pub(super) shadows: Option<ShadowBindings<'a>>,
    /// What is hidden is left out, in two passes.
    pub(super) culling: bool,
    /// The first pass starts from what the frame before drew.
    pub(super) listed: bool,
    pub(super) cull_pass: CullPass,
    pub(super) pass: ComputePass<'a>,
}

impl<'a> Recorder<'a> {
    /// What this pass writes.
    pub(super) fn own(&self) -> &'a PassBuffers {
        &self.buffers.cull_passes[self.cull_pass as usize]
    }

    /// What the first pass wrote, for the second; for the first, what nobody reads.
    pub(super) fn first(&self) -> &'a PassBuffers {
        &self.buffers.cull_passes[0]
    }

    /// The occluded queue to which this pass defers: a list and its count.
    pub(super) fn occluded_queue(&self) -> [BoundBuffer<'a>; 2] {
        match (self.cull_pass, &self.buffers.cull_passes[..]) {
            (CullPass::First, [_, second]) => [(&second.starts).into(), second.levels.level(0)],
            _ => self.buffers.unused_queue.each_ref().map(BoundBuffer::from),
        }
    }

    /// The bits of groups that this pass marks for the second; what nobody writes where there is none.
    pub(super) fn deferred_groups(&self) -> &'a Buffer {
        match (self.cull_pass, &self.buffers.cull_passes[..]) {
            (CullPass::First, [_, second]) => &second.groups.bits,
            _ => &self.buffers.unused_queue[0],
        }
    }

    /// The depth pyramid that this pass culls with.
    pub(super) fn pyramid(&self) -> &'a Buffer {
        match self.cull_pass {
            CullPass::First => self.pyramids.earlier(),
            CullPass::Second => self.pyramids.own(),
        }
    }

    /// What the rasterizers bind, which write into `words`.
    pub(super) fn raster(&self, words: &'a Buffer) -> Vec<BoundBuffer<'a>> {
        raster(self.buffers, self.meshes, self.seen, self.cull_pass, words)
    }

    /// What shading and all other arrays bind, one of which goes to `out`.
    pub(super) fn surface(&self, out: &'a Buffer) -> SurfaceBindings<'a> {
        surface(self.buffers, self.meshes, self.seen, self.instances, out)
    }

    /// Workgroups whose lanes take four pixels each.
    pub(super) fn picture_workgroups(&self) -> u32 {
        // As many as a picture has at most fit.
        self.buffers.shape.pixels.div_ceil(u64::from(4 * WIDTH)) as u32
    }

    fn prepare(&mut self, kernel: Kernel, bound: &[BoundBuffer<'_>]) {
        self.pass.insert_debug_marker(kernel.file);
        self.pass.set_pipeline(&self.context.pipeline(kernel, self.meshes.split()));
        let group = self.buffers.bind_groups.get(self.context, kernel, bound);
        self.pass.set_bind_group(0, &group, &[]);
    }

    /// Runs a kernel in as many workgroups.
    pub(super) fn run(&mut self, kernel: Kernel, bound: &[BoundBuffer<'_>], workgroups: u32) {
        self.prepare(kernel, bound);
        let rows = workgroups.div_ceil(MAX_WORKGROUPS);
        self.pass.dispatch_workgroups(workgroups.min(MAX_WORKGROUPS), rows, 1);
    }

    /// Runs a kernel in as many workgroups as entry `number` of `dispatches` says by then.
    pub(super) fn run_indirect<'b>(
        &mut self,
        kernel: Kernel,
        bound: &[BoundBuffer<'_>],
        dispatches: impl Into<BoundBuffer<'b>>,
        number: u32,
    ) {
        self.prepare(kernel, bound);
        let BoundBuffer { buffer, offset, .. } = dispatches.into();
        self.pass.dispatch_workgroups_indirect(buffer, offset + bytes::<Dispatch>(number));
    }
}
