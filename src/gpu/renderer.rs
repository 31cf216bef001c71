//! Draws frames: uploads what is needed, submits, reads back, and grows what was too short.

use std::sync::Arc;

use wgpu::{CommandEncoder, CommandEncoderDescriptor, ComputePassDescriptor};

use super::context::Context;
use super::frame::{Buffers, Recorder, Room, Shape};
use super::meshes::Meshes;
use super::shaders::Words;
use super::times::{self, TIMED_STAGES};
use super::{cluster_cull, instance_cull, node_cull, raster_large, raster_small};
use crate::error::{Error, Result};
use crate::gpu_types::{Counters, Dispatch, Instance, View, VisibleCluster, Visit};
use crate::limits::MAX_VISIBLE;
use crate::model::Dag;

/// Lists of a first frame; each grows to what frames need.
const FIRST_ROOM: Room = Room { visits: 1 << 12, candidates: 1 << 12, visible: 1 << 14 };

/// What a frame leaves: its visible list and what each stage received and passed on.
#[derive(Debug, Default)]
pub struct Drawn {
    /// Numbers of the instances on the screen, ascending.
    pub instances: Vec<u32>,
    /// The visible list, in scene order.
    pub visible: Vec<VisibleCluster>,
    /// Nodes and groups looked at.
    pub visited: u64,
    /// Groups whose clusters were looked at.
    pub groups: u64,
    /// What stages counted.
    pub counters: Counters,
    /// Milliseconds that each stage took on the device; NaN where it takes no time.
    pub times: [f64; TIMED_STAGES],
}

/// A device with what stays on it between frames.
#[derive(Debug)]
pub struct Renderer {
    context: Arc<Context>,
    meshes: Meshes,
    room: Room,
    buffers: Option<Buffers>,
}

impl Renderer {
    /// A renderer on the best device there is.
    pub fn new() -> Result<Self> {
        let context = Context::shared()?;
        Ok(Self { context, meshes: Meshes::default(), room: FIRST_ROOM, buffers: None })
    }

    /// The device.
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// Draws instances of meshes, in scene order, into `words`, the visibility buffer of the view's picture. Without
    /// `wide_atomics`, or where the device has none, by two 32-bit passes.
    pub fn draw(
        &mut self,
        view: &View,
        instances: &mut [(Instance, &Arc<Dag>)],
        wide_atomics: bool,
        words: &mut [u64],
    ) -> Result<Drawn> {
        self.context.check()?;
        if instances.is_empty() {
            words.fill(0);
            return Ok(Drawn::default());
        }
        self.meshes.upload(&self.context, instances.iter().map(|(_, mesh)| *mesh))?;
        let (group_words, depth) = self.place(instances)?;
        let view = View { instances: instances.len() as u32, ..*view };
        let records: Vec<Instance> = instances.iter().map(|(instance, _)| *instance).collect();
        loop {
            let shape = Shape {
                instances: view.instances,
                group_words,
                depth,
                pixels: words.len() as u64,
                room: self.room,
            };
            // Others go before new ones are made.
            let buffers = match self.buffers.take().filter(|b| b.shape == shape) {
                Some(buffers) => buffers,
                None => Buffers::new(&self.context, shape)?,
            };
            let (drawn, wanted) = self.submit(&buffers, &view, &records, wide_atomics, words)?;
            self.buffers = Some(buffers);
            if wanted.visible as usize > MAX_VISIBLE {
                let count = wanted.visible;
                let message = format!("{count} clusters are visible at once, the most is {MAX_VISIBLE}");
                return Err(Error::TooLarge(message));
            }
            let room = self.room.grown(wanted);
            if room == self.room {
                return Ok(drawn);
            }
            self.room = room;
        }
    }

    /// Tells each instance where its mesh is and gives it bits for its groups: all words of bits, and the levels of the
    /// deepest hierarchy.
    fn place(&self, instances: &mut [(Instance, &Arc<Dag>)]) -> Result<(u32, u32)> {
        let (mut words, mut depth) = (0u32, 0);
        for (instance, mesh) in instances {
            let Some(place) = self.meshes.placement(mesh) else {
                return Err(Error::Invariant("a mesh of the scene was not uploaded".to_owned()));
            };
            instance.first_node = place.first_node;
            instance.first_group = place.first_group;
            instance.first_page = place.first_page;
            instance.vertex_words = place.vertex_words;
            instance.group_words = words;
            depth = depth.max(place.depth);
            words = words.checked_add((mesh.groups.len() as u32).div_ceil(u32::BITS)).ok_or_else(|| {
                Error::TooLarge(
                    "the instances of the scene have more than 2^37 groups of clusters".to_owned(),
                )
            })?;
        }
        Ok((words, depth))
    }

    /// Runs the stages once; also the lengths that its lists wanted.
    fn submit(
        &self,
        buffers: &Buffers,
        view: &View,
        instances: &[Instance],
        wide_atomics: bool,
        words: &mut [u64],
    ) -> Result<(Drawn, Room)> {
        let context = &*self.context;
        let queue = context.queue();
        queue.write_buffer(&buffers.view, 0, bytemuck::bytes_of(view));
        queue.write_buffer(&buffers.instances, 0, bytemuck::cast_slice(instances));
        let blocks = Dispatch { count: buffers.shape.group_words, ..Dispatch::default() };
        queue.write_buffer(&buffers.group_blocks, 0, bytemuck::bytes_of(&blocks));
        let mut encoder = context.device().create_command_encoder(&CommandEncoderDescriptor::default());
        buffers.clear(&mut encoder);
        let mut passes = Passes { renderer: self, buffers, encoder: &mut encoder, stages: Vec::new() };
        passes.run(0, instance_cull::record);
        passes.run(1, node_cull::record);
        passes.run(2, cluster_cull::record);
        let forms: &[Words] = match wide_atomics && context.wide_atomics() {
            true => &[Words::Wide],
            false => &[Words::Keys, Words::Lows],
        };
        for &form in forms {
            passes.run(3, |recorder| raster_small::record(recorder, form));
            passes.run(4, |recorder| raster_large::record(recorder, form));
        }
        let stages = passes.stages;
        buffers.times.resolve(&mut encoder, stages.len() as u32);
        buffers.copy_back(&mut encoder);
        let mut result = Default::default();
        context.submit(encoder, &buffers.staging, buffers.staged, |staged| {
            result = report(&buffers.split(staged), &stages, context.tick(), words);
        })?;
        Ok(result)
    }
}

/// Records stages, a pass at a time.
struct Passes<'a> {
    renderer: &'a Renderer,
    buffers: &'a Buffers,
    encoder: &'a mut CommandEncoder,
    /// The stage of each pass so far.
    stages: Vec<usize>,
}

impl Passes<'_> {
    fn run(&mut self, stage: usize, record: impl FnOnce(&mut Recorder<'_>)) {
        let timestamp_writes = self.buffers.times.of_pass(self.stages.len() as u32);
        let pass = self.encoder.begin_compute_pass(&ComputePassDescriptor { label: None, timestamp_writes });
        let Renderer { context, meshes, .. } = self.renderer;
        record(&mut Recorder { context, meshes, buffers: self.buffers, pass });
        self.stages.push(stage);
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
fn report(parts: &[&[u8]], stages: &[usize], tick: Option<f64>, words: &mut [u64]) -> (Drawn, Room) {
    let [counters, culling, draws, ticks, levels @ .., roots, visible, pixels] = parts else {
        return Default::default();
    };
    bytemuck::cast_slice_mut(words).copy_from_slice(pixels);
    let culling: Dispatch = value(culling);
    let draws: [Dispatch; 2] = value(draws);
    let levels: Vec<Dispatch> = levels.iter().map(|level| value(level)).collect();
    let mut instances: Vec<u32> =
        list::<Visit>(roots, levels[0].count).iter().map(|visit| visit.instance).collect();
    instances.sort_unstable();
    let clusters = draws[0].count + draws[1].count;
    let drawn = Drawn {
        instances,
        visible: list(visible, clusters),
        visited: levels.iter().map(|level| u64::from(level.count) + u64::from(level.visited)).sum(),
        groups: u64::from(culling.count),
        counters: value(counters),
        times: times::milliseconds(ticks, stages, tick),
    };
    // The first level is the list of instances, which has room for all.
    let visits = levels[1..].iter().map(|level| level.count).max().unwrap_or(0);
    (drawn, Room { visits, candidates: culling.count, visible: clusters })
}
