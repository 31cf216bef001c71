//! The buffers of a view's frame: lists, counts, the visibility buffer, and what comes back of them.

use std::sync::Arc;

use wgpu::{Buffer, BufferSize, BufferUsages, CommandEncoder};

use super::bind_groups::BindGroups;
use super::context::Context;
use super::kernel::BoundBuffer;
use super::lists::{Bits, IndirectEntry, List, group_bit_words};
use super::times::Times;
use crate::config::{Output, Outputs};
use crate::error::Result;
use crate::gpu_types::{
    CandidateGroup, Counters, Dispatch, DrawArgs, Marks, TraversalItem, View, VisibleCluster,
};

const STORAGE: BufferUsages =
    BufferUsages::STORAGE.union(BufferUsages::COPY_DST).union(BufferUsages::COPY_SRC);
const DISPATCH: BufferUsages = STORAGE.union(BufferUsages::INDIRECT);

/// Where parts of a buffer begin that are bound by themselves: at multiples of what no device asks for more than.
const PART_BYTES: u64 = 256;

/// A part of a buffer, with so many entries.
fn part<T>(buffer: &Buffer, number: u32, entries: u32) -> BoundBuffer<'_> {
    let (offset, size) = (u64::from(number) * PART_BYTES, BufferSize::new(bytes::<T>(entries)));
    BoundBuffer { buffer, offset, size }
}

/// The dispatches of the levels of a traversal. That of a level is read while that of the next is written, which may not be
/// parts of one buffer; so even and odd levels lie in two.
#[derive(Debug)]
pub(super) struct Levels([Buffer; 2]);

impl Levels {
    /// For hierarchies of so many levels, and the one behind them.
    fn new(context: &Context, depth: u32) -> Result<Self> {
        let buffer = || context.buffer("dispatches", Self::bytes(depth), DISPATCH);
        Ok(Self([buffer()?, buffer()?]))
    }

    /// Bytes of each of the two.
    fn bytes(depth: u32) -> u64 {
        u64::from(depth / 2 + 1) * PART_BYTES
    }

    /// The dispatch of a level.
    pub(super) fn level(&self, level: usize) -> BoundBuffer<'_> {
        part::<Dispatch>(&self.0[level % 2], (level / 2) as u32, 1)
    }

    /// All of them, of what came back.
    pub(super) fn read(even: &[u8], odd: &[u8], depth: u32) -> Vec<Dispatch> {
        let of = |level: usize| {
            let at = level / 2 * PART_BYTES as usize;
            bytemuck::pod_read_unaligned(&[even, odd][level % 2][at..at + size_of::<Dispatch>()])
        };
        (0..=depth as usize).map(of).collect()
    }
}

/// Entries of the lists whose lengths only the device knows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Room {
    /// Nodes of a level.
    pub items: u32,
    /// Groups.
    pub candidate_groups: u32,
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
            items: grow(self.items, wanted.items),
            candidate_groups: grow(self.candidate_groups, wanted.candidate_groups),
            visible: grow(self.visible, wanted.visible),
        }
    }
}

/// What a frame's buffers depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Slots of instances that there is room for.
    pub instances: u32,
    /// Words of the bits of all their groups.
    pub group_words: u32,
    /// Levels of the deepest hierarchy.
    pub depth: u32,
    /// Entries of the tables of pages, where some may not be there; else none.
    pub pages: u32,
    /// Pixels of the picture.
    pub pixels: u64,
    /// Lengths of lists.
    pub room: Room,
    /// What is hidden is left out, in two passes.
    pub occlusion: bool,
    /// The visibility buffer has keys alone.
    pub depth_only: bool,
    /// Arrays to make.
    pub outputs: Outputs,
    /// The visibility buffer is not read back.
    pub stays_on_device: bool,
    /// Candidate groups are.
    pub groups_come_back: bool,
    /// Arrays come back by themselves.
    pub waits: bool,
}

impl Shape {
    /// The same of what does not come back.
    pub(super) fn inner(self) -> Self {
        Self {
            outputs: Outputs::default(),
            stays_on_device: false,
            groups_come_back: false,
            waits: false,
            ..self
        }
    }

    /// What the lists of the passes depend on.
    fn lists(&self) -> (u32, u32, u32, Room, bool) {
        (self.instances, self.group_words, self.depth, self.room, self.occlusion)
    }

    /// Bytes of the visibility buffer.
    fn word_bytes(&self) -> u64 {
        let pixel = if self.depth_only { size_of::<u32>() } else { size_of::<u64>() };
        self.pixels * pixel as u64
    }
}

/// The groups that a pass looks at, and which of their clusters are drawn.
#[derive(Debug)]
pub(super) struct Groups {
    pub(super) bits: Buffer,
    pub(super) sums: Buffer,
    pub(super) candidate_groups: Buffer,
    /// How their clusters are culled, and how what is left of them is counted.
    dispatches: Buffer,
    pub(super) drawn: Buffer,
}

impl Groups {
    fn new(context: &Context, shape: Shape) -> Result<Self> {
        let Shape { group_words, room, .. } = shape;
        let storage = |what: &str, bytes: u64| context.buffer(what, bytes, STORAGE);
        let sums = bytes::<u32>(Bits::Groups.sums(group_words));
        Ok(Self {
            bits: storage("bits of groups", bytes::<u32>(group_bit_words(group_words)))?,
            sums: storage("counts of bits", sums)?,
            candidate_groups: storage("groups to look at", bytes::<CandidateGroup>(room.candidate_groups))?,
            dispatches: context.buffer("dispatches", 2 * PART_BYTES, DISPATCH)?,
            drawn: storage("bits of clusters", bytes::<u32>(room.candidate_groups))?,
        })
    }

    /// The dispatch that culls their clusters.
    pub(super) fn culling(&self) -> BoundBuffer<'_> {
        part::<Dispatch>(&self.dispatches, 0, 1)
    }

    /// The dispatches that count and list what is left of them.
    pub(super) fn counting(&self) -> BoundBuffer<'_> {
        part::<Dispatch>(&self.dispatches, 1, 1)
    }
}

/// What one pass writes: its walk, its candidates, its list.
#[derive(Debug)]
pub(super) struct PassBuffers {
    /// Nodes to start from: roots of instances on the screen, or what the first pass deferred.
    pub(super) starts: Buffer,
    pub(super) levels: Levels,
    pub(super) groups: Groups,
    pub(super) marks: Buffer,
    pub(super) cluster_sums: Buffer,
    /// Of the clusters of each list, with room for all in the small and the large one together, and in the clipped one.
    pub(super) numbers: Buffer,
    /// The lists for rasterizers in compute, and for the device's.
    draws: Buffer,
    pub(super) counters: Buffer,
    /// What is decided after it.
    pub(super) indirect: Buffer,
}

impl PassBuffers {
    fn new(context: &Context, shape: Shape, starts: u32) -> Result<Self> {
        let Shape { depth, room, .. } = shape;
        let storage = |what: &str, bytes: u64| context.buffer(what, bytes, STORAGE);
        Ok(Self {
            starts: storage("the instances of the scene", bytes::<TraversalItem>(starts))?,
            levels: Levels::new(context, depth)?,
            groups: Groups::new(context, shape)?,
            marks: storage("bits of clusters", bytes::<Marks>(room.candidate_groups))?,
            cluster_sums: storage(
                "counts of bits",
                bytes::<u32>(Bits::Clusters.sums(room.candidate_groups)),
            )?,
            numbers: storage("visible clusters", 2 * bytes::<u32>(room.visible))?,
            draws: context.buffer("draws", 2 * PART_BYTES, DISPATCH)?,
            counters: storage("counters", bytes::<Counters>(1))?,
            indirect: context.buffer("dispatches", bytes::<Dispatch>(IndirectEntry::COUNT), DISPATCH)?,
        })
    }

    /// How many clusters of each list are drawn in compute.
    pub(super) fn draws(&self) -> BoundBuffer<'_> {
        part::<Dispatch>(&self.draws, 0, List::COUNT)
    }

    /// The same for the device's rasterizer.
    pub(super) fn draw_args(&self) -> BoundBuffer<'_> {
        part::<DrawArgs>(&self.draws, 1, List::COUNT)
    }

    /// Lists start empty; but for those of groups where it is to start from them.
    fn clear(&self, encoder: &mut CommandEncoder, listed: bool) {
        let groups = (!listed).then_some(&self.groups.dispatches);
        let own = [&self.draws, &self.indirect, &self.counters];
        let all = self.levels.0.iter().chain(own).chain(groups);
        all.for_each(|buffer| encoder.clear_buffer(buffer, 0, None));
    }

    /// What comes back of it, in the order in which [`Buffers::split`] hands it out; `starts` entries of its list.
    fn parts(&self, starts: u32, shape: Shape) -> Vec<Part<'_>> {
        let level = |buffer| Part { buffer, bytes: Levels::bytes(shape.depth) };
        let groups = if shape.groups_come_back { shape.room.candidate_groups } else { 0 };
        vec![
            Part { buffer: &self.groups.candidate_groups, bytes: bytes::<CandidateGroup>(groups) },
            Part { buffer: &self.counters, bytes: bytes::<Counters>(1) },
            // Of both dispatches the first, which has the number of groups.
            Part { buffer: &self.groups.dispatches, bytes: bytes::<Dispatch>(1) },
            Part { buffer: &self.draws, bytes: bytes::<Dispatch>(List::COUNT) },
            Part { buffer: &self.starts, bytes: bytes::<TraversalItem>(starts) },
            level(&self.levels.0[0]),
            level(&self.levels.0[1]),
        ]
    }
}

/// Everything that a frame writes on the device, and what is uploaded for it.
#[derive(Debug)]
pub(super) struct Buffers {
    pub(super) shape: Shape,
    pub(super) bind_groups: BindGroups,
    pub(super) view: Buffer,
    /// Traversal items of a level and of the next, ping-pong.
    pub(super) items: [Buffer; 2],
    /// The second is there with occlusion; without, nothing is deferred.
    pub(super) cull_passes: Vec<PassBuffers>,
    /// Whether the groups of the first pass are those of the frame before, with what was drawn of them.
    pub(super) listed: bool,
    /// The occluded queue of a pass that defers nothing: of the first where there is no second, and of the second.
    pub(super) unused_queue: [Buffer; 2],
    /// The words of the bits of all groups, for the first pass; for the second, a step of the first says it.
    pub(super) group_blocks: Buffer,
    /// The visible list: of the first pass, then of both.
    pub(super) visible: Buffer,
    /// Numbers in the list of both passes for those of the first.
    pub(super) renumbered: Buffer,
    /// The visibility buffer, which nobody else holds while it is drawn to.
    pub(super) words: Arc<Buffer>,
    /// Those of earlier frames, which may hold them still.
    held_words: Vec<Arc<Buffer>>,
    /// How much pages are missed, by entries of their tables.
    pub(super) wanted: Buffer,
    pub(super) outputs: Vec<(Output, Buffer)>,
    pub(super) times: Times,
    /// What comes back, and the bytes of it.
    pub(super) staging: Buffer,
    pub(super) staged: u64,
    /// Where arrays come back that wait.
    pub(super) array_staging: Option<Buffer>,
}

/// What comes back of a buffer: its bytes in `staging`.
struct Part<'a> {
    buffer: &'a Buffer,
    bytes: u64,
}

/// Bytes of `count` entries.
pub(super) fn bytes<T>(count: u32) -> u64 {
    u64::from(count) * size_of::<T>() as u64
}

/// Copies parts one behind the other, from a place on.
fn copy<'a>(
    encoder: &mut CommandEncoder,
    parts: impl Iterator<Item = Part<'a>>,
    staging: &Buffer,
    mut at: u64,
) {
    for part in parts {
        encoder.copy_buffer_to_buffer(part.buffer, 0, staging, at, part.bytes);
        at += part.bytes;
    }
}

/// The bytes of the next part.
fn take<'a>(staged: &mut &'a [u8], part: &Part<'_>) -> &'a [u8] {
    let (head, tail) = staged.split_at(part.bytes as usize);
    *staged = tail;
    head
}

/// An array, as it comes back.
fn array((output, buffer): &(Output, Buffer), pixels: u64) -> Part<'_> {
    Part { buffer, bytes: array_bytes(*output, pixels) }
}

/// Bytes of an array of so many pixels, in whole words.
fn array_bytes(output: Output, pixels: u64) -> u64 {
    let word = size_of::<u32>() as u64;
    match output {
        // Four pixels are three words.
        _ if output.rgb() => pixels.div_ceil(4) * 3 * word,
        Output::Linear
        | Output::Normal
        | Output::BaseColor
        | Output::ShadingNormal
        | Output::Orm
        | Output::Emissive => pixels * 3 * word,
        _ => pixels * word,
    }
}

impl Buffers {
    /// For frames of a shape. Of those of another, lists stay where they would be the same.
    pub(super) fn new(context: &Context, shape: Shape, before: Option<Self>) -> Result<Self> {
        let Shape { instances, room, occlusion, .. } = shape;
        let storage = |what: &str, bytes: u64| context.buffer(what, bytes, STORAGE);
        let before = before.filter(|before| before.shape.lists() == shape.lists());
        let before = before.map(|before| (before.cull_passes, before.listed));
        let items = || storage("nodes to look at", bytes::<TraversalItem>(room.items));
        let uniform = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let (cull_passes, listed) = if let Some(before) = before {
            before
        } else {
            let starts = [instances, room.items];
            let cull_passes = starts.iter().take(1 + usize::from(occlusion));
            (
                cull_passes.map(|starts| PassBuffers::new(context, shape, *starts)).collect::<Result<_>>()?,
                false,
            )
        };
        let out = Self {
            shape,
            bind_groups: BindGroups::default(),
            view: context.buffer("view", bytes::<View>(1), uniform)?,
            items: [items()?, items()?],
            cull_passes,
            listed,
            unused_queue: [
                storage("nodes to look at", bytes::<TraversalItem>(1))?,
                storage("dispatches", bytes::<Dispatch>(1))?,
            ],
            group_blocks: context.buffer("dispatches", bytes::<Dispatch>(1), DISPATCH)?,
            visible: storage("visible clusters", bytes::<VisibleCluster>(room.visible))?,
            renumbered: storage("visible clusters", if occlusion { bytes::<u32>(room.visible) } else { 0 })?,
            words: Self::new_words(context, shape)?,
            held_words: Vec::new(),
            wanted: storage("pages that are missed", bytes::<u32>(shape.pages))?,
            outputs: Vec::new(),
            times: Times::new(context)?,
            staging: context.buffer("counters", 0, BufferUsages::MAP_READ)?,
            staged: 0,
            array_staging: None,
        };
        out.making(context, shape)
    }

    fn new_words(context: &Context, shape: Shape) -> Result<Arc<Buffer>> {
        context.buffer("the pixels of the picture", shape.word_bytes(), STORAGE).map(Arc::new)
    }

    /// The same where something else comes back.
    pub(super) fn making(mut self, context: &Context, shape: Shape) -> Result<Self> {
        let Shape { outputs, pixels, .. } = shape;
        self.shape = shape;
        self.bind_groups.clear();
        // Others go before new ones are made.
        (self.outputs, self.staging) = (Vec::new(), context.buffer("counters", 0, BufferUsages::MAP_READ)?);
        for output in outputs.iter() {
            let bytes = array_bytes(output, pixels);
            self.outputs.push((output, context.buffer("an array of the picture", bytes, STORAGE)?));
        }
        self.staged = self.parts().iter().flatten().map(|part| part.bytes).sum();
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        self.staging = context.buffer("what is read back", self.staged, usage)?;
        self.array_staging = match shape.waits {
            true => Some(context.buffer("what is read back", self.array_bytes(), usage)?),
            false => None,
        };
        Ok(self)
    }

    /// Sees to it that no frame holds what is drawn to.
    pub(super) fn release_words(&mut self, context: &Context) -> Result<()> {
        if Arc::strong_count(&self.words) > 1 {
            let free = self.held_words.iter().position(|words| Arc::strong_count(words) == 1);
            let free = match free {
                Some(place) => self.held_words.swap_remove(place),
                None => Self::new_words(context, self.shape)?,
            };
            self.held_words.push(std::mem::replace(&mut self.words, free));
        }
        Ok(())
    }

    /// Frames that are there and whose visibility buffers were left here.
    pub(super) fn frames_on_device(&self) -> usize {
        let held = |words: &&Arc<Buffer>| Arc::strong_count(words) > 1;
        self.held_words.iter().chain([&self.words]).filter(held).count()
    }

    /// What comes back: of the frame, then of each pass.
    fn parts<'a>(&'a self) -> Vec<Vec<Part<'a>>> {
        let Shape { instances, pixels, room, depth_only, .. } = self.shape;
        let ticks = Part { buffer: self.times.ticks(), bytes: Times::BYTES };
        let visible = Part { buffer: &self.visible, bytes: bytes::<VisibleCluster>(room.visible) };
        let waits = |output: &Output| self.shape.waits && *output != Output::Overdraw;
        let mut arrays =
            self.outputs.iter().filter(|(output, _)| !waits(output)).map(|own| array(own, pixels));
        // Depth that is made here comes in place of the keys it is made of.
        let made_depth = if depth_only { arrays.next() } else { None };
        let word_bytes = if self.shape.stays_on_device { 0 } else { self.shape.word_bytes() };
        let words = made_depth.unwrap_or(Part { buffer: &self.words, bytes: word_bytes });
        let wanted = Part { buffer: &self.wanted, bytes: bytes::<u32>(self.shape.pages) };
        let mut whole = vec![ticks, words, visible, wanted];
        whole.extend(arrays);
        let mut parts = vec![whole];
        let starts = [instances, room.items];
        parts.extend(
            self.cull_passes
                .iter()
                .zip(starts)
                .map(|(cull_pass, starts)| cull_pass.parts(starts, self.shape)),
        );
        parts
    }

    /// What comes back later: ticks, and arrays that wait.
    fn array_parts(&self) -> impl Iterator<Item = Part<'_>> {
        let ticks = Part { buffer: self.times.ticks(), bytes: Times::BYTES };
        let made = self.outputs.iter().filter(|(output, _)| *output != Output::Overdraw);
        [ticks].into_iter().chain(made.map(|own| array(own, self.shape.pixels)))
    }

    /// Copies it.
    pub(super) fn copy_arrays(&self, encoder: &mut CommandEncoder) {
        self.array_staging.iter().for_each(|staging| copy(encoder, self.array_parts(), staging, 0));
    }

    /// Bytes of it.
    pub(super) fn array_bytes(&self) -> u64 {
        self.array_parts().map(|part| part.bytes).sum()
    }

    /// The parts of it: ticks, then each array.
    pub(super) fn split_arrays<'a>(&self, mut staged: &'a [u8]) -> Vec<&'a [u8]> {
        self.array_parts().map(|part| take(&mut staged, &part)).collect()
    }

    /// Takes in that a frame was drawn: the next can start from its groups, where the second pass listed them.
    pub(super) fn keep_list(&mut self, both: bool) {
        self.bind_groups.next_frame();
        self.listed = false;
        if let [first, second] = &mut self.cull_passes[..]
            && both
        {
            std::mem::swap(&mut first.groups, &mut second.groups);
            self.listed = true;
        }
    }

    /// Lists start empty, words at zero; but for the list that the first pass starts from, if it does.
    pub(super) fn clear(&self, encoder: &mut CommandEncoder, listed: bool) {
        for (cull_pass, listed) in self.cull_passes.iter().zip([listed, false]) {
            cull_pass.clear(encoder, listed);
        }
        encoder.clear_buffer(&self.words, 0, None);
        encoder.clear_buffer(&self.wanted, 0, None);
        let counted = self.outputs.iter().find(|(output, _)| *output == Output::Overdraw);
        counted.iter().for_each(|(_, counts)| encoder.clear_buffer(counts, 0, None));
    }

    /// Lists of the first pass start empty.
    pub(super) fn clear_lists(&self, encoder: &mut CommandEncoder) {
        self.cull_passes.iter().take(1).for_each(|cull_pass| cull_pass.clear(encoder, false));
    }

    /// What tells the lengths of the lists of the first pass.
    fn length_parts(&self) -> Vec<Part<'_>> {
        self.cull_passes.iter().take(1).flat_map(|cull_pass| cull_pass.parts(0, self.shape)).collect()
    }

    /// Bytes of that.
    pub(super) fn length_bytes(&self) -> u64 {
        self.length_parts().iter().map(|part| part.bytes).sum()
    }

    /// Copies it.
    pub(super) fn copy_lengths(&self, encoder: &mut CommandEncoder, staging: &Buffer, at: u64) {
        copy(encoder, self.length_parts().into_iter(), staging, at);
    }

    /// Reads it.
    pub(super) fn lengths(&self, mut staged: &[u8]) -> Room {
        let parts: Vec<&[u8]> = self.length_parts().iter().map(|part| take(&mut staged, part)).collect();
        let [_, counters, groups, _, _, even, odd] = &parts[..] else { return Room::default() };
        // The first list is that of the instances, which has room for all.
        let levels = Levels::read(even, odd, self.shape.depth);
        Room {
            items: levels.iter().skip(1).map(|level| level.count).max().unwrap_or(0),
            candidate_groups: bytemuck::pod_read_unaligned::<Dispatch>(groups).count,
            visible: bytemuck::pod_read_unaligned::<Counters>(counters).visible,
        }
    }

    /// What `group_blocks` holds.
    pub(super) fn group_dispatch(&self) -> Dispatch {
        Bits::Groups.dispatch(self.shape.group_words)
    }

    pub(super) fn copy_back(&self, encoder: &mut CommandEncoder) {
        copy(encoder, self.parts().into_iter().flatten(), &self.staging, 0);
    }

    /// The parts of what came back: of the frame, then of each pass.
    pub(super) fn split<'a>(&self, mut staged: &'a [u8]) -> Vec<Vec<&'a [u8]>> {
        self.parts().iter().map(|parts| parts.iter().map(|part| take(&mut staged, part)).collect()).collect()
    }
}

/// A visibility buffer that stayed on the device, or the keys of depth alone.
#[derive(Debug)]
pub struct DeviceVisibility {
    context: Arc<Context>,
    words: Arc<Buffer>,
    bytes: u64,
}

impl DeviceVisibility {
    /// That of the frame drawn last.
    pub(super) fn new(context: &Arc<Context>, buffers: &Buffers) -> Self {
        let (context, words) = (Arc::clone(context), Arc::clone(&buffers.words));
        Self { context, words, bytes: buffers.shape.word_bytes() }
    }

    /// Reads it, a word or a key for each pixel.
    pub fn read<T: bytemuck::Pod>(&self) -> Result<Vec<T>> {
        let context = &self.context;
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let staging = context.buffer("the pixels of the picture", self.bytes, usage)?;
        let mut encoder = context.encoder("reading the visibility buffer");
        encoder.copy_buffer_to_buffer(&self.words, 0, &staging, 0, self.bytes);
        let mut words = Vec::new();
        context
            .submit(encoder, &staging, self.bytes, |staged| words = bytemuck::pod_collect_to_vec(staged))?;
        Ok(words)
    }
}
