//! Pages of shadow maps: the stages that cull for a view find what each block of pages shows, a kernel lists which clusters
//! are drawn into which pages, and the rasterizers draw these, each page as a view of its own. First the nearer half of a
//! page's clusters, then those of the others that these do not hide from the light.

use std::sync::Arc;

use wgpu::{Buffer, BufferUsages, CommandEncoder, ComputePassDescriptor};

use super::buffers::{Buffers, Room, Shape, bytes};
use super::context::Context;
use super::kernel::{Bindings, Constant, CullPass, Kernel, bind, bindings};
use super::lists::List;
use super::meshes::Meshes;
use super::pyramids::Pyramids;
use super::raster::{Onto, PageViews, RasterBindings, Words};
use super::raster_large::{alpha_test, raster_alpha_tested, raster_large};
use super::raster_small::raster_small;
use super::recorder::Recorder;
use super::shadow_pool::{DevicePage, ShadowPool};
use super::view_history::ViewHistory;
use super::{cluster_cull, instance_cull, instances, node_cull};
use crate::config::Outputs;
use crate::error::{Error, Result};
use crate::gpu_types::{Dispatch, HISTORY_PAGES, Instance, PageClusters, PairLists, View, VisibleCluster};
use crate::limits::{MAX_VISIBLE, SHADOW_SLOT_WORDS};
use crate::stream::{Needs, Resident};

/// Lists of a first frame; each grows to what frames need.
const FIRST_ROOM: Room = Room { items: 1 << 12, candidate_groups: 1 << 12, visible: 1 << 14 };
/// Clusters in pages, of each list.
const FIRST_PAIRS: u32 = 1 << 15;
/// Lists of them: small, large and alpha-tested.
const PAIR_LISTS: u32 = 3;

bindings! {
    /// What `shadow_raster` binds.
    ShadowRaster {
        view: Uniform, instances: Read, page_offsets: Read, pages: Read, visible: Read, numbers: Read, draws: Read,
        grid: Read, pair_lists: Uniform, pairs: Write, pair_draws: Write, deferred: Write, deferred_draws: Write,
        page_clusters: Write, pages_1: Read, pages_2: Read, pages_3: Read,
    }
}

bindings! {
    /// What `shadow_hidden` binds before [`PageViews`].
    ShadowHidden {
        instances: Read, page_offsets: Read, pages: Read, visible: Read, draws: Read, words: Read, page_clusters: Write,
        pages_1: Read, pages_2: Read, pages_3: Read,
    }
}

bindings! {
    /// What `shadow_hidden` binds behind them.
    Drawn { drawn: Write, drawn_draws: Write }
}

bindings! {
    /// What `shadow_tiles` binds.
    ShadowTiles { page_views: Read, words: Write }
}

/// Clusters of a list → the pages of a block that they are drawn into; or how near to the light those of each page are.
pub const fn shadow_raster(list: List, measures: bool) -> Kernel {
    let constants = [Constant::Number("LIST", list as u32), Constant::Flag("MEASURES", measures)];
    Kernel::new("shadow_raster", &[ShadowRaster::BINDINGS]).constants(constants)
}

/// Deferred clusters of a list and their pages → those that are not hidden.
pub const fn shadow_hidden(list: List) -> Kernel {
    let list = Constant::Number("LIST", list as u32);
    Kernel::new("shadow_hidden", &[ShadowHidden::BINDINGS, PageViews::BINDINGS, Drawn::BINDINGS])
        .constants([list])
}

/// Keys of pages → the least and the largest of tiles.
pub const SHADOW_TILE_RANGES: Kernel = Kernel::new("shadow_tiles", &[ShadowTiles::BINDINGS]);

/// The lists whose clusters are drawn into pages: nothing is left to the device's own rasterizer.
const LISTS: [List; 3] = [List::Small, List::Large, List::AlphaTested];

pub(super) fn kernels() -> Vec<Kernel> {
    let of_list = |list| [shadow_raster(list, true), shadow_raster(list, false), shadow_hidden(list)];
    LISTS.into_iter().flat_map(of_list).chain([SHADOW_TILE_RANGES]).collect()
}

/// Pages that are culled for together.
#[derive(Clone, Debug)]
pub struct ShadowBlock {
    /// What culls for them: a view of the whole block.
    pub view: View,
    /// Their grid, see `shaders/shadow_raster.wgsl`. Pages are numbered from 1 on over all blocks.
    pub grid: Vec<u32>,
    /// The views that draw them.
    pub pages: Vec<View>,
}

/// What was drawn.
#[derive(Debug, Default)]
pub struct ShadowsDrawn {
    /// The pages of all blocks.
    pub pages: Vec<Arc<DevicePage>>,
    /// Clusters, each once for every page that it may touch.
    pub clusters: u64,
    /// Clusters that others hide from the light, counted so, too.
    pub culled_clusters: u64,
    /// Something coarser stood for pages of meshes that were not there.
    pub lacks: bool,
    /// Those pages.
    pub needs: Needs,
}

/// What is drawn from.
pub(super) struct Sources<'a> {
    pub(super) meshes: &'a Meshes,
    pub(super) instances: &'a instances::Instances,
    pub(super) resident: &'a Resident,
}

/// What stays on a device between frames.
#[derive(Debug)]
pub(super) struct ShadowDrawing {
    pool: ShadowPool,
    history: ViewHistory,
    room: Room,
    pair_room: u32,
    pairs: Option<Pairs>,
    pair_lists: Buffer,
    /// How many pairs there are of each list, and of the deferred.
    draws: [Buffer; 2],
    /// With room for so many pages.
    page_clusters: Option<(u32, Buffer)>,
}

/// Lists of clusters and pages.
#[derive(Debug)]
struct Pairs {
    room: u32,
    drawn: Buffer,
    deferred: Buffer,
}

impl ShadowDrawing {
    pub(super) fn new(context: &Arc<Context>) -> Result<Self> {
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let uniform = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let mut history = ViewHistory::new(context)?;
        history.pyramids = Pyramids::of_pages(context)?;
        let draws =
            || context.buffer("draws", bytes::<Dispatch>(List::COUNT), storage | BufferUsages::INDIRECT);
        Ok(Self {
            pool: ShadowPool::new(context)?,
            history,
            room: FIRST_ROOM,
            pair_room: FIRST_PAIRS,
            pairs: None,
            pair_lists: context.buffer("draws", bytes::<PairLists>(1), uniform)?,
            draws: [draws()?, draws()?],
            page_clusters: None,
        })
    }

    /// Pages that a device has room for.
    pub(super) fn most(context: &Context) -> usize {
        ShadowPool::most(context)
    }

    /// The buffer that pages lie in.
    pub(super) fn pool(&self) -> Buffer {
        self.pool.buffer()
    }

    /// Draws the pages of blocks, into slots of which there are `most` and which `kept` pages stay in. With `occlusion` what is
    /// hidden from the light is left out, which changes no page.
    pub(super) fn draw(
        &mut self,
        context: &Arc<Context>,
        sources: &Sources<'_>,
        blocks: &mut [ShadowBlock],
        most: usize,
        kept: &[Arc<DevicePage>],
        occlusion: bool,
    ) -> Result<ShadowsDrawn> {
        let count = blocks.iter().map(|block| block.pages.len()).sum();
        let pages = self.pool.take(count, most, kept)?;
        if pages.len() < count {
            return Err(Error::Invariant("there were fewer slots of shadow pages than wanted".to_owned()));
        }
        let views = blocks.iter_mut().flat_map(|block| &mut block.pages);
        for (view, page) in views.zip(&pages) {
            view.first_word = page.slot().map_or(0, |slot| slot * SHADOW_SLOT_WORDS as u32);
        }
        for block in &mut *blocks {
            block.view.instances = sources.instances.len();
            block.view.group_words = sources.instances.group_words();
            (block.view.history, block.view.depth_only) = (HISTORY_PAGES, 1);
        }
        if blocks.is_empty() || !sources.instances.any() {
            let mut encoder = context.encoder("pages of shadow maps");
            self.clear(&mut encoder, &pages);
            context.start(encoder)?;
            return Ok(ShadowsDrawn { pages, ..ShadowsDrawn::default() });
        }
        let uploaded = Uploaded::new(context, blocks)?;
        loop {
            self.make_room(context, sources, count as u32)?;
            let (drawn, room, pair_room) = self.submit(context, sources, &uploaded, &pages, occlusion)?;
            if room.visible as usize > MAX_VISIBLE || pair_room as usize > MAX_VISIBLE {
                let count = room.visible.max(pair_room);
                let message = format!("lights see {count} clusters at once, the most is {MAX_VISIBLE}");
                return Err(Error::TooLarge(message));
            }
            let room = self.room.grown(room);
            if room == self.room && pair_room <= self.pair_room {
                self.history.buffers.iter_mut().for_each(|buffers| buffers.bind_groups.next_frame());
                return Ok(ShadowsDrawn { pages, ..drawn });
            }
            self.room = room;
            self.pair_room = self.pair_room.max(pair_room.next_power_of_two());
        }
    }

    /// Leaves nothing in pages.
    fn clear(&self, encoder: &mut CommandEncoder, pages: &[Arc<DevicePage>]) {
        let (pool, bytes) = (self.pool.buffer(), 4 * SHADOW_SLOT_WORDS as u64);
        for slot in pages.iter().filter_map(|page| page.slot()) {
            encoder.clear_buffer(&pool, u64::from(slot) * bytes, Some(bytes));
        }
    }

    /// Lets go of all buffers that are bound: some are to be replaced.
    pub(super) fn release(&mut self) {
        self.history.buffers.iter_mut().for_each(|own| own.bind_groups.clear());
    }

    /// Sees to it that all lists are as long as they are to be.
    fn make_room(&mut self, context: &Context, sources: &Sources<'_>, pages: u32) -> Result<()> {
        let Sources { meshes, instances, resident } = sources;
        let shape = Shape {
            instances: instances.room(),
            group_words: instances.group_words(),
            depth: instances.depth(),
            pages: if resident.is_empty() { 0 } else { meshes.page_count() },
            pixels: 0,
            room: self.room,
            occlusion: false,
            depth_only: true,
            outputs: Outputs::default(),
            stays_on_device: false,
            groups_come_back: false,
            waits: false,
        };
        let history = &mut self.history;
        if history.seen.as_ref().is_none_or(|(room, _)| *room != shape.instances) {
            history.seen = None;
            let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
            let seen = context.buffer(instances::WHAT, bytes::<Instance>(shape.instances), storage)?;
            history.seen = Some((shape.instances, seen));
            history.buffers.iter_mut().for_each(|own| own.bind_groups.clear());
        }
        if history.buffers.as_ref().is_none_or(|own| own.shape != shape) {
            let before = history.buffers.take();
            history.buffers = Some(Buffers::new(context, shape, before)?);
        }
        const WHAT: &str = "clusters in pages of shadow maps";
        if self.pairs.as_ref().is_none_or(|pairs| pairs.room != self.pair_room) {
            self.pairs = None;
            let room = self.pair_room;
            let list =
                || context.buffer(WHAT, bytes::<VisibleCluster>(PAIR_LISTS * room), BufferUsages::STORAGE);
            self.pairs = Some(Pairs { room, drawn: list()?, deferred: list()? });
            let lists = PairLists { room, unused_a: 0, unused_b: 0, unused_c: 0 };
            context.write("draws", &self.pair_lists, 0, bytemuck::bytes_of(&lists))?;
            self.release();
        }
        if self.page_clusters.as_ref().is_none_or(|(room, _)| *room < pages) {
            let room = pages.next_power_of_two();
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
            self.page_clusters = Some((room, context.buffer(WHAT, bytes::<PageClusters>(room), usage)?));
            self.release();
        }
        Ok(())
    }

    /// Draws once; also the lengths that lists wanted.
    fn submit(
        &self,
        context: &Arc<Context>,
        sources: &Sources<'_>,
        uploaded: &Uploaded,
        pages: &[Arc<DevicePage>],
        occlusion: bool,
    ) -> Result<(ShadowsDrawn, Room, u32)> {
        let Self { history, draws: [draws, deferred_draws], .. } = self;
        let (Some((_, seen)), Some(buffers), Some(pairs), Some((_, page_clusters)), Some(slots)) =
            (&history.seen, &history.buffers, &self.pairs, &self.page_clusters, sources.instances.slots())
        else {
            return Err(Error::Invariant("shadow maps are drawn without buffers".to_owned()));
        };
        let pool = self.pool.buffer();
        let materials = sources.instances.table().buffers();
        let recorder = |pass| Recorder {
            context,
            meshes: sources.meshes,
            instances: slots,
            slots: sources.instances.len(),
            seen,
            buffers,
            pyramids: &history.pyramids,
            lights: &history.lights,
            materials,
            shadows: None,
            culling: false,
            listed: false,
            cull_pass: CullPass::First,
            pass,
        };
        context.queue().write_buffer(&buffers.group_blocks, 0, bytemuck::bytes_of(&buffers.group_dispatch()));
        let staged = buffers.length_bytes();
        let lengths = bytes::<Dispatch>(List::COUNT);
        let of_pages = bytes::<PageClusters>(pages.len() as u32);
        // How many of the first pass, how many were deferred, and how many of these were drawn.
        let tail = [lengths, lengths, lengths, of_pages, bytes::<u32>(buffers.shape.pages)];
        let size = uploaded.blocks as u64 * staged + tail.iter().sum::<u64>();
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let staging = context.buffer("what is read back", size, usage)?;
        let mut encoder = context.encoder("pages of shadow maps");
        self.clear(&mut encoder, pages);
        for buffer in [draws, deferred_draws, page_clusters, &buffers.wanted] {
            encoder.clear_buffer(buffer, 0, None);
        }
        let grid = history.pyramids.earlier();
        let begin = |encoder: &mut CommandEncoder, label| {
            let descriptor = ComputePassDescriptor { label: Some(label), timestamp_writes: None };
            recorder(encoder.begin_compute_pass(&descriptor).forget_lifetime())
        };
        for block in 0..uploaded.blocks as u64 {
            let (view, grid_bytes) = (size_of::<View>() as u64, grid.size());
            encoder.copy_buffer_to_buffer(&uploaded.views, block * view, &buffers.view, 0, view);
            encoder.copy_buffer_to_buffer(&uploaded.grids, block * grid_bytes, grid, 0, grid_bytes);
            buffers.clear_lists(&mut encoder);
            let mut r = begin(&mut encoder, "a block of shadow pages");
            instance_cull::record(&mut r);
            node_cull::record(&mut r);
            cluster_cull::record(&mut r);
            self.list_pairs(&mut r, pairs, page_clusters, occlusion);
            drop(r);
            buffers.copy_lengths(&mut encoder, &staging, block * staged);
        }
        let tiles = bind!(ShadowTiles { page_views: &uploaded.pages, words: &pool });
        let mut r = begin(&mut encoder, "pages of shadow maps");
        self.draw_pairs(&mut r, pairs, &uploaded.pages, &pool);
        r.run(SHADOW_TILE_RANGES, &tiles.buffers(), pages.len() as u32);
        drop(r);
        let mut at = uploaded.blocks as u64 * staged;
        encoder.copy_buffer_to_buffer(draws, 0, &staging, at, lengths);
        at += lengths;
        encoder.clear_buffer(draws, 0, None);
        if occlusion {
            let mut r = begin(&mut encoder, "what is not hidden in pages of shadow maps");
            self.list_unhidden(&mut r, pairs, page_clusters, &uploaded.pages, &pool);
            self.draw_pairs(&mut r, pairs, &uploaded.pages, &pool);
            r.run(SHADOW_TILE_RANGES, &tiles.buffers(), pages.len() as u32);
            drop(r);
        }
        let last = [deferred_draws, draws, page_clusters, &buffers.wanted];
        for (buffer, bytes) in last.into_iter().zip(&tail[1..]) {
            encoder.copy_buffer_to_buffer(buffer, 0, &staging, at, *bytes);
            at += bytes;
        }
        let (mut room, mut drawn, mut pair_room) = (Room::default(), ShadowsDrawn::default(), 0);
        context.submit(encoder, &staging, size, |read| {
            let (blocks, mut read) = read.split_at((uploaded.blocks as u64 * staged) as usize);
            for lengths in blocks.chunks_exact(staged as usize) {
                room = room.grown(buffers.lengths(lengths));
            }
            let [first, deferred, second] = [(); 3].map(|()| {
                let (draws, rest) = read.split_at(lengths as usize);
                read = rest;
                bytemuck::pod_collect_to_vec::<u8, Dispatch>(draws)
            });
            let count = |draws: &[Dispatch]| draws.iter().map(|draw| u64::from(draw.count)).sum::<u64>();
            pair_room = first.iter().chain(&deferred).map(|draw| draw.count).max().unwrap_or(0);
            drawn.clusters = count(&first) + count(&second);
            drawn.culled_clusters = count(&deferred).saturating_sub(count(&second));
            let (of_pages, wanted) = read.split_at(of_pages as usize);
            let triangles = bytemuck::pod_collect_to_vec::<u8, PageClusters>(of_pages);
            triangles.iter().zip(pages).for_each(|(clusters, page)| page.note(clusters.triangles));
            let wanted: Vec<u32> = bytemuck::pod_collect_to_vec(wanted);
            drawn.lacks = wanted.iter().any(|bits| *bits != 0);
            drawn.needs = sources.meshes.needs(&wanted);
        })?;
        Ok((drawn, room, pair_room))
    }

    /// Which clusters of a block are drawn into which of its pages, and which are deferred.
    fn list_pairs(&self, r: &mut Recorder<'_>, lists: &Pairs, page_clusters: &Buffer, occlusion: bool) {
        let (b, m, own) = (r.buffers, r.meshes, r.own());
        let [pages, pages_1, pages_2, pages_3] = m.pages();
        let [pair_draws, deferred_draws] = &self.draws;
        let bound = bind!(ShadowRaster {
            view: &b.view,
            instances: r.seen,
            page_offsets: m.page_offsets(),
            pages: pages,
            visible: &b.visible,
            numbers: &own.numbers,
            draws: own.draws(),
            grid: r.pyramid(),
            pair_lists: &self.pair_lists,
            pairs: &lists.drawn,
            pair_draws: pair_draws,
            deferred: &lists.deferred,
            deferred_draws: deferred_draws,
            page_clusters: page_clusters,
            pages_1: pages_1,
            pages_2: pages_2,
            pages_3: pages_3,
        });
        // What is not measured is not deferred.
        for measures in [true, false].into_iter().filter(|measures| occlusion || !measures) {
            for list in LISTS {
                let kernel = shadow_raster(list, measures);
                r.run_indirect(kernel, &bound.buffers(), own.draws(), list as u32);
            }
        }
    }

    /// Which of the deferred clusters are drawn.
    fn list_unhidden(
        &self,
        r: &mut Recorder<'_>,
        lists: &Pairs,
        page_clusters: &Buffer,
        page_views: &Buffer,
        pool: &Buffer,
    ) {
        let m = r.meshes;
        let [pages, pages_1, pages_2, pages_3] = m.pages();
        let [drawn_draws, deferred_draws] = &self.draws;
        let deferred = bind!(ShadowHidden {
            instances: &r.instances.transforms,
            page_offsets: m.page_offsets(),
            pages: pages,
            visible: &lists.deferred,
            draws: deferred_draws,
            words: pool,
            page_clusters: page_clusters,
            pages_1: pages_1,
            pages_2: pages_2,
            pages_3: pages_3,
        });
        let views = bind!(PageViews { page_views: page_views, pairs: &self.pair_lists });
        let drawn = bind!(Drawn { drawn: &lists.drawn, drawn_draws: drawn_draws });
        let bound = [deferred.buffers(), views.buffers(), drawn.buffers()].concat();
        for list in LISTS {
            r.run_indirect(shadow_hidden(list), &bound, deferred_draws, list as u32);
        }
    }

    /// Draws clusters into their pages.
    fn draw_pairs(&self, r: &mut Recorder<'_>, lists: &Pairs, page_views: &Buffer, pool: &Buffer) {
        let m = r.meshes;
        let [pages, pages_1, pages_2, pages_3] = m.pages();
        let [draws, _] = &self.draws;
        let all = bind!(RasterBindings {
            instances: &r.instances.transforms,
            page_offsets: m.page_offsets(),
            pages: pages,
            visible: &lists.drawn,
            draws: draws,
            words: pool,
            counters: &r.own().counters,
            pages_1: pages_1,
            pages_2: pages_2,
            pages_3: pages_3,
        });
        let views = bind!(PageViews { page_views: page_views, pairs: &self.pair_lists });
        let bound = [all.buffers(), views.buffers()].concat();
        let (small, large) =
            (raster_small(Onto::Pages, Words::Depth), raster_large(Onto::Pages, Words::Depth));
        r.run_indirect(small, &bound, draws, List::Small as u32);
        r.run_indirect(large, &bound, draws, List::Large as u32);
        if let Some(test) = alpha_test(r.materials, &r.instances.instance_materials) {
            let kernel = raster_alpha_tested(Onto::Pages, Words::Depth);
            r.run_indirect(kernel, &[bound, test].concat(), draws, List::AlphaTested as u32);
        }
    }
}

/// What the host writes for a frame's blocks.
struct Uploaded {
    blocks: usize,
    views: Buffer,
    grids: Buffer,
    /// Of all their pages.
    pages: Buffer,
}

impl Uploaded {
    fn new(context: &Context, blocks: &[ShadowBlock]) -> Result<Self> {
        let write = |what: &str, bytes: &[u8], usage| {
            let buffer = context.buffer(what, bytes.len() as u64, usage | BufferUsages::COPY_DST)?;
            context.write(what, &buffer, 0, bytes).map(|()| buffer)
        };
        let views: Vec<View> = blocks.iter().map(|block| block.view).collect();
        let grids: Vec<u32> = blocks.iter().flat_map(|block| &block.grid).copied().collect();
        let pages: Vec<View> = blocks.iter().flat_map(|block| &block.pages).copied().collect();
        Ok(Self {
            blocks: blocks.len(),
            views: write("views", bytemuck::cast_slice(&views), BufferUsages::COPY_SRC)?,
            grids: write("grids of shadow pages", bytemuck::cast_slice(&grids), BufferUsages::COPY_SRC)?,
            pages: write("views", bytemuck::cast_slice(&pages), BufferUsages::STORAGE)?,
        })
    }
}
