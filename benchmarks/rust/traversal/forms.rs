//! Three ways from the instances of a scene to its list of visible clusters, on one device and by one clock: the
//! product's, with a dispatch per level of the hierarchies; a work queue in one dispatch; and flat parts, without any
//! hierarchy. What a form has of its own is here and in the shaders beside; all else are kernels of the product.

use std::sync::Arc;
use std::time::Instant;

use nanite_rs::gpu::Context;
use nanite_rs::gpu::kernels::{Bits, List, group_bit_words};
use nanite_rs::gpu::meshes::Meshes;
use nanite_rs::gpu::wgpu::{
    self, Buffer, BufferUsages, ComputePassDescriptor, ComputePassTimestampWrites, ComputePipeline,
    ComputePipelineDescriptor, QuerySet, QuerySetDescriptor, QueryType, ShaderModuleDescriptor, ShaderSource,
};
use nanite_rs::gpu_types::{
    CandidateGroup, Counters, Dispatch, DrawArgs, Group, Instance, InstanceTransform, Marks, TraversalItem,
    View, VisibleCluster,
};
use nanite_rs::model::Dag;
use nanite_rs::render::{instance_transform, view_record};
use nanite_rs::scene::placement::Eye;
use nanite_rs::scene::{Camera, Scene};
use nanite_rs::stream::Resident;
use nanite_rs::views::Screen;
use nanite_rs::{Error, Result};

#[path = "found.rs"]
mod found;
#[path = "record.rs"]
mod record;

use found::Answer;
pub use found::Found;

use super::kernels::{OWN, Own, Ring, Sizes};
use super::parts::parts;

/// Ways to traverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// The product's: a dispatch per level of the hierarchies.
    Levels,
    /// Persistent workgroups over a bounded ring.
    Queue,
    /// Every eight clusters of every instance on the screen.
    Parts,
}

/// All of them, in the order of a round.
pub const FORMS: [Form; 3] = [Form::Levels, Form::Queue, Form::Parts];

impl Form {
    /// For tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Levels => "levels",
            Self::Queue => "queue",
            Self::Parts => "parts",
        }
    }
}

/// The steps of a form between two timestamps each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IndirectEntry {
    /// `instance_cull`, the same in all.
    Instances,
    /// What tells forms apart.
    Walk,
    /// Bits → candidates: groups, or parts.
    List,
    /// Candidates → visible clusters.
    Clusters,
}

/// In the order in which they run.
pub const INDIRECT_ENTRIES: [IndirectEntry; 4] =
    [IndirectEntry::Instances, IndirectEntry::Walk, IndirectEntry::List, IndirectEntry::Clusters];

/// What every slot of a scene holds.
pub type Slots = Vec<Option<(InstanceTransform, Arc<Dag>)>>;

/// The slots of a scene.
pub fn slots(scene: &Scene) -> Slots {
    let all = scene.instances();
    let of = |slot| all.at(slot).map(|instance| (instance_transform(instance), Arc::clone(&instance.mesh)));
    (0..all.capacity()).map(of).collect()
}

/// The record of a view.
pub fn view(camera: &Camera, pose: &[[f64; 4]; 4], picture: (u32, u32), tau: f32) -> Result<View> {
    let view = camera.view(pose, picture.0, picture.1)?;
    Ok(view_record(&Screen::new(&view), &Eye::new(&view), tau))
}

const STORAGE: BufferUsages =
    BufferUsages::STORAGE.union(BufferUsages::COPY_DST).union(BufferUsages::COPY_SRC);
const DISPATCH: BufferUsages = STORAGE.union(BufferUsages::INDIRECT);

fn bytes<T>(count: u32) -> u64 {
    u64::from(count) * size_of::<T>() as u64
}

/// The instances of a scene with what their numbers of groups, or of parts, lead to.
#[derive(Debug)]
struct Arranged {
    instance_transform: Buffer,
    seen: Buffer,
    /// Words of bits, as a dispatch over blocks of them.
    words: u32,
    blocks: Buffer,
    bits: Buffer,
    sums: Buffer,
}

impl Arranged {
    /// By groups, or by the parts of a catalog.
    fn new(context: &Context, meshes: &Meshes, slots: &Slots, catalog: Option<&Catalog>) -> Result<Self> {
        let storage = |what: &str, bytes: u64| context.buffer(what, bytes, STORAGE);
        let mut words = 0;
        let mut records = Vec::with_capacity(slots.len());
        for slot in slots {
            let mut record = InstanceTransform { group_words: words, ..bytemuck::Zeroable::zeroed() };
            if let Some((instance_transform, mesh)) = slot
                && let Some(place) = meshes.placement(mesh)
            {
                let (first_node, first_group, count) = match catalog.and_then(|catalog| catalog.of(mesh)) {
                    None => (place.first_node, place.first_group, mesh.groups.len() as u32),
                    Some(known) => (known.count, known.first, known.count),
                };
                let first_page = place.first_page;
                let here = InstanceTransform { first_node, first_group, first_page, ..*instance_transform };
                record = InstanceTransform { group_words: words, ..here };
                words += count.div_ceil(u32::BITS);
            }
            records.push(record);
        }
        let instances = records.len() as u32;
        let instance_transform = storage("instances", bytes::<InstanceTransform>(instances))?;
        context.queue().write_buffer(&instance_transform, 0, bytemuck::cast_slice(&records));
        let blocks = context.buffer("dispatches", bytes::<Dispatch>(1), DISPATCH)?;
        let record = Bits::Groups.dispatch(words);
        context.queue().write_buffer(&blocks, 0, bytemuck::bytes_of(&record));
        Ok(Self {
            instance_transform,
            seen: storage("instances", bytes::<Instance>(instances))?,
            words,
            blocks,
            bits: storage("bits", bytes::<u32>(group_bit_words(words)))?,
            sums: storage("counts of bits", bytes::<u32>(Bits::Groups.sums(words)))?,
        })
    }
}

/// A mesh, and where its parts lie.
#[derive(Debug)]
struct Known {
    mesh: Arc<Dag>,
    first: u32,
    count: u32,
}

/// The parts of all meshes.
#[derive(Debug)]
struct Catalog {
    known: Vec<Known>,
    parts: Vec<Group>,
    /// Of each page: the first group of its mesh.
    bases: Vec<u32>,
    sizes: Sizes,
}

impl Catalog {
    fn new(meshes: &Meshes, slots: &Slots) -> Self {
        let sizes = Sizes { instances: slots.len() as u32, nodes: 0, depth: 0, parts: 0 };
        let mut out = Self { known: Vec::new(), parts: Vec::new(), bases: Vec::new(), sizes };
        for (_, mesh) in slots.iter().flatten() {
            let Some(place) = meshes.placement(mesh).filter(|_| out.of(mesh).is_none()) else { continue };
            let parts = parts(mesh);
            let (first, count) = (out.parts.len() as u32, parts.len() as u32);
            out.sizes.nodes = out.sizes.nodes.max(mesh.nodes.len() as u32);
            out.sizes.depth = out.sizes.depth.max(place.depth);
            out.sizes.parts = out.sizes.parts.max(count);
            out.known.push(Known { mesh: Arc::clone(mesh), first, count });
            out.parts.extend(parts);
            let first_page = place.first_page as usize;
            let end = first_page + mesh.pages.table.len();
            out.bases.resize(out.bases.len().max(end), 0);
            out.bases[first_page..end].fill(place.first_group);
        }
        out
    }

    fn of(&self, mesh: &Arc<Dag>) -> Option<&Known> {
        self.known.iter().find(|known| Arc::ptr_eq(&known.mesh, mesh))
    }
}

/// Lists whose lengths only the device knows, made anew where they were too short.
#[derive(Debug)]
struct Lists {
    items: [Buffer; 2],
    candidates: Buffer,
    drawn: Buffer,
    marks: Buffer,
    sums: Buffer,
    visible: Buffer,
    numbers: Buffer,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Room {
    items: u32,
    candidates: u32,
    visible: u32,
}

/// A scene on the device, ready for every form.
#[derive(Debug)]
pub struct Forms {
    context: Arc<Context>,
    meshes: Meshes,
    sizes: Sizes,
    ring: Ring,
    own: Vec<ComputePipeline>,
    groups: Arranged,
    parts: Arranged,
    part_records: Buffer,
    group_bases: Buffer,
    /// Where pages would be asked for; all are there.
    wanted: Buffer,
    /// Bytes that parts take besides the mesh, and those of the table that leads from a cluster to its group.
    part_bytes: u64,
    /// Of each instance.
    part_counts: Vec<u32>,
    instances: u32,
    view: Buffer,
    starts: Buffer,
    /// One dispatch per level; the first counts the instances on the screen.
    levels: Vec<Buffer>,
    unused_queue: [Buffer; 2],
    queue: Buffer,
    slots: Buffer,
    looking: Buffer,
    culling: Buffer,
    counting: Buffer,
    draws: Buffer,
    draw_args: Buffer,
    counters: Buffer,
    room: Room,
    lists: Lists,
    times: Option<(QuerySet, Buffer)>,
}

impl Forms {
    /// Uploads what every slot of a scene holds; an empty slot is a record of zeros.
    pub fn new(slots: &Slots, ring: Ring) -> Result<Self> {
        let context = Context::shared()?;
        let mut meshes = Meshes::default();
        meshes.upload(&context, slots.iter().flatten().map(|(_, mesh)| mesh), &Resident::default())?;
        let storage = |what: &str, bytes: u64| context.buffer(what, bytes, STORAGE);
        let dispatch = |count: u32| context.buffer("dispatches", bytes::<Dispatch>(count), DISPATCH);

        let catalog = Catalog::new(&meshes, slots);
        let (sizes, all_parts, bases) = (catalog.sizes, &catalog.parts, &catalog.bases);
        let part_bytes = (all_parts.len() * size_of::<Group>() + bases.len() * size_of::<u32>()) as u64;
        let part_records = storage("parts", bytes::<Group>(all_parts.len() as u32))?;
        context.queue().write_buffer(&part_records, 0, bytemuck::cast_slice(all_parts));
        let group_bases = storage("pages", bytes::<u32>(bases.len() as u32))?;
        context.queue().write_buffer(&group_bases, 0, bytemuck::cast_slice(bases));
        let count = |slot: &Option<(InstanceTransform, Arc<Dag>)>| Some(catalog.of(&slot.as_ref()?.1)?.count);

        let own = OWN.map(|kernel| compile(&context, kernel, sizes, ring, meshes.split()));
        let own = own.into_iter().collect::<Result<Vec<_>>>()?;
        let room = Room { items: 1 << 12, candidates: 1 << 12, visible: 1 << 14 };
        let times = context.tick().map(|_| {
            let count = 2 * INDIRECT_ENTRIES.len() as u32;
            let descriptor = QuerySetDescriptor { label: None, ty: QueryType::Timestamp, count };
            let usage = BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC;
            let ticks = context.buffer("times", bytes::<u64>(count), usage)?;
            Ok((context.device().create_query_set(&descriptor), ticks))
        });
        Ok(Self {
            groups: Arranged::new(&context, &meshes, slots, None)?,
            parts: Arranged::new(&context, &meshes, slots, Some(&catalog))?,
            part_records,
            group_bases,
            wanted: storage("pages", bytes::<u32>(1))?,
            part_bytes,
            part_counts: slots.iter().map(|slot| count(slot).unwrap_or(0)).collect(),
            instances: sizes.instances,
            view: context.buffer("view", bytes::<View>(1), BufferUsages::UNIFORM | BufferUsages::COPY_DST)?,
            starts: storage("instances on the screen", bytes::<TraversalItem>(sizes.instances))?,
            levels: (0..=sizes.depth).map(|_| dispatch(1)).collect::<Result<_>>()?,
            unused_queue: [storage("unused_queue", 16)?, storage("unused_queue", bytes::<Dispatch>(1))?],
            queue: storage("the queue", bytes::<u32>(8))?,
            slots: storage("the ring", bytes::<u32>(ring.slots))?,
            looking: dispatch(1)?,
            culling: dispatch(1)?,
            counting: dispatch(1)?,
            draws: dispatch(List::COUNT)?,
            draw_args: storage("draws", bytes::<DrawArgs>(List::COUNT))?,
            counters: storage("counters", bytes::<Counters>(1))?,
            room,
            lists: Lists::new(&context, room)?,
            times: times.transpose()?,
            own,
            sizes,
            ring,
            meshes,
            context,
        })
    }

    /// Traverses once, and again where a list was too short.
    pub fn run(&mut self, form: Form, view: &View) -> Result<Found> {
        loop {
            let (found, wanted) = self.submit(form, view)?;
            let grow = |room: u32, wanted: u32| if wanted > room { wanted.next_power_of_two() } else { room };
            let room = Room {
                items: grow(self.room.items, wanted.items),
                candidates: grow(self.room.candidates, wanted.candidates),
                visible: grow(self.room.visible, wanted.visible),
            };
            if room == self.room {
                return Ok(found);
            }
            self.lists = Lists::new(&self.context, room)?;
            self.room = room;
        }
    }

    fn submit(&self, form: Form, view: &View) -> Result<(Found, Room)> {
        let context = &*self.context;
        let arranged = self.arranged(form);
        let view = View { instances: self.instances, group_words: arranged.words, history: 0, ..*view };
        context.queue().write_buffer(&self.view, 0, bytemuck::bytes_of(&view));
        let mut encoder = context.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let always =
            [&arranged.bits, &self.culling, &self.counting, &self.draws, &self.draw_args, &self.counters];
        let of_queue: &[&Buffer] = if form == Form::Queue { &[&self.queue, &self.slots] } else { &[] };
        for buffer in always.into_iter().chain(of_queue.iter().copied()).chain(&self.levels) {
            encoder.clear_buffer(buffer, 0, None);
        }
        for (number, step) in (0..).zip(INDIRECT_ENTRIES) {
            let timestamp_writes = self.times.as_ref().map(|(query_set, _)| ComputePassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: Some(2 * number),
                end_of_pass_write_index: Some(2 * number + 1),
            });
            let descriptor = ComputePassDescriptor { label: None, timestamp_writes };
            let mut pass = encoder.begin_compute_pass(&descriptor);
            match step {
                IndirectEntry::Instances => self.instance_cull(&mut pass, arranged),
                IndirectEntry::Walk => match form {
                    Form::Levels => self.walk_levels(&mut pass),
                    Form::Queue => self.walk_queue(&mut pass),
                    Form::Parts => self.look_at_parts(&mut pass),
                },
                IndirectEntry::List => self.list(&mut pass, form),
                IndirectEntry::Clusters => self.cull_clusters(&mut pass, form),
            }
        }
        if let Some((set, ticks)) = &self.times {
            encoder.resolve_query_set(set, 0..2 * INDIRECT_ENTRIES.len() as u32, ticks, 0);
        }
        // What comes back, the same for all forms.
        let mut parts: Vec<(&Buffer, u64)> = vec![
            (&self.queue, bytes::<u32>(8)),
            (&self.counters, bytes::<Counters>(1)),
            (&self.culling, bytes::<Dispatch>(1)),
            (&arranged.bits, bytes::<u32>(arranged.words)),
            (&self.lists.visible, bytes::<VisibleCluster>(self.room.visible)),
            (&self.starts, bytes::<TraversalItem>(self.instances)),
        ];
        parts.extend(self.levels.iter().map(|level| (level, bytes::<Dispatch>(1))));
        parts.extend(self.times.iter().map(|(_, ticks)| (ticks, ticks.size())));
        let total = parts.iter().map(|(_, bytes)| bytes).sum();
        let staging = context.buffer("staging", total, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
        let mut ends = vec![0];
        for (buffer, bytes) in &parts {
            let at = ends[ends.len() - 1];
            encoder.copy_buffer_to_buffer(buffer, 0, &staging, at, *bytes);
            ends.push(at + bytes);
        }
        let start = Instant::now();
        let mut back = None;
        context.submit(encoder, &staging, total, |staged| {
            let wall = start.elapsed().as_secs_f64() * 1e3;
            let part = |first: usize, end: usize| &staged[ends[first] as usize..ends[end] as usize];
            let timed = 6 + self.levels.len();
            let answer = Answer {
                queue: part(0, 1),
                counters: part(1, 2),
                culling: part(2, 3),
                bits: part(3, 4),
                visible: part(4, 5),
                starts: part(5, 6),
                levels: part(6, timed),
                ticks: part(timed, parts.len()),
            };
            back = Some(self.report(form, &answer, wall));
        })?;
        back.ok_or_else(|| Error::Invariant("the device answered nothing".to_owned()))
    }

    fn arranged(&self, form: Form) -> &Arranged {
        if form == Form::Parts { &self.parts } else { &self.groups }
    }
}

impl Lists {
    fn new(context: &Context, room: Room) -> Result<Self> {
        let storage = |what: &str, bytes: u64| context.buffer(what, bytes, STORAGE);
        let Room { items, candidates, visible } = room;
        Ok(Self {
            items: [
                storage("nodes to look at", bytes::<TraversalItem>(items))?,
                storage("nodes to look at", bytes::<TraversalItem>(items))?,
            ],
            candidates: storage("groups to look at", bytes::<CandidateGroup>(candidates))?,
            drawn: storage("bits of clusters", bytes::<u32>(candidates))?,
            marks: storage("bits of clusters", bytes::<Marks>(candidates))?,
            sums: storage("counts of bits", bytes::<u32>(Bits::Clusters.sums(candidates)))?,
            visible: storage("visible clusters", bytes::<VisibleCluster>(visible))?,
            numbers: storage("visible clusters", 2 * bytes::<u32>(visible))?,
        })
    }
}

fn compile(context: &Context, kernel: Own, sizes: Sizes, ring: Ring, split: bool) -> Result<ComputePipeline> {
    let source = sizes.source(kernel, ring, split.then(|| context.array_bits())).ok_or_else(|| {
        Error::TooLarge("an item of the queue, an instance and a node, does not fit a word".to_owned())
    })?;
    let label = Some(kernel.name());
    let source = ShaderSource::Wgsl(source.into());
    let module = context.device().create_shader_module(ShaderModuleDescriptor { label, source });
    Ok(context.device().create_compute_pipeline(&ComputePipelineDescriptor {
        label,
        layout: None,
        module: &module,
        entry_point: Some("main"),
        compilation_options: wgpu::PipelineCompilationOptions {
            zero_initialize_workgroup_memory: false,
            ..wgpu::PipelineCompilationOptions::default()
        },
        cache: None,
    }))
}
