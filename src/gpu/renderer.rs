//! Draws frames: uploads what is needed, submits, reads back, and grows what was too short.

use std::sync::Arc;

use rayon::prelude::*;

use super::buffers::{Buffers, DeviceVisibility, Levels, Room, Shape};
use super::context::Context;
use super::instances::{Instances, SceneInstance};
use super::kernel::{BoundBuffer, CullPass, Kernel};
use super::lists::List;
use super::meshes::Meshes;
use super::passes::Passes;
use super::raster::Words;
use super::recorder::surface;
use super::request::{Counted, Drawn, Made, StageTimes, ViewRequest, Ways};
use super::shadow_mark::{Column, ShadowMarking};
use super::shadow_pool::DevicePage;
use super::shadow_raster::{ShadowBlock, ShadowDrawing, ShadowsDrawn, Sources};
use super::shadow_table::ShadowTable;
use super::view_history::{Prepared, SubmittedView, ViewHistory};
use super::{
    calibrate, cluster_cull, hzb, instance_cull, node_cull, occlusion, output, raster_large, raster_small,
    shade, times,
};
use crate::config::{Output, Raster};
use crate::error::{Error, Result};
use crate::gpu_types::{Array, Counters, Dispatch, HISTORY_LIST, TraversalItem, View};
use crate::limits::MAX_VISIBLE;
use crate::stages::Stage;
use crate::stream::Resident;
use crate::views::Histories;

/// Lists of a first frame; each grows to what frames need.
const FIRST_ROOM: Room = Room { items: 1 << 12, candidate_groups: 1 << 12, visible: 1 << 14 };

/// Frames of a view that may leave their visibility buffers on the device, while they are there: in a loop, one is while the
/// next is drawn. With more of them they are read.
const MOST_ON_DEVICE: usize = 2;

/// Bytes of a picture that a thread copies at a time.
const COPIED_AT_ONCE: usize = 1 << 18;

/// A device with what stays on it between frames.
#[derive(Debug)]
pub struct DeviceRenderer {
    context: Arc<Context>,
    meshes: Meshes,
    instances: Instances,
    room: Room,
    /// By the ids of their views.
    histories: Histories<ViewHistory>,
    /// Once there were shadows.
    shadows: Option<ShadowDrawing>,
    marking: Option<ShadowMarking>,
}

impl DeviceRenderer {
    /// A renderer on the best device there is.
    pub fn new() -> Result<Self> {
        let context = Context::shared()?;
        let (meshes, instances) = (Meshes::default(), Instances::default());
        Ok(Self {
            context,
            meshes,
            instances,
            room: FIRST_ROOM,
            histories: Histories::default(),
            shadows: None,
            marking: None,
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
    pub fn set(&mut self, slot: u32, instance: Option<SceneInstance<'_>>) {
        self.instances.set(slot, instance);
    }

    /// Whether a frame of a view has, with occlusion, no earlier one to start from.
    pub fn starts(&self, id: u64, view: &View) -> bool {
        self.histories.get(id).is_none_or(|history| history.pyramids.starts(view))
    }

    /// What shaded an array of a view's last frame: the kernel, all that it binds, and whether pages lie in several arrays.
    /// For benchmarks, which shade the same picture in other ways.
    #[cfg(feature = "internals")]
    pub fn shading(&self, id: u64, output: Output) -> Option<(Kernel, Vec<BoundBuffer<'_>>, bool)> {
        let ViewHistory { seen: Some((_, seen)), buffers: Some(buffers), lights, .. } =
            self.histories.get(id)?
        else {
            return None;
        };
        let (_, out) = buffers.outputs.iter().find(|(made, _)| *made == output && made.shaded())?;
        let surface = &surface(buffers, &self.meshes, seen, self.instances.slots()?, out);
        let (kernel, bindings) =
            shade::kernel(output, surface, lights, self.instances.table().buffers(), None);
        Some((kernel, bindings, self.meshes.split()))
    }

    /// Draws what is in the slots, in their order, and of streamed meshes resident, from several views of any size, in one
    /// submission. Each has an id of its own.
    pub fn draw(
        &mut self,
        requests: &mut [ViewRequest<'_>],
        ways: Ways,
        resident: &Resident,
    ) -> Result<Vec<Drawn>> {
        self.context.check()?;
        if requests.is_empty() {
            return Ok(Vec::new());
        }
        if !self.instances.any() {
            // Nothing is to be drawn, so nothing to be measured.
            let open = matches!(ways.raster, Raster::Auto | Raster::Measured);
            let raster = if open { Raster::Compute } else { ways.raster };
            requests.iter_mut().for_each(|request| request.words.fill(0));
            return Ok(requests.iter().map(|_| Drawn { raster, ..Drawn::default() }).collect());
        }
        let size = |request: &ViewRequest<'_>| (request.view.width, request.view.height);
        let largest = requests.iter().map(size).fold((0, 0), |a, b| (a.0.max(b.0), a.1.max(b.1)));
        let raster = calibrate::choose(&self.context, ways.raster, largest)?;
        // What is new is made first, so that nothing known is lost where that fails.
        for request in &*requests {
            self.histories.get_or_make(request.id, || ViewHistory::new(&self.context))?;
        }
        // They are out of the table while they are drawn, in the order of the views, and come back whatever happens.
        let ids: Vec<u64> = requests.iter().map(|request| request.id).collect();
        let mut histories = self.histories.take(ids.iter().copied());
        let drawn = self.draw_views(&mut histories, requests, Ways { raster, ..ways }, resident);
        self.histories.give(ids.iter().copied().zip(histories));
        self.histories.trim(ids.iter().copied());
        drawn
    }

    /// The same with what the views keep, and rasterizers that were chosen.
    fn draw_views(
        &mut self,
        histories: &mut [ViewHistory],
        requests: &mut [ViewRequest<'_>],
        ways: Ways,
        resident: &Resident,
    ) -> Result<Vec<Drawn>> {
        let raster = ways.raster;
        let hardware = raster != Raster::Compute;
        if self.instances.replaces_buffers(&self.meshes, resident, ways.shading) {
            // Views that are not drawn now would keep them alive.
            let all = self.histories.iter_mut().chain(histories.iter_mut());
            all.filter_map(|history| history.buffers.as_mut()).for_each(|own| own.bind_groups.clear());
            self.shadows.iter_mut().for_each(ShadowDrawing::release);
            self.marking.iter_mut().for_each(ShadowMarking::release);
        }
        let before = self.meshes.bytes();
        let uploaded_bytes = self.instances.upload(&self.context, &mut self.meshes, resident)?;
        let uploaded_mesh_bytes = self.meshes.bytes() - before;
        let mut views = Vec::with_capacity(requests.len());
        for (history, request) in histories.iter_mut().zip(&*requests) {
            let size = (request.view.width, request.view.height);
            let viewport = history.viewport(&self.context, size, hardware)?;
            let mut prepared = history.prepare(&self.context, &self.instances, request, ways.occlusion)?;
            prepared.view.viewport = viewport;
            views.push(prepared);
        }
        loop {
            for ((history, request), prepared) in histories.iter_mut().zip(&*requests).zip(&mut views) {
                let shape = Shape {
                    instances: self.instances.room(),
                    group_words: self.instances.group_words(),
                    depth: self.instances.depth(),
                    pages: if resident.is_empty() { 0 } else { self.meshes.page_count() },
                    pixels: u64::from(request.view.width) * u64::from(request.view.height),
                    room: self.room,
                    occlusion: ways.occlusion,
                    depth_only: request.depth_only,
                    // Its lists are for other rasterizers then than those which count.
                    outputs: if hardware {
                        request.outputs.without(Output::Overdraw)
                    } else {
                        request.outputs
                    },
                    stays_on_device: false,
                    groups_come_back: ways.until == Some(Stage::ClusterCull),
                    waits: ways.waits,
                };
                let context = &self.context;
                // Others go before new ones are made.
                let fits = |own: &Buffers| own.shape.inner() == shape.inner();
                let (buffers, before) = match history.buffers.take() {
                    Some(own) if fits(&own) => (Some(own), None),
                    before => (None, before),
                };
                let left = buffers.as_ref().map_or(0, Buffers::frames_on_device);
                let shape =
                    Shape { stays_on_device: request.keep_on_device && left < MOST_ON_DEVICE, ..shape };
                let buffers = match buffers {
                    Some(own) if own.shape == shape => Ok(own),
                    Some(own) => own.making(context, shape),
                    None => Buffers::new(context, shape, before),
                };
                let buffers = buffers.and_then(|mut own| own.release_words(context).map(|()| own));
                let buffers = buffers.inspect_err(|_| self.room = FIRST_ROOM)?;
                prepared.start(&buffers);
                history.buffers = Some(buffers);
            }
            let mut submitted = Vec::with_capacity(requests.len());
            for (history, Prepared { view, culling, .. }) in histories.iter().zip(&views) {
                let (Some((_, seen)), Some(buffers)) = (&history.seen, &history.buffers) else { continue };
                submitted.push(SubmittedView { view, culling: *culling, seen, buffers, history });
            }
            let (mut drawn, lengths) = self.submit(&submitted, Ways { raster, ..ways }, requests)?;
            if lengths.visible as usize > MAX_VISIBLE {
                let count = lengths.visible;
                let message = format!("{count} clusters are visible at once, the most is {MAX_VISIBLE}");
                return Err(Error::TooLarge(message));
            }
            let room = self.room.grown(lengths);
            if room == self.room {
                for ((drawn, history), prepared) in drawn.iter_mut().zip(&mut *histories).zip(&views) {
                    let Prepared { view, culling, .. } = prepared;
                    (drawn.uploaded_bytes, drawn.raster) = (uploaded_bytes, raster);
                    drawn.uploaded_mesh_bytes = uploaded_mesh_bytes;
                    drawn.listed = view.history == HISTORY_LIST;
                    drawn.reduced_images = self.instances.table().reduced_images();
                    drawn.needs = self.meshes.needs(&drawn.wanted);
                    let buffers = history.buffers.as_ref().filter(|buffers| buffers.shape.stays_on_device);
                    drawn.visibility = buffers.map(|buffers| DeviceVisibility::new(&self.context, buffers));
                    history.remember(view, drawn, *culling, ways.occlusion);
                }
                return Ok(drawn);
            }
            self.room = room;
        }
    }

    /// The columns of each light that the pixels of a view's last picture may look up, see `shadow_mark`; none where they are
    /// more, or farther away, than tables have room for. `table` says how the view sees so many lights.
    pub fn mark_shadows(
        &mut self,
        id: u64,
        table: &[[u32; 4]],
        lights: usize,
    ) -> Result<Option<Vec<Vec<Column>>>> {
        self.context.check()?;
        let Self { context, meshes, histories, marking, instances, .. } = self;
        let history = histories.get(id).filter(|_| instances.any());
        let Some(ViewHistory { seen: Some((_, seen)), buffers: Some(buffers), .. }) = history else {
            // Nothing was drawn.
            return Ok(Some(vec![Vec::new(); lights]));
        };
        let marking = match marking {
            Some(marking) => marking,
            None => marking.insert(ShadowMarking::new(context)?),
        };
        marking.run(context, meshes, (seen, buffers), table, lights)
    }

    /// Makes the arrays that waited of views' last pictures, each with the table of its shadow maps: the arrays of each, and
    /// what stages took.
    pub fn shade(&mut self, views: &[(u64, Vec<[u32; 4]>)]) -> Result<(Vec<Made>, StageTimes)> {
        self.context.check()?;
        let waits = |own: &Buffers| own.outputs.iter().any(|(output, _)| *output != Output::Overdraw);
        let buffers = views.iter().filter_map(|(id, _)| self.histories.get(*id)?.buffers.as_ref());
        if !buffers.into_iter().any(waits) {
            return Ok((vec![Vec::new(); views.len()], Vec::new()));
        }
        let context = &*self.context;
        for (id, table) in views {
            let history = self.histories.get_or_make(*id, || ViewHistory::new(context))?;
            let own = match &mut history.shadow_table {
                Some(own) => own,
                none => none.insert(ShadowTable::new(context)?),
            };
            own.write(context, table)?;
        }
        let pool = self.shadows.as_ref().map(ShadowDrawing::pool);
        let instances = self.instances.slots().filter(|_| self.instances.any());
        let (Some(pool), Some(instances)) = (pool, instances) else {
            return Ok((vec![Vec::new(); views.len()], Vec::new()));
        };
        let none: View = bytemuck::Zeroable::zeroed();
        let submitted: Vec<SubmittedView<'_>> = views
            .iter()
            .filter_map(|(id, _)| {
                let history = self.histories.get(*id)?;
                let (seen, buffers) = (&history.seen.as_ref()?.1, history.buffers.as_ref()?);
                Some(SubmittedView { view: &none, culling: false, seen, buffers, history })
            })
            .collect();
        let Some(first) = submitted.first().filter(|_| submitted.len() == views.len()) else {
            return Ok((vec![Vec::new(); views.len()], Vec::new()));
        };
        let times = &first.buffers.times;
        let mut encoder = context.encoder("arrays of a frame");
        let mut passes = Passes {
            context,
            meshes: &self.meshes,
            submitted: &submitted,
            instances,
            slots: self.instances.len(),
            materials: self.instances.table().buffers(),
            shadow_pages: Some(&pool),
            times,
            until: None,
            encoder: &mut encoder,
            passes: Vec::new(),
        };
        passes.make_arrays();
        let passes = passes.passes;
        times.resolve(&mut encoder, passes.len() as u32);
        submitted.iter().for_each(|view| view.buffers.copy_arrays(&mut encoder));
        let submission = context.start(encoder)?;
        let (mut made, mut taken): (Vec<Made>, StageTimes) = Default::default();
        for (number, SubmittedView { buffers, .. }) in submitted.iter().enumerate() {
            let Some(staging) = &buffers.array_staging else { continue };
            let mut arrays = Vec::new();
            context.read(submission.clone(), staging, buffers.array_bytes(), |staged| {
                let parts = buffers.split_arrays(staged);
                let [ticks, parts @ ..] = &parts[..] else { return };
                if number == 0 {
                    taken = stage_times(&passes, ticks, context.tick());
                }
                let pixels = buffers.shape.pixels as usize;
                let outputs = buffers.shape.outputs.iter().filter(|output| *output != Output::Overdraw);
                let made = outputs.zip(parts);
                arrays = made.map(|(output, bytes)| (output, Array::read(output, pixels, bytes))).collect();
            })?;
            made.push(arrays);
        }
        Ok((made, taken))
    }

    /// Pages of shadow maps that there is room for.
    pub fn most_shadow_pages(&self) -> usize {
        ShadowDrawing::most(&self.context)
    }

    /// Draws pages of shadow maps of the scene in the slots, sorted by block. `kept` ones stay where they are; there may be
    /// `most`. With `occlusion` what is hidden from the light is left out.
    pub fn draw_shadows(
        &mut self,
        blocks: &mut [ShadowBlock],
        most: usize,
        kept: &[Arc<DevicePage>],
        occlusion: bool,
        resident: &Resident,
    ) -> Result<ShadowsDrawn> {
        self.context.check()?;
        if self.shadows.is_none() {
            self.shadows = Some(ShadowDrawing::new(&self.context)?);
        }
        let sources = Sources { meshes: &self.meshes, instances: &self.instances, resident };
        match &mut self.shadows {
            Some(shadows) => shadows.draw(&self.context, &sources, blocks, most, kept, occlusion),
            None => Ok(ShadowsDrawn::default()),
        }
    }

    /// Runs the stages once; also the lengths that their lists wanted.
    fn submit(
        &self,
        submitted: &[SubmittedView<'_>],
        ways: Ways,
        requests: &mut [ViewRequest<'_>],
    ) -> Result<(Vec<Drawn>, Room)> {
        let Ways { int64_atomics, raster, .. } = ways;
        let context = &*self.context;
        let queue = context.queue();
        let mut encoder = context.encoder("a frame");
        for SubmittedView { view, buffers, .. } in submitted {
            queue.write_buffer(&buffers.view, 0, bytemuck::bytes_of(*view));
            queue.write_buffer(&buffers.group_blocks, 0, bytemuck::bytes_of(&buffers.group_dispatch()));
            buffers.clear(&mut encoder, view.history == HISTORY_LIST);
        }
        let int64_atomics = int64_atomics && context.int64_atomics();
        // How a view is written to: at once, or in two steps.
        let form = move |buffers: &Buffers, step: usize| match (buffers.shape.depth_only, int64_atomics, step)
        {
            (true, _, 0) => Some(Words::Depth),
            (false, true, 0) => Some(Words::Int64),
            (false, false, 0) => Some(Words::Keys),
            (false, false, 1) => Some(Words::Lows),
            _ => None,
        };
        let two_steps = submitted.iter().any(|submitted_view| form(submitted_view.buffers, 1).is_some());
        let (Some(instances), Some(first)) = (self.instances.slots(), submitted.first()) else {
            return Ok(Default::default());
        };
        let times = &first.buffers.times;
        let mut passes = Passes {
            context,
            meshes: &self.meshes,
            submitted,
            instances,
            slots: self.instances.len(),
            materials: self.instances.table().buffers(),
            shadow_pages: None,
            times,
            until: ways.until,
            encoder: &mut encoder,
            passes: Vec::new(),
        };
        passes.run(Stage::InstanceCull, CullPass::First, instance_cull::record);
        for cull_pass in CullPass::BOTH {
            passes.run(Stage::NodeCull, cull_pass, node_cull::record);
            passes.run(Stage::ClusterCull, cull_pass, |r| {
                cluster_cull::record(r);
                if r.culling {
                    occlusion::record(r);
                }
            });
            for step in 0..1 + usize::from(two_steps) {
                let form = |buffers: &Buffers| form(buffers, step);
                if raster == Raster::Hardware {
                    passes.draw(Stage::RasterSmall, cull_pass, List::Small, form);
                } else {
                    passes.run(Stage::RasterSmall, cull_pass, |r| {
                        if let Some(words) = form(r.buffers) {
                            raster_small::record(r, words, &r.buffers.words);
                        }
                    });
                }
                let mut rest = List::Large;
                if raster != Raster::Compute {
                    passes.draw(Stage::RasterLarge, cull_pass, List::Large, form);
                    rest = List::Clipped;
                }
                passes.run(Stage::RasterLarge, cull_pass, |r| {
                    if let Some(words) = form(r.buffers) {
                        raster_large::record(r, rest, words, &r.buffers.words);
                        raster_large::record_alpha_tested(r, words, &r.buffers.words);
                    }
                });
            }
            // The visible list is that of this pass now, and not later.
            if passes.make(|output| output == Output::Overdraw) {
                passes.run(Stage::Output, cull_pass, output::count);
            }
            if submitted.iter().any(|submitted_view| submitted_view.culling) {
                passes.run(Stage::Hzb, cull_pass, |r| {
                    if r.culling {
                        hzb::record(r);
                    }
                });
            }
        }
        if submitted.iter().any(|submitted_view| submitted_view.buffers.shape.stays_on_device) {
            passes.run(Stage::Output, CullPass::First, output::record_covered);
        }
        if !ways.waits {
            passes.make_arrays();
        }
        let passes = passes.passes;
        times.resolve(&mut encoder, passes.len() as u32);
        submitted.iter().for_each(|submitted_view| submitted_view.buffers.copy_back(&mut encoder));
        let submission = context.start(encoder)?;
        let faces = self.instances.faces();
        let (mut drawn, mut lengths) = (Vec::with_capacity(submitted.len()), Room::default());
        for (SubmittedView { buffers, .. }, request) in submitted.iter().zip(requests) {
            context.read(submission.clone(), &buffers.staging, buffers.staged, |staged| {
                let (own, wanted) = report(
                    &buffers.split(staged),
                    buffers.shape,
                    &passes,
                    context.tick(),
                    faces,
                    request.words,
                );
                lengths = lengths.grown(wanted);
                drawn.push(own);
            })?;
        }
        // They are of all views together, and come with the first.
        if let Some((first, others)) = drawn.split_first_mut() {
            others.iter_mut().for_each(|other| other.times.clone_from(&first.times));
        }
        Ok((drawn, lengths))
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

/// What passes took, by the ticks that came back.
fn stage_times(passes: &[(Stage, CullPass)], ticks: &[u8], tick: Option<f64>) -> StageTimes {
    let times = passes.iter().zip(times::milliseconds(ticks, tick));
    times.map(|((stage, cull_pass), ms)| (*stage, *cull_pass, ms)).collect()
}

/// Reads what came back: the frame, and the lengths that its lists wanted. `faces` are those of each slot's mesh.
fn report(
    parts: &[Vec<&[u8]>],
    shape: Shape,
    passes: &[(Stage, CullPass)],
    tick: Option<f64>,
    faces: &[u64],
    words: &mut [u32],
) -> (Drawn, Room) {
    let (mut drawn, mut wanted) = <(Drawn, Room)>::default();
    // Of both passes where the second listed any, else of the first.
    let (mut visible, mut listed) = (&[][..], 0);
    let mut on_screen = vec![false; faces.len()];
    for (number, parts) in parts.iter().enumerate() {
        if number == 0 {
            let [ticks, pixels, list, asked, arrays @ ..] = &parts[..] else { continue };
            drawn.wanted = self::list(asked, shape.pages);
            if !shape.stays_on_device {
                let words: &mut [u8] = bytemuck::cast_slice_mut(words);
                let parts = words.par_chunks_mut(COPIED_AT_ONCE).zip(pixels.par_chunks(COPIED_AT_ONCE));
                parts.for_each(|(words, pixels)| words.copy_from_slice(pixels));
            }
            visible = list;
            let here = |output: &Output| !shape.waits || *output == Output::Overdraw;
            let arrays = shape.outputs.iter().filter(here).zip(arrays);
            let pixels = shape.pixels as usize;
            drawn.made = arrays.map(|(output, bytes)| (output, Array::read(output, pixels, bytes))).collect();
            drawn.times = stage_times(passes, ticks, tick);
            continue;
        }
        let [candidates, counters, culling, draws, starts, even, odd] = &parts[..] else { continue };
        let counters: Counters = value(counters);
        let groups = value::<Dispatch>(culling).count;
        if shape.groups_come_back {
            drawn.groups = list(candidates, groups);
        }
        let draws = list::<Dispatch>(draws, List::COUNT);
        let levels = Levels::read(even, odd, shape.depth);
        let of_levels = |of: fn(&Dispatch) -> u32| levels.iter().map(|level| u64::from(of(level))).sum();
        let visited: u64 = of_levels(|level| level.count);
        // The second pass starts anywhere; what it starts at a root is an instance that the first did not walk.
        let mut roots = 0;
        for item in list::<TraversalItem>(starts, levels[0].count).into_iter().filter(|item| item.node == 0) {
            let slot = item.instance as usize;
            drawn.roots.push(item.instance);
            roots += 1;
            if on_screen.get_mut(slot).is_some_and(|met| !std::mem::replace(met, true)) {
                drawn.source_triangles += faces[slot];
            }
        }
        if counters.visible > 0 {
            listed = counters.visible;
        }
        drawn.cull_passes.push(Counted {
            starts: u64::from(levels[0].count),
            visited: visited + of_levels(|level| level.visited),
            groups: u64::from(groups),
            clusters: draws.iter().map(|draw| u64::from(draw.count)).sum(),
            // The first pass defers them.
            hidden_instances: match number {
                1 => 0,
                _ => u64::saturating_sub(roots, of_levels(|level| level.unhidden)),
            },
            counters,
        });
        // The first list is that of the instances, which has room for all.
        let items = levels.iter().skip(usize::from(number == 1)).map(|level| level.count);
        wanted.items = items.fold(wanted.items, u32::max);
        wanted.candidate_groups = wanted.candidate_groups.max(groups);
        wanted.visible = wanted.visible.max(counters.visible);
    }
    drawn.visible = list(visible, listed);
    (drawn, wanted)
}
