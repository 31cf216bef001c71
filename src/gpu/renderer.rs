//! Draws frames: uploads what is needed, submits, reads back, and grows what was too short.

use std::sync::Arc;

use wgpu::{Buffer, CommandEncoder, CommandEncoderDescriptor, ComputePassDescriptor};

use super::context::Context;
use super::frame::{Buffers, Recorder, Room, Shape};
use super::instances::Instances;
use super::meshes::Meshes;
use super::occlusion::{self, Pyramids};
use super::shaders::{Phase, Words};
use super::{cluster_cull, hzb, instance_cull, node_cull, raster_large, raster_small, times};
use crate::error::{Error, Result};
use crate::gpu_types::{Counters, Dispatch, Placed, View, VisibleCluster, Visit};
use crate::limits::MAX_VISIBLE;
use crate::model::Dag;

/// Lists of a first frame; each grows to what frames need.
const FIRST_ROOM: Room = Room { visits: 1 << 12, candidates: 1 << 12, visible: 1 << 14 };

/// What may be done in other ways, with the same picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ways {
    /// One 64-bit maximum instead of two 32-bit passes, where the device has it.
    pub wide_atomics: bool,
    /// Leaves out what is hidden, in two phases.
    pub occlusion: bool,
}

/// A stage of the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceStage {
    /// `instance_cull`.
    InstanceCull,
    /// `node_cull`.
    NodeCull,
    /// `cluster_cull`.
    ClusterCull,
    /// `raster_small`.
    RasterSmall,
    /// `raster_large`.
    RasterLarge,
    /// `hzb`.
    Hzb,
}

/// What a phase counted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counted {
    /// Nodes to start from.
    pub starts: u64,
    /// Nodes and groups looked at.
    pub visited: u64,
    /// Groups of the list, for the second phase with those of the first.
    pub groups: u64,
    /// Clusters that this phase draws.
    pub clusters: u64,
    /// Instances that the pyramid of this frame hides.
    pub hidden_instances: u64,
    /// The rest.
    pub counters: Counters,
}

/// What a frame leaves: its visible list and what each stage received and passed on.
#[derive(Debug, Default)]
pub struct Drawn {
    /// Slots of the instances on the screen, ascending.
    pub instances: Vec<u32>,
    /// The visible list, in scene order.
    pub visible: Vec<VisibleCluster>,
    /// Bytes of instances written to the device.
    pub uploaded_bytes: u64,
    /// One phase, or two.
    pub phases: Vec<Counted>,
    /// Stage, phase and milliseconds of each pass on the device; NaN where it takes no time.
    pub times: Vec<(DeviceStage, Phase, f64)>,
}

/// A device with what stays on it between frames.
#[derive(Debug)]
pub struct Renderer {
    context: Arc<Context>,
    meshes: Meshes,
    instances: Instances,
    room: Room,
    buffers: Option<Buffers>,
    pyramids: Pyramids,
}

impl Renderer {
    /// A renderer on the best device there is.
    pub fn new() -> Result<Self> {
        let context = Context::shared()?;
        let pyramids = Pyramids::new(&context, (0, 0))?;
        Ok(Self {
            context,
            meshes: Meshes::default(),
            instances: Instances::default(),
            room: FIRST_ROOM,
            buffers: None,
            pyramids,
        })
    }

    /// The device.
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// Forgets the instances of the scene before.
    pub fn clear(&mut self) {
        self.instances.clear();
    }

    /// Puts an instance in a slot of the scene, or nothing. Where its mesh lies on the device is filled in.
    pub fn set(&mut self, slot: u32, instance: Option<(Placed, &Arc<Dag>)>) {
        self.instances.set(slot, instance);
    }

    /// Whether a frame of this view with occlusion has no earlier one to start from.
    pub fn starts(&self, view: &View) -> bool {
        self.pyramids.starts(view)
    }

    /// Draws what is in the slots, in their order, into `words`, the visibility buffer of the view's picture.
    pub fn draw(&mut self, view: &View, ways: Ways, words: &mut [u64]) -> Result<Drawn> {
        self.context.check()?;
        if !self.instances.any() {
            words.fill(0);
            return Ok(Drawn::default());
        }
        let uploaded_bytes = self.instances.upload(&self.context, &mut self.meshes)?;
        let (group_words, depth) = (self.instances.group_words(), self.instances.depth());
        let mut view = View { instances: self.instances.len(), group_words, ..*view };
        let mut culling = ways.occlusion;
        if ways.occlusion {
            let size = (view.width, view.height);
            if self.pyramids.size() != size {
                self.pyramids = Pyramids::new(&self.context, size)?;
            }
            self.pyramids.recall(&mut view);
            culling = !self.pyramids.paused();
        }
        loop {
            let shape = Shape {
                instances: self.instances.room(),
                group_words,
                depth,
                pixels: words.len() as u64,
                room: self.room,
                occlusion: ways.occlusion,
            };
            // Others go before new ones are made.
            let buffers = match self.buffers.take().filter(|b| b.shape == shape) {
                Some(buffers) => buffers,
                None => Buffers::new(&self.context, shape).inspect_err(|_| self.room = FIRST_ROOM)?,
            };
            let (mut drawn, wanted) = self.submit(&buffers, &view, (ways.wide_atomics, culling), words)?;
            self.buffers = Some(buffers);
            if wanted.visible as usize > MAX_VISIBLE {
                let count = wanted.visible;
                let message = format!("{count} clusters are visible at once, the most is {MAX_VISIBLE}");
                return Err(Error::TooLarge(message));
            }
            let room = self.room.grown(wanted);
            if room == self.room {
                drawn.uploaded_bytes = uploaded_bytes;
                if culling {
                    let counters = drawn.phases.iter().map(|phase| phase.counters);
                    let triangles = |c: Counters| u64::from(c.triangles_small) + u64::from(c.triangles_large);
                    let built = counters.clone().any(|c| c.pyramid != 0);
                    let triangles = counters.map(triangles).sum();
                    let hidden = |phase: &Counted| phase.hidden_instances + u64::from(phase.counters.held);
                    let hidden = drawn.phases.get(1).map_or(0, hidden);
                    self.pyramids.remember(&view, triangles, hidden, built);
                } else if ways.occlusion {
                    self.pyramids.wait();
                }
                return Ok(drawn);
            }
            self.room = room;
        }
    }

    /// Runs the stages once, with wide atomics or not, in two phases or one; also the lengths that its lists wanted.
    fn submit(
        &self,
        buffers: &Buffers,
        view: &View,
        (wide_atomics, culling): (bool, bool),
        words: &mut [u64],
    ) -> Result<(Drawn, Room)> {
        let context = &*self.context;
        let queue = context.queue();
        queue.write_buffer(&buffers.view, 0, bytemuck::bytes_of(view));
        let mut encoder = context.device().create_command_encoder(&CommandEncoderDescriptor::default());
        buffers.clear(&mut encoder);
        queue.write_buffer(&buffers.group_blocks, 0, bytemuck::bytes_of(&buffers.group_dispatch()));
        let forms: &[Words] = match wide_atomics && context.wide_atomics() {
            true => &[Words::Wide],
            false => &[Words::Keys, Words::Lows],
        };
        let Some(instances) = self.instances.buffers() else { return Ok(Default::default()) };
        let slots = self.instances.len();
        let mut passes =
            Passes { renderer: self, buffers, instances, slots, encoder: &mut encoder, passes: Vec::new() };
        let phases = if culling { &[Phase::First, Phase::Second][..] } else { &[Phase::First] };
        for &phase in phases {
            if phase == Phase::First {
                passes.run(DeviceStage::InstanceCull, phase, instance_cull::record);
            }
            passes.run(DeviceStage::NodeCull, phase, node_cull::record);
            passes.run(DeviceStage::ClusterCull, phase, |r| {
                cluster_cull::record(r);
                if culling {
                    occlusion::record(r);
                }
            });
            for &form in forms {
                passes.run(DeviceStage::RasterSmall, phase, |r| raster_small::record(r, form));
                passes.run(DeviceStage::RasterLarge, phase, |r| raster_large::record(r, form));
            }
            if culling {
                passes.run(DeviceStage::Hzb, phase, hzb::record);
            }
        }
        let passes = passes.passes;
        buffers.times.resolve(&mut encoder, passes.len() as u32);
        buffers.copy_back(&mut encoder);
        let mut result = Default::default();
        context.submit(encoder, &buffers.staging, buffers.staged, |staged| {
            result = report(&buffers.split(staged), &passes, context.tick(), words);
        })?;
        Ok(result)
    }
}

/// Records stages, a pass at a time.
struct Passes<'a> {
    renderer: &'a Renderer,
    buffers: &'a Buffers,
    instances: [&'a Buffer; 2],
    slots: u32,
    encoder: &'a mut CommandEncoder,
    /// Stage and phase of each so far.
    passes: Vec<(DeviceStage, Phase)>,
}

impl Passes<'_> {
    fn run(&mut self, stage: DeviceStage, phase: Phase, record: impl FnOnce(&mut Recorder<'_>)) {
        let timestamp_writes = self.buffers.times.of_pass(self.passes.len() as u32);
        let pass = self.encoder.begin_compute_pass(&ComputePassDescriptor { label: None, timestamp_writes });
        let Renderer { context, meshes, pyramids, .. } = self.renderer;
        let Self { buffers, instances, slots, .. } = *self;
        record(&mut Recorder { context, meshes, buffers, pyramids, instances, slots, phase, pass });
        self.passes.push((stage, phase));
    }
}

/// A value read back.
fn value<T: bytemuck::Pod>(bytes: &[u8]) -> T {
    bytemuck::pod_read_unaligned(bytes)
}

/// The first `count` entries of a list read back.
fn list<T: bytemuck::Pod>(bytes: &[u8], count: u32) -> Vec<T> {
    bytes.chunks_exact(size_of::<T>()).take(count as usize).map(value).collect()
}

/// Reads what came back: the frame, and the lengths that its lists wanted.
fn report(
    parts: &[Vec<&[u8]>],
    passes: &[(DeviceStage, Phase)],
    tick: Option<f64>,
    words: &mut [u64],
) -> (Drawn, Room) {
    let (mut drawn, mut wanted) = <(Drawn, Room)>::default();
    for (number, parts) in parts.iter().enumerate() {
        if number == 0 {
            let [ticks, pixels] = parts[..] else { continue };
            bytemuck::cast_slice_mut(words).copy_from_slice(pixels);
            let times = passes.iter().zip(times::milliseconds(ticks, tick));
            drawn.times = times.map(|((stage, phase), ms)| (*stage, *phase, ms)).collect();
            continue;
        }
        let [counters, culling, draws, starts, visible, levels @ ..] = &parts[..] else { continue };
        let counters: Counters = value(counters);
        let groups = value::<Dispatch>(culling).count;
        let draws: [Dispatch; 2] = value(draws);
        let levels: Vec<Dispatch> = levels.iter().map(|level| value(level)).collect();
        let of_levels = |of: fn(&Dispatch) -> u32| levels.iter().map(|level| u64::from(of(level))).sum();
        let visited: u64 = of_levels(|level| level.count);
        // The second phase starts anywhere; what it starts at a root is an instance that the first did not walk.
        let roots = list::<Visit>(starts, levels[0].count).into_iter().filter(|visit| visit.node == 0);
        drawn.instances.extend(roots.map(|visit| visit.instance));
        if number == 1 || counters.visible > 0 {
            drawn.visible = list(visible, counters.visible);
        }
        drawn.phases.push(Counted {
            starts: u64::from(levels[0].count),
            visited: visited + of_levels(|level| level.visited),
            groups: u64::from(groups),
            clusters: u64::from(draws[0].count) + u64::from(draws[1].count),
            hidden_instances: of_levels(|level| level.hidden),
            counters,
        });
        // The first list is that of the instances, which has room for all.
        let visits = levels.iter().skip(usize::from(number == 1)).map(|level| level.count);
        wanted.visits = visits.fold(wanted.visits, u32::max);
        wanted.candidates = wanted.candidates.max(groups);
        wanted.visible = wanted.visible.max(counters.visible);
    }
    drawn.instances.sort_unstable();
    drawn.instances.dedup();
    (drawn, wanted)
}
