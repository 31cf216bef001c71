//! The passes of a submission: a stage in each, for all views.

use wgpu::{CommandEncoder, ComputePassDescriptor};

use super::context::Context;
use super::frame::{Recorder, raster_bindings};
use super::instances::Slots;
use super::materials;
use super::meshes::Meshes;
use super::raster_hardware::{Draw, Target};
use super::renderer::DeviceStage;
use super::shaders::{List, Phase, Words};
use super::sight::Turn;
use super::times::Times;
use crate::gpu_types::HISTORY_LIST;

/// Records stages for all views, a pass at a time.
pub(super) struct Passes<'a> {
    pub(super) context: &'a Context,
    pub(super) meshes: &'a Meshes,
    pub(super) target: Option<&'a Target>,
    pub(super) turns: &'a [Turn<'a>],
    /// The instances of the scene, and how many slots there are.
    pub(super) instances: &'a Slots,
    pub(super) slots: u32,
    pub(super) materials: Option<&'a materials::Buffers>,
    pub(super) times: &'a Times,
    pub(super) encoder: &'a mut CommandEncoder,
    /// Stage and phase of each so far.
    pub(super) passes: Vec<(DeviceStage, Phase)>,
}

impl<'a> Passes<'a> {
    /// Of a phase, the views that have it.
    fn turns(&self, phase: Phase) -> Vec<&'a Turn<'a>> {
        self.turns.iter().filter(|turn| phase == Phase::First || turn.culling).collect()
    }

    pub(super) fn run(&mut self, stage: DeviceStage, phase: Phase, record: impl Fn(&mut Recorder<'a>)) {
        let turns = self.turns(phase);
        if turns.is_empty() {
            return;
        }
        let timestamp_writes = self.times.of_pass(self.passes.len() as u32);
        let descriptor = ComputePassDescriptor { label: None, timestamp_writes };
        // It ends below, where the last recorder does.
        let mut pass = self.encoder.begin_compute_pass(&descriptor).forget_lifetime();
        let Self { context, meshes, instances, slots, materials, .. } = *self;
        for Turn { view, seen, buffers, culling, sight } in turns {
            let (pyramids, light, culling) = (&sight.pyramids, &sight.light, *culling);
            let listed = view.history == HISTORY_LIST;
            let mut recorder = Recorder {
                context,
                meshes,
                instances,
                slots,
                seen,
                buffers,
                pyramids,
                light,
                materials,
                culling,
                listed,
                phase,
                pass,
            };
            record(&mut recorder);
            pass = recorder.pass;
        }
        self.passes.push((stage, phase));
    }

    /// Has the device's rasterizer draw a list.
    pub(super) fn draw(&mut self, stage: DeviceStage, phase: Phase, list: List, words: Words) {
        let Self { context, meshes, target: Some(target), .. } = *self else { return };
        let (turns, number) = (self.turns(phase), self.passes.len() as u32);
        for (place, Turn { buffers, seen, .. }) in turns.iter().enumerate() {
            let bindings = raster_bindings(buffers, meshes, seen, phase, &buffers.words);
            let draw = Draw {
                list,
                words,
                split: meshes.split(),
                bindings: bindings.iter().map(|buffer| meshes.binding(buffer)).collect(),
                calls: &buffers.phases[phase as usize].calls,
                target,
                times: self.times.of_draw(number, place == 0, place + 1 == turns.len()),
            };
            draw.record(context, self.encoder);
        }
        if !turns.is_empty() {
            self.passes.push((stage, phase));
        }
    }
}
