//! Three ways from the instances of a scene to its list of visible clusters, on one device and by one clock: the
//! product's, with a dispatch per level of the hierarchies; a work queue in one dispatch; and flat parts, without any
//! hierarchy. What a form has of its own is here and in the shaders beside; all else are kernels of the product.

use std::sync::Arc;
use std::time::Instant;

use nanite_rs::cpu::project::Screen;
use nanite_rs::gpu::meshes::Meshes;
use nanite_rs::gpu::shaders::{Kernel, MAX_WORKGROUPS, SCAN_BLOCK, WIDTH};
use nanite_rs::gpu::wgpu::{
    self, BindGroupDescriptor, BindGroupEntry, Buffer, BufferUsages, ComputePass, ComputePassDescriptor,
    ComputePassTimestampWrites, ComputePipeline, ComputePipelineDescriptor, QuerySet, QuerySetDescriptor,
    QueryType, ShaderModuleDescriptor, ShaderSource,
};
use nanite_rs::gpu::{Context, Phase};
use nanite_rs::gpu_types::{
    Candidate, Counters, Dispatch, Instance, Marks, Placed, View, VisibleCluster, Visit,
};
use nanite_rs::math::Sphere;
use nanite_rs::model::{ClusterRecord, Dag, Group, Node};
use nanite_rs::render::{placed, view_record};
use nanite_rs::scene::placement::Eye;
use nanite_rs::scene::{Camera, Scene};
use nanite_rs::{Error, Result};

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
pub enum Step {
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
pub const STEPS: [Step; 4] = [Step::Instances, Step::Walk, Step::List, Step::Clusters];

/// What one run of a form found and took.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Milliseconds of each of [`STEPS`] by the device's clock; NaN without one.
    pub ms: [f64; 4],
    /// Milliseconds from the submission to the answer, clearing of buffers included.
    pub wall: f64,
    /// Bits of groups, or of parts.
    pub bits: Vec<u32>,
    /// The visible list, in scene order.
    pub visible: Vec<VisibleCluster>,
    /// Nodes looked at, or parts.
    pub nodes: u64,
    /// Groups looked at.
    pub groups: u64,
    /// Groups or parts whose clusters were looked at.
    pub candidates: u64,
    /// Clusters looked at.
    pub clusters: u64,
    /// Of the queue: nodes that lanes walked themselves.
    pub walked: u64,
    /// Of the queue: claims that came to nothing.
    pub idle: u64,
    /// Bytes of what was looked at, each read counted once.
    pub read: u64,
    /// Bytes that the form keeps on the device besides what all need, for this frame's lists.
    pub memory: u64,
}

/// What every slot of a scene holds.
pub type Slots = Vec<Option<(Placed, Arc<Dag>)>>;

/// The slots of a scene.
pub fn slots(scene: &Scene) -> Slots {
    let all = scene.instances();
    let of = |slot| all.at(slot).map(|instance| (placed(instance), Arc::clone(&instance.mesh)));
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
    placed: Buffer,
    seen: Buffer,
    /// Words of bits, as a dispatch over blocks of them.
    words: u32,
    blocks: Buffer,
    bits: Buffer,
    sums: Buffer,
}

/// Lists whose lengths only the device knows, made anew where they were too short.
#[derive(Debug)]
struct Lists {
    visits: [Buffer; 2],
    candidates: Buffer,
    drawn: Buffer,
    marks: Buffer,
    sums: Buffer,
    visible: Buffer,
    numbers: Buffer,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Room {
    visits: u32,
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
    /// Bytes that parts take besides the mesh, and those of the table that leads from a cluster to its group.
    part_bytes: u64,
    /// Of each instance.
    part_counts: Vec<u32>,
    instances: u32,
    view: Buffer,
    starts: Buffer,
    /// One dispatch per level; the first counts the instances on the screen.
    levels: Vec<Buffer>,
    nowhere: [Buffer; 2],
    queue: Buffer,
    slots: Buffer,
    looking: Buffer,
    culling: Buffer,
    counting: Buffer,
    draws: Buffer,
    counters: Buffer,
    room: Room,
    lists: Lists,
    times: Option<(QuerySet, Buffer)>,
}

impl Forms {
    /// Uploads what every slot of a scene holds; an empty slot is a record of zeros.
    pub fn new(slots: &[Option<(Placed, Arc<Dag>)>], ring: Ring) -> Result<Self> {
        let context = Context::shared()?;
        let mut meshes = Meshes::default();
        meshes.upload(&context, slots.iter().flatten().map(|(_, mesh)| mesh))?;
        let storage = |what: &str, bytes: u64| context.buffer(what, bytes, STORAGE);
        let dispatch = |count: u32| context.buffer("dispatches", bytes::<Dispatch>(count), DISPATCH);

        // Parts of each mesh once, and the first group of the mesh that each page is of.
        let (mut all_parts, mut bases) = (Vec::<Group>::new(), Vec::<u32>::new());
        let mut known: Vec<(Arc<Dag>, u32, u32)> = Vec::new();
        let mut sizes = Sizes { instances: slots.len() as u32, nodes: 0, depth: 0, parts: 0 };
        for (_, mesh) in slots.iter().flatten() {
            if known.iter().any(|(other, ..)| Arc::ptr_eq(other, mesh)) {
                continue;
            }
            let Some(place) = meshes.placement(mesh) else { continue };
            let parts = parts(mesh);
            sizes.nodes = sizes.nodes.max(mesh.nodes.len() as u32);
            sizes.depth = sizes.depth.max(place.depth);
            sizes.parts = sizes.parts.max(parts.len() as u32);
            known.push((Arc::clone(mesh), all_parts.len() as u32, parts.len() as u32));
            all_parts.extend(parts);
            let end = place.first_page as usize + mesh.pages.table.len();
            bases.resize(bases.len().max(end), 0);
            bases[place.first_page as usize..end].fill(place.first_group);
        }
        let parts_of = |mesh: &Arc<Dag>| known.iter().find(|(other, ..)| Arc::ptr_eq(other, mesh));
        let count = |slot: &Option<(Placed, Arc<Dag>)>| Some(parts_of(&slot.as_ref()?.1)?.2);
        let part_counts = slots.iter().map(|slot| count(slot).unwrap_or(0)).collect();
        let arrange = |of_parts: bool| -> Result<Arranged> {
            let mut words = 0;
            let mut records = Vec::with_capacity(slots.len());
            for slot in slots {
                let mut record = Placed { group_words: words, ..bytemuck::Zeroable::zeroed() };
                if let Some((placed, mesh)) = slot
                    && let Some(place) = meshes.placement(mesh)
                    && let Some((_, first_part, parts)) = parts_of(mesh)
                {
                    let (first_node, first_group, count) = match of_parts {
                        false => (place.first_node, place.first_group, mesh.groups.len() as u32),
                        true => (*parts, *first_part, *parts),
                    };
                    let (first_page, vertex_words) = (place.first_page, place.vertex_words);
                    let here = Placed { first_node, first_group, first_page, vertex_words, ..*placed };
                    record = Placed { group_words: words, ..here };
                    words += count.div_ceil(u32::BITS);
                }
                records.push(record);
            }
            let placed = storage("instances", bytes::<Placed>(sizes.instances))?;
            context.queue().write_buffer(&placed, 0, bytemuck::cast_slice(&records));
            let blocks = dispatch(1)?;
            let workgroups = words.div_ceil(SCAN_BLOCK);
            let (x, y) = (workgroups.min(MAX_WORKGROUPS), workgroups.div_ceil(MAX_WORKGROUPS));
            let record = Dispatch { x, y, z: 1, count: words, ..Dispatch::default() };
            context.queue().write_buffer(&blocks, 0, bytemuck::bytes_of(&record));
            Ok(Arranged {
                placed,
                seen: storage("instances", bytes::<Instance>(sizes.instances))?,
                words,
                blocks,
                bits: storage("bits", bytes::<u32>(words))?,
                sums: storage("counts of bits", bytes::<u32>(workgroups + 1))?,
            })
        };
        let part_bytes = (all_parts.len() * size_of::<Group>() + bases.len() * size_of::<u32>()) as u64;
        let part_records = storage("parts", bytes::<Group>(all_parts.len() as u32))?;
        context.queue().write_buffer(&part_records, 0, bytemuck::cast_slice(&all_parts));
        let group_bases = storage("pages", bytes::<u32>(bases.len() as u32))?;
        context.queue().write_buffer(&group_bases, 0, bytemuck::cast_slice(&bases));

        let own = OWN.map(|kernel| compile(&context, kernel, sizes, ring, meshes.split()));
        let own = own.into_iter().collect::<Result<Vec<_>>>()?;
        let room = Room { visits: 1 << 12, candidates: 1 << 12, visible: 1 << 14 };
        let times = context.tick().map(|_| {
            let count = 2 * STEPS.len() as u32;
            let descriptor = QuerySetDescriptor { label: None, ty: QueryType::Timestamp, count };
            let usage = BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC;
            let ticks = context.buffer("times", bytes::<u64>(count), usage)?;
            Ok((context.device().create_query_set(&descriptor), ticks))
        });
        Ok(Self {
            groups: arrange(false)?,
            parts: arrange(true)?,
            part_records,
            group_bases,
            part_bytes,
            part_counts,
            instances: sizes.instances,
            view: context.buffer("view", bytes::<View>(1), BufferUsages::UNIFORM | BufferUsages::COPY_DST)?,
            starts: storage("instances on the screen", bytes::<Visit>(sizes.instances))?,
            levels: (0..=sizes.depth).map(|_| dispatch(1)).collect::<Result<_>>()?,
            nowhere: [storage("nowhere", 16)?, storage("nowhere", bytes::<Dispatch>(1))?],
            queue: storage("the queue", bytes::<u32>(8))?,
            slots: storage("the ring", bytes::<u32>(ring.slots))?,
            looking: dispatch(1)?,
            culling: dispatch(1)?,
            counting: dispatch(1)?,
            draws: dispatch(2)?,
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
                visits: grow(self.room.visits, wanted.visits),
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
        let always = [&arranged.bits, &self.culling, &self.counting, &self.draws, &self.counters];
        let of_queue: &[&Buffer] = if form == Form::Queue { &[&self.queue, &self.slots] } else { &[] };
        for buffer in always.into_iter().chain(of_queue.iter().copied()).chain(&self.levels) {
            encoder.clear_buffer(buffer, 0, None);
        }
        for (number, step) in (0..).zip(STEPS) {
            let timestamp_writes = self.times.as_ref().map(|(query_set, _)| ComputePassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: Some(2 * number),
                end_of_pass_write_index: Some(2 * number + 1),
            });
            let descriptor = ComputePassDescriptor { label: None, timestamp_writes };
            let mut pass = encoder.begin_compute_pass(&descriptor);
            match step {
                Step::Instances => self.instance_cull(&mut pass, arranged),
                Step::Walk => match form {
                    Form::Levels => self.walk_levels(&mut pass),
                    Form::Queue => self.walk_queue(&mut pass),
                    Form::Parts => self.look_at_parts(&mut pass),
                },
                Step::List => self.list(&mut pass, form),
                Step::Clusters => self.cull_clusters(&mut pass, form),
            }
        }
        if let Some((set, ticks)) = &self.times {
            encoder.resolve_query_set(set, 0..2 * STEPS.len() as u32, ticks, 0);
        }
        // What comes back, the same for all forms.
        let mut parts: Vec<(&Buffer, u64)> = vec![
            (&self.queue, bytes::<u32>(8)),
            (&self.counters, bytes::<Counters>(1)),
            (&self.culling, bytes::<Dispatch>(1)),
            (&arranged.bits, bytes::<u32>(arranged.words)),
            (&self.lists.visible, bytes::<VisibleCluster>(self.room.visible)),
            (&self.starts, bytes::<Visit>(self.instances)),
        ];
        parts.extend(self.levels.iter().map(|level| (level, bytes::<Dispatch>(1))));
        parts.extend(self.times.iter().map(|(_, ticks)| (ticks, ticks.size())));
        let total = parts.iter().map(|(_, bytes)| bytes).sum();
        let staging = context.buffer("staging", total, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
        let mut at = 0;
        for (buffer, bytes) in &parts {
            encoder.copy_buffer_to_buffer(buffer, 0, &staging, at, *bytes);
            at += bytes;
        }
        let start = Instant::now();
        let mut back = Vec::new();
        context.submit(encoder, &staging, total, |mut rest| {
            for (_, bytes) in &parts {
                let (head, tail) = rest.split_at(*bytes as usize);
                back.push(head.to_vec());
                rest = tail;
            }
        })?;
        let wall = start.elapsed().as_secs_f64() * 1e3;
        Ok(self.report(form, &back, wall))
    }

    fn report(&self, form: Form, back: &[Vec<u8>], wall: f64) -> (Found, Room) {
        fn all<T: bytemuck::Pod>(bytes: &[u8]) -> Vec<T> {
            bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect()
        }
        let queue: Vec<u32> = all(&back[0]);
        let counters: Counters = bytemuck::pod_read_unaligned(&back[1]);
        let candidates = bytemuck::pod_read_unaligned::<Dispatch>(&back[2]).count;
        let mut visible: Vec<VisibleCluster> = all(&back[4]);
        visible.truncate(counters.visible as usize);
        let levels = &back[6..][..self.levels.len()];
        let levels: Vec<Dispatch> = levels.iter().map(|level| bytemuck::pod_read_unaligned(level)).collect();
        let of_levels =
            |of: fn(&Dispatch) -> u32| levels.iter().map(|level| u64::from(of(level))).sum::<u64>();
        let tick = self.context.tick().unwrap_or(f64::NAN);
        let ticks: Vec<u64> = back.get(6 + self.levels.len()).map(|ticks| all(ticks)).unwrap_or_default();
        let ms = |step: usize| {
            let ends = ticks.get(2 * step).zip(ticks.get(2 * step + 1));
            ends.map_or(f64::NAN, |(start, end)| end.saturating_sub(*start) as f64 * tick)
        };
        let clusters = u64::from(counters.visited_clusters);
        let (nodes, groups) = match form {
            Form::Levels => (of_levels(|level| level.count), of_levels(|level| level.visited)),
            Form::Queue => (queue[4].into(), queue[5].into()),
            Form::Parts => {
                let starts = all::<Visit>(&back[5]).into_iter().take(levels[0].count as usize);
                (starts.map(|start| u64::from(self.part_counts[start.instance as usize])).sum(), 0)
            }
        };
        let words = u64::from(self.arranged(form).words);
        // Structures that a lane reads: see docs/traversal.md.
        let of = |count: u64, bytes: usize| count * bytes as u64;
        let lists = of(candidates.into(), size_of::<Candidate>() + size_of::<u32>() + size_of::<Marks>());
        let record = size_of::<ClusterRecord>();
        let bits = 2 * 4 * words;
        let (node, item) = (size_of::<Node>(), size_of::<Visit>());
        let (read, memory) = match form {
            Form::Levels => {
                let widest = levels.iter().skip(1).map(|level| level.count).max().unwrap_or(0);
                let visits = 2 * u64::from(widest) * item as u64;
                (of(nodes, node + item) + of(groups, size_of::<Group>()) + of(clusters, record), visits)
            }
            Form::Queue => {
                let slots = bytes::<u32>(self.ring.slots);
                (of(nodes, node + size_of::<u32>()) + of(groups, size_of::<Group>()) + of(clusters, record), slots)
            }
            Form::Parts => {
                // Of its group, a cluster reads a sphere and an error.
                let parent = size_of::<Sphere>() + size_of::<f32>();
                let read = of(nodes, size_of::<Group>()) + of(clusters, record + parent);
                (read, self.part_bytes)
            }
        };
        let found = Found {
            ms: std::array::from_fn(ms),
            wall,
            bits: all(&back[3]),
            visible,
            nodes,
            groups,
            candidates: candidates.into(),
            clusters,
            walked: if form == Form::Queue { queue[6].into() } else { 0 },
            idle: if form == Form::Queue { queue[7].into() } else { 0 },
            read: read + bits + lists,
            memory: memory + 4 * words + lists,
        };
        let visits = levels.iter().skip(1).map(|level| level.count).max().unwrap_or(0);
        (found, Room { visits, candidates, visible: counters.visible })
    }

    fn arranged(&self, form: Form) -> &Arranged {
        if form == Form::Parts { &self.parts } else { &self.groups }
    }
    fn pipeline(&self, kernel: Use) -> &ComputePipeline {
        match kernel {
            Use::Product(kernel) => {
                self.context.pipeline(kernel, kernel.reads_pages() && self.meshes.split())
            }
            Use::Own(kernel) => &self.own[kernel as usize],
        }
    }

    fn prepare(&self, pass: &mut ComputePass<'_>, kernel: Use, buffers: &[&Buffer]) {
        let pipeline = self.pipeline(kernel);
        let entries: Vec<_> = buffers
            .iter()
            .zip(0..)
            .map(|(buffer, binding)| BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let layout = pipeline.get_bind_group_layout(0);
        let descriptor = BindGroupDescriptor { label: None, layout: &layout, entries: &entries };
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &self.context.device().create_bind_group(&descriptor), &[]);
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

    fn instance_cull(&self, pass: &mut ComputePass<'_>, of: &Arranged) {
        let [later, later_level] = &self.nowhere;
        // There is no earlier frame: any buffer does for its pyramid.
        let pyramid = &self.group_bases;
        let bindings =
            [&self.view, &of.placed, &of.seen, &self.starts, &self.levels[0], pyramid, later, later_level];
        let kernel = Use::Product(Kernel::InstanceCull);
        self.run_kernel(pass, kernel, &bindings, self.instances.div_ceil(WIDTH));
    }

    /// As `src/gpu/node_cull.rs`.
    fn walk_levels(&self, pass: &mut ComputePass<'_>) {
        let [later, later_level] = &self.nowhere;
        for level in 0..self.sizes.depth as usize {
            let from = if level == 0 { &self.starts } else { &self.lists.visits[level % 2] };
            let bindings = [
                &self.view,
                &self.groups.seen,
                self.meshes.nodes(),
                self.meshes.groups(),
                from,
                &self.levels[level],
                &self.lists.visits[(level + 1) % 2],
                &self.levels[level + 1],
                &self.groups.bits,
                &self.group_bases,
                later,
                later_level,
            ];
            let kernel = Use::Product(Kernel::NodeCull(Phase::First));
            self.run_as(pass, kernel, &bindings, &self.levels[level]);
        }
    }

    fn walk_queue(&self, pass: &mut ComputePass<'_>) {
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

    fn look_at_parts(&self, pass: &mut ComputePass<'_>) {
        self.run_kernel(pass, Use::Own(Own::PartDispatch), &[&self.levels[0], &self.looking], 1);
        let bindings =
            [&self.view, &self.parts.seen, &self.part_records, &self.starts, &self.looking, &self.parts.bits];
        self.run_as(pass, Use::Own(Own::PartCull), &bindings, &self.looking);
    }

    /// As `src/gpu/node_cull.rs`.
    fn list(&self, pass: &mut ComputePass<'_>, form: Form) {
        let of = self.arranged(form);
        let (kernel, records) = match form {
            Form::Parts => (Use::Own(Own::ListParts), &self.part_records),
            _ => (Use::Product(Kernel::ListGroups(Phase::First)), self.meshes.groups()),
        };
        let bindings = [&of.bits, &of.blocks, &of.sums, &of.bits];
        self.run_as(pass, Use::Product(Kernel::CountBits), &bindings, &of.blocks);
        self.run_kernel(pass, Use::Product(Kernel::ScanBlocks), &[&of.blocks, &of.sums], 1);
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
    fn cull_clusters(&self, pass: &mut ComputePass<'_>, form: Form) {
        let (of, lists) = (self.arranged(form), &self.lists);
        let [pages, pages_1, pages_2, pages_3] = self.meshes.pages();
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
            // No pyramid, and nothing of another phase.
            _ => (
                Use::Product(Kernel::ClusterCull(Phase::First)),
                vec![&self.nowhere[0], &lists.candidates, &lists.candidates, pages_1, pages_2, pages_3],
            ),
        };
        self.run_as(pass, kernel, &[&common[..], &more].concat(), &self.culling);
        let bindings = [&lists.drawn, &self.counting, &lists.sums, &lists.drawn];
        self.run_as(pass, Use::Product(Kernel::CountBits), &bindings, &self.counting);
        self.run_kernel(pass, Use::Product(Kernel::ScanBlocks), &[&self.counting, &lists.sums], 1);
        let bindings = [
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
            &self.nowhere[0],
        ];
        let kernel = Use::Product(Kernel::ListClusters(Phase::First));
        self.run_as(pass, kernel, &bindings, &self.counting);
    }
}

/// Whose kernel.
#[derive(Clone, Copy, Debug)]
enum Use {
    Product(Kernel),
    Own(Own),
}

impl Lists {
    fn new(context: &Context, room: Room) -> Result<Self> {
        let storage = |what: &str, bytes: u64| context.buffer(what, bytes, STORAGE);
        let Room { visits, candidates, visible } = room;
        Ok(Self {
            visits: [
                storage("nodes to look at", bytes::<Visit>(visits))?,
                storage("nodes to look at", bytes::<Visit>(visits))?,
            ],
            candidates: storage("groups to look at", bytes::<Candidate>(candidates))?,
            drawn: storage("bits of clusters", bytes::<u32>(candidates))?,
            marks: storage("bits of clusters", bytes::<Marks>(candidates))?,
            sums: storage("counts of bits", bytes::<u32>(candidates.div_ceil(SCAN_BLOCK) + 1))?,
            visible: storage("visible clusters", bytes::<VisibleCluster>(visible))?,
            numbers: storage("visible clusters", bytes::<u32>(visible))?,
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
