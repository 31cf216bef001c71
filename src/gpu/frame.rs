//! The buffers of a frame, and the recording of its stages.

use wgpu::{Buffer, BufferUsages, CommandEncoder, ComputePass};

use super::context::Context;
use super::meshes::Meshes;
use super::shaders::{Kernel, MAX_WORKGROUPS, SCAN_WIDTH};
use super::times::Times;
use crate::error::Result;
use crate::gpu_types::{Candidate, Counters, Dispatch, Instance, View, VisibleCluster, Visit};

const STORAGE: BufferUsages =
    BufferUsages::STORAGE.union(BufferUsages::COPY_DST).union(BufferUsages::COPY_SRC);
const DISPATCH: BufferUsages = STORAGE.union(BufferUsages::INDIRECT);

/// Entries of the lists whose lengths only the device knows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Room {
    /// Nodes of a level.
    pub visits: u32,
    /// Groups.
    pub candidates: u32,
    /// Visible clusters.
    pub visible: u32,
}

impl Room {
    /// With room for as many, in powers of two.
    pub fn grown(self, wanted: Self) -> Self {
        let grow = |room: u32, count: u32| {
            if count > room { count.checked_next_power_of_two().unwrap_or(count) } else { room }
        };
        Self {
            visits: grow(self.visits, wanted.visits),
            candidates: grow(self.candidates, wanted.candidates),
            visible: grow(self.visible, wanted.visible),
        }
    }
}

/// What a frame's buffers depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Number of instances.
    pub instances: u32,
    /// Words of the bits of all their groups.
    pub group_words: u32,
    /// Levels of the deepest hierarchy.
    pub depth: u32,
    /// Pixels of the picture.
    pub pixels: u64,
    /// Lengths of lists.
    pub room: Room,
}

/// Everything that a frame writes on the device, and what is uploaded for it.
#[derive(Debug)]
pub(super) struct Buffers {
    pub(super) shape: Shape,
    pub(super) view: Buffer,
    pub(super) instances: Buffer,
    /// Roots of instances on the screen.
    pub(super) roots: Buffer,
    /// Nodes of a level, by turns.
    pub(super) visits: [Buffer; 2],
    /// One dispatch per level.
    pub(super) levels: Vec<Buffer>,
    pub(super) group_bits: Buffer,
    /// The words of `group_bits`.
    pub(super) group_blocks: Buffer,
    pub(super) group_sums: Buffer,
    pub(super) candidates: Buffer,
    pub(super) culling: Buffer,
    pub(super) counting: Buffer,
    pub(super) drawn: Buffer,
    pub(super) large: Buffer,
    pub(super) cluster_sums: Buffer,
    pub(super) visible: Buffer,
    pub(super) numbers: Buffer,
    pub(super) draws: Buffer,
    pub(super) counters: Buffer,
    pub(super) words: Buffer,
    pub(super) times: Times,
    /// What comes back, and the bytes of it.
    pub(super) staging: Buffer,
    pub(super) staged: u64,
}

/// What comes back of a buffer: its bytes in `staging`.
struct Part<'a> {
    buffer: &'a Buffer,
    bytes: u64,
}

/// Bytes of `count` entries.
fn bytes<T>(count: u64) -> u64 {
    count * size_of::<T>() as u64
}

impl Buffers {
    pub(super) fn new(context: &Context, shape: Shape) -> Result<Self> {
        let Shape { instances, group_words, depth, pixels, room } = shape;
        let storage = |what: &str, bytes: u64| context.buffer(what, bytes, STORAGE);
        let dispatch = |count: u64| context.buffer("dispatches", bytes::<Dispatch>(count), DISPATCH);
        let sums =
            |words: u32| storage("counts of bits", bytes::<u32>(u64::from(words.div_ceil(SCAN_WIDTH)) + 1));
        let visits = || storage("nodes to look at", bytes::<Visit>(u64::from(room.visits)));
        let bits = || storage("bits of clusters", bytes::<u32>(u64::from(room.candidates)));
        let uniform = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let mut out = Self {
            shape,
            view: context.buffer("view", bytes::<View>(1), uniform)?,
            instances: storage("the instances of the scene", bytes::<Instance>(u64::from(instances)))?,
            roots: storage("the instances of the scene", bytes::<Visit>(u64::from(instances)))?,
            visits: [visits()?, visits()?],
            levels: (0..=depth).map(|_| dispatch(1)).collect::<Result<_>>()?,
            group_bits: storage("bits of groups", bytes::<u32>(u64::from(group_words)))?,
            group_blocks: dispatch(1)?,
            group_sums: sums(group_words)?,
            candidates: storage("groups to look at", bytes::<Candidate>(u64::from(room.candidates)))?,
            culling: dispatch(1)?,
            counting: dispatch(1)?,
            drawn: bits()?,
            large: bits()?,
            cluster_sums: sums(room.candidates)?,
            visible: storage("visible clusters", bytes::<VisibleCluster>(u64::from(room.visible)))?,
            numbers: storage("visible clusters", bytes::<u32>(u64::from(room.visible)))?,
            draws: dispatch(2)?,
            counters: storage("counters", bytes::<Counters>(1))?,
            words: storage("the pixels of the picture", bytes::<u64>(pixels))?,
            times: Times::new(context)?,
            staging: context.buffer("counters", 0, BufferUsages::MAP_READ)?,
            staged: 0,
        };
        out.staged = out.parts().iter().map(|part| part.bytes).sum();
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        out.staging = context.buffer("what is read back", out.staged, usage)?;
        Ok(out)
    }

    /// What comes back, in the order in which [`Buffers::read`] hands it out.
    fn parts(&self) -> Vec<Part<'_>> {
        let dispatch = bytes::<Dispatch>(1);
        let mut parts = vec![
            Part { buffer: &self.counters, bytes: bytes::<Counters>(1) },
            Part { buffer: &self.culling, bytes: dispatch },
            Part { buffer: &self.draws, bytes: 2 * dispatch },
            Part { buffer: self.times.ticks(), bytes: Times::BYTES },
        ];
        parts.extend(self.levels.iter().map(|buffer| Part { buffer, bytes: dispatch }));
        let Shape { instances, pixels, room, .. } = self.shape;
        parts.push(Part { buffer: &self.roots, bytes: bytes::<Visit>(u64::from(instances)) });
        parts.push(Part { buffer: &self.visible, bytes: bytes::<VisibleCluster>(u64::from(room.visible)) });
        parts.push(Part { buffer: &self.words, bytes: bytes::<u64>(pixels) });
        parts
    }

    /// Lists start empty, bits and words at zero.
    pub(super) fn clear(&self, encoder: &mut CommandEncoder) {
        for level in &self.levels {
            encoder.clear_buffer(level, 0, None);
        }
        for buffer in
            [&self.group_bits, &self.culling, &self.counting, &self.draws, &self.counters, &self.words]
        {
            encoder.clear_buffer(buffer, 0, None);
        }
    }

    pub(super) fn copy_back(&self, encoder: &mut CommandEncoder) {
        let mut at = 0;
        for part in self.parts() {
            encoder.copy_buffer_to_buffer(part.buffer, 0, &self.staging, at, part.bytes);
            at += part.bytes;
        }
    }

    /// The parts of what came back.
    pub(super) fn split<'a>(&self, mut staged: &'a [u8]) -> Vec<&'a [u8]> {
        let mut out = Vec::new();
        for part in self.parts() {
            let (head, tail) = staged.split_at(part.bytes as usize);
            out.push(head);
            staged = tail;
        }
        out
    }
}

/// Records a pass of a stage.
pub(super) struct Recorder<'a> {
    pub(super) context: &'a Context,
    pub(super) meshes: &'a Meshes,
    pub(super) buffers: &'a Buffers,
    pub(super) pass: ComputePass<'a>,
}

impl<'a> Recorder<'a> {
    /// What both rasterizers bind.
    pub(super) fn raster_bindings(&self) -> [&'a Buffer; 9] {
        let (b, m) = (self.buffers, self.meshes);
        [
            &b.view,
            &b.instances,
            m.page_offsets(),
            m.pages(),
            &b.visible,
            &b.numbers,
            &b.draws,
            &b.words,
            &b.counters,
        ]
    }

    fn prepare(&mut self, kernel: Kernel, buffers: &[&Buffer]) {
        self.pass.set_pipeline(self.context.pipeline(kernel));
        self.pass.set_bind_group(0, &self.context.bind(kernel, buffers), &[]);
    }

    /// Runs a kernel in as many workgroups.
    pub(super) fn run(&mut self, kernel: Kernel, buffers: &[&Buffer], workgroups: u32) {
        self.prepare(kernel, buffers);
        let rows = workgroups.div_ceil(MAX_WORKGROUPS);
        self.pass.dispatch_workgroups(workgroups.min(MAX_WORKGROUPS), rows, 1);
    }

    /// Runs a kernel in as many workgroups as entry `number` of `dispatches` says by then.
    pub(super) fn run_indirect(
        &mut self,
        kernel: Kernel,
        buffers: &[&Buffer],
        dispatches: &Buffer,
        number: u64,
    ) {
        self.prepare(kernel, buffers);
        self.pass.dispatch_workgroups_indirect(dispatches, bytes::<Dispatch>(number));
    }
}
