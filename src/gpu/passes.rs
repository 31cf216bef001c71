//! The passes of a submission: a stage in each, for all views.

use wgpu::{Buffer, CommandEncoder, ComputePassDescriptor};

use super::buffers::Buffers;
use super::context::Context;
use super::instances::Slots;
use super::kernel::{CullPass, bind};
use super::lists::List;
use super::materials;
use super::meshes::Meshes;
use super::raster::Words;
use super::raster_hardware::{Draw, raster_hardware};
use super::recorder::{Recorder, raster};
use super::shadow_table::ShadowBindings;
use super::times::Times;
use super::view_history::SubmittedView;
use super::{output, shade};
use crate::config::Output;
use crate::gpu_types::HISTORY_LIST;
use crate::stages::Stage;

/// Records stages for all views, a pass at a time.
pub(super) struct Passes<'a> {
    pub(super) context: &'a Context,
    pub(super) meshes: &'a Meshes,
    pub(super) submitted: &'a [SubmittedView<'a>],
    /// The instances of the scene, and how many slots there are.
    pub(super) instances: &'a Slots,
    pub(super) slots: u32,
    pub(super) materials: Option<&'a materials::Buffers>,
    pub(super) times: &'a Times,
    /// The pages of shadow maps, where they are looked up.
    pub(super) shadow_pages: Option<&'a Buffer>,
    /// See [`super::Ways::until`].
    pub(super) until: Option<Stage>,
    pub(super) encoder: &'a mut CommandEncoder,
    /// Stage and pass of each so far.
    pub(super) passes: Vec<(Stage, CullPass)>,
}

impl<'a> Passes<'a> {
    /// Of a pass, the views that have it, where the stage runs.
    fn submitted(&self, stage: Stage, cull_pass: CullPass) -> Vec<&'a SubmittedView<'a>> {
        let runs = self.until.is_none_or(|until| stage < until);
        let has = |view: &&SubmittedView<'_>| runs && (cull_pass == CullPass::First || view.culling);
        self.submitted.iter().filter(has).collect()
    }

    /// Whether an array is made of any view.
    pub(super) fn make(&self, which: fn(Output) -> bool) -> bool {
        self.submitted.iter().any(|submitted_view| submitted_view.buffers.shape.outputs.iter().any(which))
    }

    /// Makes all arrays of finished pictures.
    pub(super) fn make_arrays(&mut self) {
        if self.make(Output::shaded) {
            self.run(Stage::Shade, CullPass::First, shade::record);
        }
        if self.make(|output| !(output.shaded() || output == Output::Overdraw)) {
            self.run(Stage::Output, CullPass::First, output::record);
        }
    }

    pub(super) fn run(&mut self, stage: Stage, cull_pass: CullPass, record: impl Fn(&mut Recorder<'a>)) {
        let submitted = self.submitted(stage, cull_pass);
        if submitted.is_empty() {
            return;
        }
        let timestamp_writes = self.times.of_pass(self.passes.len() as u32);
        let label = format!("{stage:?}, {cull_pass:?} pass");
        let descriptor = ComputePassDescriptor { label: Some(&label), timestamp_writes };
        // It ends below, where the last recorder does.
        let mut pass = self.encoder.begin_compute_pass(&descriptor).forget_lifetime();
        let Self { context, meshes, instances, slots, materials, shadow_pages, .. } = *self;
        for (place, SubmittedView { view, seen, buffers, culling, history }) in
            submitted.into_iter().enumerate()
        {
            let (pyramids, lights, culling) = (&history.pyramids, &history.lights, *culling);
            let listed = view.history == HISTORY_LIST;
            let tables = history.shadow_table.as_ref().zip(shadow_pages);
            let shadows = tables.map(|(table, pages)| {
                bind!(ShadowBindings { shadow_table: table.buffer(), shadow_pages: pages })
            });
            let mut recorder = Recorder {
                context,
                meshes,
                instances,
                slots,
                seen,
                buffers,
                pyramids,
                lights,
                materials,
                shadows,
                culling,
                listed,
                cull_pass,
                pass,
            };
            recorder.pass.push_debug_group(&format!("view {place}"));
            record(&mut recorder);
            recorder.pass.pop_debug_group();
            pass = recorder.pass;
        }
        self.passes.push((stage, cull_pass));
    }

    /// Has the device's rasterizer draw a list of each view, in the form that `form` says.
    pub(super) fn draw(
        &mut self,
        stage: Stage,
        cull_pass: CullPass,
        list: List,
        form: impl Fn(&Buffers) -> Option<Words>,
    ) {
        let Self { context, meshes, .. } = *self;
        let (submitted, number) = (self.submitted(stage, cull_pass), self.passes.len() as u32);
        for (place, SubmittedView { buffers, seen, history, .. }) in submitted.iter().enumerate() {
            let (Some(target), Some(words)) = (&history.target, form(buffers)) else { continue };
            let bound = raster(buffers, meshes, seen, cull_pass, &buffers.words);
            let draw = Draw {
                list,
                words,
                split: meshes.split(),
                group: buffers.bind_groups.get(context, raster_hardware(list, words), &bound),
                draw_args: buffers.cull_passes[cull_pass as usize].draw_args(),
                target,
                times: self.times.of_draw(number, place == 0, place + 1 == submitted.len()),
            };
            draw.record(context, self.encoder);
        }
        if !submitted.is_empty() {
            self.passes.push((stage, cull_pass));
        }
    }
}
