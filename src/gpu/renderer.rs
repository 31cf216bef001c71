//! Draws frames: uploads what is needed, submits, reads back, and grows what was too short.

use std::sync::Arc;

use wgpu::{CommandEncoder, CommandEncoderDescriptor, ComputePassDescriptor};

use super::context::Context;
use super::frame::{Buffers, Recorder, Room, Shape, raster_bindings};
use super::instances::{Instances, Slots};
use super::meshes::Meshes;
use super::occlusion::{self, Pyramids};
use super::raster_hardware::{self, Draw, Target};
use super::shade::Light;
use super::shaders::{List, Phase, Words};
use super::{cluster_cull, hzb, instance_cull, node_cull, output, raster_large, raster_small, shade, times};
use crate::config::{Output, Outputs, Raster};
use crate::error::{Error, Result};
use crate::gpu_types::{
    self, Array, Counters, Dispatch, Lighting, Look, Placed, View, VisibleCluster, Visit,
};
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
    /// Which rasterizers draw; of these ways the only one that may be seen.
    pub raster: Raster,
}

/// Arrays to make of a picture, and the light for it.
#[derive(Clone, Copy, Debug)]
pub struct Wanted<'a> {
    /// The arrays.
    pub outputs: Outputs,
    /// All but the lights.
    pub lighting: Lighting,
    /// The lights.
    pub lights: &'a [gpu_types::Light],
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
    /// `shade`.
    Shade,
    /// `output`.
    Output,
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
    /// The arrays asked for.
    pub made: Vec<(Output, Array)>,
    /// Bytes of instances written to the device.
    pub uploaded_bytes: u64,
    /// Which rasterizers drew it.
    pub raster: Raster,
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
    light: Light,
    /// There once the hardware rasterizer has drawn.
    target: Option<Target>,
}

impl Renderer {
    /// A renderer on the best device there is.
    pub fn new() -> Result<Self> {
        let context = Context::shared()?;
        let (pyramids, light) = (Pyramids::new(&context, (0, 0))?, Light::new(&context)?);
        Ok(Self {
            context,
            meshes: Meshes::default(),
            instances: Instances::default(),
            room: FIRST_ROOM,
            buffers: None,
            pyramids,
            light,
            target: None,
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
    pub fn set(&mut self, slot: u32, instance: Option<(Placed, Look, &Arc<Dag>)>) {
        self.instances.set(slot, instance);
    }

    /// Draws what is in the slots, in their order, into `words`, the visibility buffer of the view's picture, and makes
    /// arrays of it.
    pub fn draw(&mut self, view: &View, ways: Ways, wanted: Wanted<'_>, words: &mut [u64]) -> Result<Drawn> {
        self.context.check()?;
        if !self.instances.any() {
            words.fill(0);
            // Nothing is to be drawn, so nothing to be measured.
            let raster = if ways.raster == Raster::Auto { Raster::Compute } else { ways.raster };
            return Ok(Drawn { raster, ..Drawn::default() });
        }
        let size = (view.width, view.height);
        let raster = raster_hardware::choose(&self.context, ways.raster, size)?;
        let hardware = raster != Raster::Compute;
        if hardware && self.target.as_ref().is_none_or(|target| target.size() != size) {
            self.target = Some(Target::new(&self.context, size));
        }
        let uploaded_bytes = self.instances.upload(&self.context, &mut self.meshes)?;
        self.light.write(&self.context, &wanted.lighting, wanted.lights)?;
        let (group_words, depth) = (self.instances.group_words(), self.instances.depth());
        let viewport = self.target.as_ref().filter(|_| hardware).map_or(0, Target::viewport);
        let mut view = View { instances: self.instances.len(), group_words, viewport, ..*view };
        let mut culling = ways.occlusion;
        if ways.occlusion {
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
                // Its lists are for other rasterizers then than those which count.
                outputs: if hardware { wanted.outputs.without(Output::Overdraw) } else { wanted.outputs },
            };
            // Others go before new ones are made.
            let buffers = match self.buffers.take().filter(|b| b.shape == shape) {
                Some(buffers) => buffers,
                None => Buffers::new(&self.context, shape).inspect_err(|_| self.room = FIRST_ROOM)?,
            };
            let ways = Ways { occlusion: culling, raster, ..ways };
            let (mut drawn, lengths) = self.submit(&buffers, &view, ways, words)?;
            self.buffers = Some(buffers);
            if lengths.visible as usize > MAX_VISIBLE {
                let count = lengths.visible;
                let message = format!("{count} clusters are visible at once, the most is {MAX_VISIBLE}");
                return Err(Error::TooLarge(message));
            }
            let room = self.room.grown(lengths);
            if room == self.room {
                (drawn.uploaded_bytes, drawn.raster) = (uploaded_bytes, raster);
                if culling {
                    let counters = drawn.phases.iter().map(|phase| phase.counters);
                    let triangles = |c: Counters| u64::from(c.triangles_small) + u64::from(c.triangles_large);
                    let built = counters.clone().any(|c| c.pyramid != 0);
                    let triangles = counters.map(triangles).sum();
                    self.pyramids.remember(&view, triangles, built);
                } else if ways.occlusion {
                    self.pyramids.wait();
                }
                return Ok(drawn);
            }
            self.room = room;
        }
    }

    /// Runs the stages once; also the lengths that its lists wanted.
    fn submit(&self, buffers: &Buffers, view: &View, ways: Ways, words: &mut [u64]) -> Result<(Drawn, Room)> {
        let Ways { wide_atomics, occlusion: culling, raster } = ways;
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
        let Some(instances) = self.instances.slots() else { return Ok(Default::default()) };
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
                if raster == Raster::Hardware {
                    passes.draw(DeviceStage::RasterSmall, phase, List::Small, form);
                } else {
                    passes.run(DeviceStage::RasterSmall, phase, |r| {
                        raster_small::record(r, form, &buffers.words)
                    });
                }
                if raster == Raster::Compute {
                    passes.run(DeviceStage::RasterLarge, phase, |r| {
                        raster_large::record(r, List::Large, form, &buffers.words)
                    });
                } else {
                    passes.draw(DeviceStage::RasterLarge, phase, List::Large, form);
                    let rest = List::Clipped;
                    passes.run(DeviceStage::RasterLarge, phase, |r| {
                        raster_large::record(r, rest, form, &buffers.words)
                    });
                }
            }
            // The visible list is that of this phase now, and not later.
            if let Some((_, counts)) = buffers.outputs.iter().find(|(output, _)| *output == Output::Overdraw)
            {
                passes.run(DeviceStage::Output, phase, |r| output::count(r, counts));
            }
            if culling {
                passes.run(DeviceStage::Hzb, phase, hzb::record);
            }
        }
        passes.make();
        let passes = passes.passes;
        buffers.times.resolve(&mut encoder, passes.len() as u32);
        buffers.copy_back(&mut encoder);
        let mut result = Default::default();
        context.submit(encoder, &buffers.staging, buffers.staged, |staged| {
            result = report(&buffers.split(staged), buffers.shape, &passes, context.tick(), words);
        })?;
        Ok(result)
    }
}

/// Records stages, a pass at a time.
struct Passes<'a> {
    renderer: &'a Renderer,
    buffers: &'a Buffers,
    instances: &'a Slots,
    slots: u32,
    encoder: &'a mut CommandEncoder,
    /// Stage and phase of each so far.
    passes: Vec<(DeviceStage, Phase)>,
}

impl<'a> Passes<'a> {
    /// Makes arrays of the finished picture.
    fn make(&mut self) {
        let buffers = self.buffers;
        let mut others = Vec::new();
        for (output, out) in &buffers.outputs {
            match output {
                Output::Color => self.run(DeviceStage::Shade, Phase::First, |r| shade::record(r, out)),
                Output::Overdraw => {}
                _ => others.push((*output, out)),
            }
        }
        if !others.is_empty() {
            self.run(DeviceStage::Output, Phase::First, |r| {
                others.iter().for_each(|(what, out)| output::record(r, *what, out));
            });
        }
    }

    fn run(&mut self, stage: DeviceStage, phase: Phase, record: impl FnOnce(&mut Recorder<'a>)) {
        let timestamp_writes = self.buffers.times.of_pass(self.passes.len() as u32);
        let descriptor = ComputePassDescriptor { label: None, timestamp_writes };
        // It ends with the recorder, below.
        let pass = self.encoder.begin_compute_pass(&descriptor).forget_lifetime();
        let Renderer { context, meshes, pyramids, light, .. } = self.renderer;
        let Self { buffers, instances, slots, .. } = *self;
        record(&mut Recorder { context, meshes, buffers, pyramids, light, instances, slots, phase, pass });
        self.passes.push((stage, phase));
    }

    /// Has the device's rasterizer draw a list.
    fn draw(&mut self, stage: DeviceStage, phase: Phase, list: List, words: Words) {
        let Renderer { context, meshes, target: Some(target), .. } = self.renderer else { return };
        let draw = Draw {
            list,
            words,
            split: meshes.split(),
            bindings: raster_bindings(self.buffers, meshes, self.instances, phase, &self.buffers.words),
            calls: &self.buffers.phases[phase as usize].calls,
            target,
            times: self.buffers.times.of_draw(self.passes.len() as u32),
        };
        draw.record(context, self.encoder);
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
    shape: Shape,
    passes: &[(DeviceStage, Phase)],
    tick: Option<f64>,
    words: &mut [u64],
) -> (Drawn, Room) {
    let (mut drawn, mut wanted) = <(Drawn, Room)>::default();
    // Of both phases where the second listed any, else of the first.
    let (mut visible, mut listed) = (&[][..], 0);
    for (number, parts) in parts.iter().enumerate() {
        if number == 0 {
            let [ticks, pixels, list, arrays @ ..] = &parts[..] else { continue };
            bytemuck::cast_slice_mut(words).copy_from_slice(pixels);
            visible = list;
            let pixels = words.len();
            let arrays = shape.outputs.iter().zip(arrays);
            drawn.made = arrays.map(|(output, bytes)| (output, Array::read(output, pixels, bytes))).collect();
            let times = passes.iter().zip(times::milliseconds(ticks, tick));
            drawn.times = times.map(|((stage, phase), ms)| (*stage, *phase, ms)).collect();
            continue;
        }
        let [counters, culling, draws, starts, levels @ ..] = &parts[..] else { continue };
        let counters: Counters = value(counters);
        let groups = value::<Dispatch>(culling).count;
        let draws = list::<Dispatch>(draws, List::COUNT);
        let levels: Vec<Dispatch> = levels.iter().map(|level| value(level)).collect();
        let of_levels = |of: fn(&Dispatch) -> u32| levels.iter().map(|level| u64::from(of(level))).sum();
        let visited: u64 = of_levels(|level| level.count);
        // The second phase starts anywhere; what it starts at a root is an instance that the first did not walk.
        let roots = list::<Visit>(starts, levels[0].count).into_iter().filter(|visit| visit.node == 0);
        drawn.instances.extend(roots.map(|visit| visit.instance));
        if counters.visible > 0 {
            listed = counters.visible;
        }
        drawn.phases.push(Counted {
            starts: u64::from(levels[0].count),
            visited: visited + of_levels(|level| level.visited),
            groups: u64::from(groups),
            clusters: draws.iter().map(|draw| u64::from(draw.count)).sum(),
            hidden_instances: of_levels(|level| level.hidden),
            counters,
        });
        // The first list is that of the instances, which has room for all.
        let visits = levels.iter().skip(usize::from(number == 1)).map(|level| level.count);
        wanted.visits = visits.fold(wanted.visits, u32::max);
        wanted.candidates = wanted.candidates.max(groups);
        wanted.visible = wanted.visible.max(counters.visible);
    }
    drawn.visible = list(visible, listed);
    drawn.instances.sort_unstable();
    drawn.instances.dedup();
    (drawn, wanted)
}
