//! Which rasterizers of a device are the fastest: a batch of small triangles and one of large ones are drawn by each and
//! timed. How many of each a frame draws differs, but not which rasterizer is the faster at either.
//!
//! A device may cover other pixels than we do: one that rounds corners to fewer bits, or whose compilers fuse other
//! operations in vertex shaders than in compute. Triangles of two rasterizers would then not meet. So each has to draw
//! the very same words as compute, or it is not taken.

use std::time::Instant;

use pollster::block_on;
use wgpu::{Buffer, BufferUsages, CommandEncoder, ComputePassDescriptor, ErrorFilter};

use super::context::{Context, unavailable};
use super::kernel::{Bindings, BoundBuffer, bind};
use super::lists::List;
use super::raster::{OneView, Onto, RasterBindings, Words};
use super::raster_hardware::{Draw, Target, raster_hardware, viewport};
use super::raster_large::raster_large;
use super::raster_small::raster_small;
use super::times::{self, Times};
use crate::config::{Calibration, Raster};
use crate::error::Result;
use crate::gpu_types::{Counters, Dispatch, DrawArgs, Instance, View, VisibleCluster};
use crate::limits::CLUSTER_MAX_TRIANGLES;
use crate::model::cluster::RECORD_WORDS;
use crate::model::packing::{VertexRow, vertex_row, write_triangles};
use crate::model::{AttributeLayout, ClusterRecord, Packing};

/// Side of the picture, pixels.
const SIDE: u32 = 512;
/// The batches, and about how long their edges are, pixels.
const BATCHES: [(List, f32); 2] = [(List::Small, 5.0), (List::Large, 24.0)];
/// Clusters of a batch: the first number, at which compute takes long enough to be measured, milliseconds, or the last.
const CLUSTERS: [u32; 4] = [8, 8 << 2, 8 << 4, 8 << 6];
const LONG: f64 = 0.5;
/// As many there are, and as many times are given for.
const MOST: u32 = CLUSTERS[CLUSTERS.len() - 1];
/// Each is drawn so often, the first time to warm up; the fastest counts.
const RUNS: usize = 4;
/// What another form than compute has to gain.
const GAIN: f64 = 1.1;

/// Quads of a cluster along each side.
const QUADS: usize = (CLUSTER_MAX_TRIANGLES / 2).isqrt();
const _: () = assert!(2 * QUADS * QUADS == CLUSTER_MAX_TRIANGLES);

/// Which rasterizers draw a picture of a size.
pub(super) fn choose(context: &Context, asked: Raster, size: (u32, u32)) -> Result<Raster> {
    let fits = viewport(context.limits().max_texture_dimension_2d, size).is_some();
    match asked {
        Raster::Measured if fits => Ok(context.calibrated(run).raster),
        Raster::Auto | Raster::Compute | Raster::Measured => Ok(Raster::Compute),
        Raster::Hybrid | Raster::Hardware => {
            let (width, height) = size;
            let large = (!fits).then(|| format!("pictures of {width} × {height} are too large for it"));
            match context.raster_obstacle().map(str::to_owned).or(large) {
                None => Ok(asked),
                Some(reason) => {
                    let (name, raster) = (context.name(), asked.name());
                    Err(unavailable(format!("{name} cannot draw with raster {raster:?}: {reason}")))
                }
            }
        }
    }
}

/// Measures; whatever fails, compute is what remains.
fn run(context: &Context) -> Calibration {
    let compute = |reason: String| Calibration { raster: Raster::Compute, times: Vec::new(), reason };
    if let Some(obstacle) = context.raster_obstacle() {
        return compute(format!("the device's rasterizer cannot be used: {obstacle}"));
    }
    let filters = [ErrorFilter::Validation, ErrorFilter::OutOfMemory, ErrorFilter::Internal];
    let scopes = filters.map(|filter| context.device().push_error_scope(filter));
    let measured = measure(context);
    // The last one opened is the first to be closed.
    let errors = scopes.into_iter().rev().filter_map(|scope| block_on(scope.pop())).last();
    match (measured, errors) {
        (Err(error), _) => compute(format!("measuring failed: {error}")),
        (_, Some(error)) => compute(format!("measuring failed: {error}")),
        (Ok(found), None) => decide(&found),
    }
}

/// Of the small batch and of the large one: milliseconds of [`MOST`] clusters in compute and by the device's rasterizer,
/// and whether the pictures are equal.
type Found = [(f64, f64, bool); 2];

fn decide(&[small, large]: &Found) -> Calibration {
    let mut times = vec![(Raster::Compute, small.0 + large.0)];
    if large.2 {
        times.push((Raster::Hybrid, small.0 + large.1));
        if small.2 {
            times.push((Raster::Hardware, small.1 + large.1));
        }
    }
    let mut best = (Raster::Compute, times[0].1 / GAIN);
    best = times[1..].iter().fold(best, |best, form| if form.1 < best.1 { *form } else { best });
    let reason = match (best.0, times.len()) {
        (Raster::Compute, 1) => "the device's rasterizer covers other pixels",
        (Raster::Compute, _) => "no other form is faster by a tenth",
        _ => "the fastest form",
    };
    Calibration { raster: best.0, times, reason: reason.to_owned() }
}

/// What is drawn with: as in a frame, but written by hand.
struct Stand<'a> {
    context: &'a Context,
    /// Without the hardware rasterizer, and with it.
    views: [Buffer; 2],
    instances: Buffer,
    page_offsets: Buffer,
    page: Buffer,
    visible: Buffer,
    numbers: Buffer,
    draws: Buffer,
    draw_args: Buffer,
    pixels: Buffer,
    counters: Buffer,
    target: Target,
    times: Times,
    staging: Buffer,
    words: Words,
}

fn measure(context: &Context) -> Result<Found> {
    let stand = Stand::new(context)?;
    let mut found: Found = Default::default();
    for (found, (list, _)) in found.iter_mut().zip(BATCHES) {
        for clusters in CLUSTERS {
            let (compute, hardware, equal) = stand.compare(list, clusters)?;
            if compute >= LONG || clusters == MOST {
                let all = f64::from(MOST / clusters);
                *found = (all * compute, all * hardware, equal);
                break;
            }
        }
    }
    Ok(found)
}

impl<'a> Stand<'a> {
    fn new(context: &'a Context) -> Result<Self> {
        let target = Target::new(context, (SIDE, SIDE))?;
        let usage = BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let make = |data: &[u8], usage| -> Result<Buffer> {
            let buffer = context.buffer("calibration", data.len() as u64, usage)?;
            context.queue().write_buffer(&buffer, 0, data);
            Ok(buffer)
        };
        let storage = |data: &[u8]| make(data, usage | BufferUsages::STORAGE | BufferUsages::INDIRECT);
        let view = |viewport| {
            let (width, height, near, far) = (SIDE, SIDE, 0.1, f32::INFINITY);
            let view = View { width, height, near, far, viewport, ..bytemuck::Zeroable::zeroed() };
            make(bytemuck::bytes_of(&view), usage | BufferUsages::UNIFORM)
        };
        let instances = instances();
        let count = instances.len() as u32;
        let visible = |instance| VisibleCluster { instance, cluster: 0, large: 0 };
        let staging = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        Ok(Self {
            context,
            views: [view(0)?, view(target.viewport())?],
            instances: storage(bytemuck::cast_slice(&instances))?,
            page_offsets: storage(bytemuck::bytes_of(&0u32))?,
            page: storage(bytemuck::cast_slice(&page()))?,
            visible: storage(bytemuck::cast_slice(&(0..count).map(visible).collect::<Vec<_>>()))?,
            // Small ones from the front, large ones from the back, then room for clipped ones.
            numbers: storage(bytemuck::cast_slice(&(0..2 * count).collect::<Vec<_>>()))?,
            draws: storage(bytemuck::cast_slice(&dispatches(0)))?,
            draw_args: storage(bytemuck::cast_slice(&draw_args(0)))?,
            pixels: context.buffer("calibration", PIXEL_BYTES, usage | BufferUsages::STORAGE)?,
            counters: storage(bytemuck::bytes_of(&Counters::default()))?,
            target,
            times: Times::new(context)?,
            staging: context.buffer("calibration", Times::BYTES + PIXEL_BYTES, staging)?,
            words: if context.int64_atomics() { Words::Int64 } else { Words::Keys },
        })
    }

    fn bindings(&self, hardware: bool) -> Vec<BoundBuffer<'_>> {
        let bindings = bind!(RasterBindings {
            instances: &self.instances,
            page_offsets: &self.page_offsets,
            pages: &self.page,
            visible: &self.visible,
            draws: &self.draws,
            words: &self.pixels,
            counters: &self.counters,
            pages_1: &self.page,
            pages_2: &self.page,
            pages_3: &self.page,
        });
        let view = bind!(OneView { view: &self.views[usize::from(hardware)], numbers: &self.numbers });
        [bindings.buffers(), view.buffers()].concat()
    }

    /// Draws so many clusters of a batch in compute and by the device's rasterizer, in alternation: milliseconds of the fastest
    /// of each, and whether all pictures are equal.
    fn compare(&self, list: List, clusters: u32) -> Result<(f64, f64, bool)> {
        let queue = self.context.queue();
        queue.write_buffer(&self.draws, 0, bytemuck::cast_slice(&dispatches(clusters)));
        queue.write_buffer(&self.draw_args, 0, bytemuck::cast_slice(&draw_args(clusters)));
        let mut best = (f64::INFINITY, f64::INFINITY, true);
        for run in 0..RUNS {
            let (compute, hardware) = (self.draw(list, false)?, self.draw(list, true)?);
            best.2 &= compute.1 == hardware.1;
            if run > 0 {
                (best.0, best.1) = (best.0.min(compute.0), best.1.min(hardware.0));
            }
        }
        Ok(best)
    }

    /// Milliseconds, and the words of the picture.
    fn draw(&self, list: List, hardware: bool) -> Result<(f64, Vec<u64>)> {
        let mut words = vec![0; (SIDE * SIDE) as usize];
        let mut encoder = self.context.encoder("calibration");
        encoder.clear_buffer(&self.pixels, 0, None);
        if hardware {
            self.record_hardware(&mut encoder, list);
        } else {
            self.record_compute(&mut encoder, list);
        }
        self.times.resolve(&mut encoder, 1);
        encoder.copy_buffer_to_buffer(self.times.ticks(), 0, &self.staging, 0, Times::BYTES);
        encoder.copy_buffer_to_buffer(&self.pixels, 0, &self.staging, Times::BYTES, PIXEL_BYTES);
        let (start, mut ms) = (Instant::now(), f64::NAN);
        self.context.submit(encoder, &self.staging, Times::BYTES + PIXEL_BYTES, |bytes| {
            let (ticks, pixels) = bytes.split_at(Times::BYTES as usize);
            ms = times::milliseconds(ticks, self.context.tick()).next().unwrap_or(f64::NAN);
            bytemuck::cast_slice_mut(&mut words).copy_from_slice(pixels);
        })?;
        let wall = start.elapsed().as_secs_f64() * 1e3;
        Ok((if ms.is_nan() { wall } else { ms }, words))
    }

    fn record_compute(&self, encoder: &mut CommandEncoder, list: List) {
        let kernel = match list {
            List::Small => raster_small(Onto::Picture, self.words),
            _ => raster_large(Onto::Picture, self.words),
        };
        let timestamp_writes = self.times.of_pass(0);
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor { label: None, timestamp_writes });
        pass.set_pipeline(&self.context.pipeline(kernel, false));
        pass.set_bind_group(0, &self.context.bind(kernel, &self.bindings(false)), &[]);
        pass.dispatch_workgroups_indirect(&self.draws, list as u64 * size_of::<Dispatch>() as u64);
    }

    fn record_hardware(&self, encoder: &mut CommandEncoder, list: List) {
        let draw = Draw {
            list,
            words: self.words,
            split: false,
            group: self.context.bind(raster_hardware(list, self.words), &self.bindings(true)),
            draw_args: (&self.draw_args).into(),
            target: &self.target,
            times: self.times.of_draw(0, true, true),
        };
        draw.record(self.context, encoder);
    }
}

/// So many clusters of each list.
fn dispatches(count: u32) -> [Dispatch; List::COUNT as usize] {
    [Dispatch { x: count, y: 1, z: 1, count, ..Dispatch::default() }; List::COUNT as usize]
}

/// The same as draws.
fn draw_args(instances: u32) -> [DrawArgs; List::COUNT as usize] {
    let vertices = 3 * CLUSTER_MAX_TRIANGLES as u32;
    [DrawArgs { vertices, instances, first_vertex: 0, first_instance: 0 }; List::COUNT as usize]
}

/// Bytes of the picture.
const PIXEL_BYTES: u64 = SIDE as u64 * SIDE as u64 * size_of::<u64>() as u64;

/// Turned and strewn over the picture, each at a distance of its own, so that pixels do not depend on rounding of depths.
fn instances() -> Vec<Instance> {
    let mut seed = 1u32;
    let mut random = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) as f32 / (1 << 24) as f32
    };
    let edges = BATCHES.iter().flat_map(|(_, edge)| (0..MOST).map(move |_| *edge));
    edges
        .zip(0u16..)
        .map(|(edge, number)| {
            let distance = 1.0 + 0.01 * f32::from(number);
            let (sin, cos) = (6.3 * random()).sin_cos();
            let edge = edge * (0.8 + 0.4 * random());
            let half = 0.5 * QUADS as f32;
            let [x, y] = [(cos, -sin), (sin, cos)].map(|(u, v)| {
                let middle = SIDE as f32 * random() - edge * half * (u + v);
                [edge * u, edge * v, 0.0, middle].map(|value| value * distance)
            });
            let screen = [x, y, [0.0, 0.0, 0.0, distance]];
            Instance { screen, double_sided: 1, ..bytemuck::Zeroable::zeroed() }
        })
        .collect()
}

/// A page of one cluster: a flat square of quads.
fn page() -> Vec<u32> {
    let row = QUADS + 1;
    let record = ClusterRecord {
        vertex_count: (row * row) as u8,
        triangle_count: CLUSTER_MAX_TRIANGLES as u8,
        data: RECORD_WORDS as u32,
        ..bytemuck::Zeroable::zeroed()
    };
    let vertices: Vec<VertexRow> =
        (0..row * row).map(|v| vertex_row([(v % row) as f32, (v / row) as f32, 0.0], 0, 1.0)).collect();
    let packing = Packing::of(&vertices, 1.0);
    let streams = AttributeLayout::default().streams(row * row, CLUSTER_MAX_TRIANGLES, packing.widths);
    let corners = (0..QUADS * QUADS).flat_map(|quad| {
        let first = quad / QUADS * row + quad % QUADS;
        let corners = [[first, first + 1, first + row + 1], [first, first + row + 1, first + row]];
        corners.map(|triangle| triangle.map(|v| v as u8))
    });
    let triangles: Vec<[u8; 3]> = corners.collect();
    let mut words: Vec<u32> = bytemuck::cast_slice(&[record]).to_vec();
    words.resize(RECORD_WORDS + streams.end, 0);
    let own = &mut words[RECORD_WORDS..];
    packing.write(&vertices, own);
    write_triangles(&triangles, row * row, &mut own[streams.triangles..]);
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ClusterGeometry;

    #[test]
    fn the_fastest_form_is_taken_if_it_draws_the_same() {
        let raster = |small, large| decide(&[small, large]).raster;
        assert_eq!(raster((1.0, 0.5, true), (1.0, 0.5, true)), Raster::Hardware);
        assert_eq!(raster((1.0, 2.0, true), (1.0, 0.5, true)), Raster::Hybrid);
        assert_eq!(raster((1.0, 2.0, true), (1.0, 1.5, true)), Raster::Compute);
        // Not for little.
        assert_eq!(raster((1.0, 2.0, true), (1.0, 0.9, true)), Raster::Compute);
        // Not where triangles would not meet.
        assert_eq!(raster((1.0, 0.1, false), (1.0, 0.5, true)), Raster::Hybrid);
        let none = decide(&[(1.0, 0.1, true), (1.0, 0.1, false)]);
        assert_eq!((none.raster, none.times.len()), (Raster::Compute, 1));
        assert_eq!(none.reason, "the device's rasterizer covers other pixels");
        let all = decide(&[(1.0, 2.0, true), (3.0, 4.0, true)]);
        assert_eq!(all.times, [(Raster::Compute, 4.0), (Raster::Hybrid, 5.0), (Raster::Hardware, 6.0)]);
    }

    #[test]
    fn the_cluster_is_as_pages_have_it() {
        let words = page();
        let record: &ClusterRecord = bytemuck::from_bytes(bytemuck::cast_slice(&words[..RECORD_WORDS]));
        let (vertices, triangles) = (usize::from(record.vertex_count), usize::from(record.triangle_count));
        assert_eq!(triangles, CLUSTER_MAX_TRIANGLES);
        let layout = AttributeLayout::default();
        let geometry = ClusterGeometry::new(&words[RECORD_WORDS..], layout, vertices, triangles);
        assert!(geometry.triangles.iter().flatten().all(|corner| usize::from(corner) < vertices));
        assert_eq!(geometry.corners(127), [[7.0, 7.0, 0.0], [8.0, 8.0, 0.0], [7.0, 8.0, 0.0]]);
    }
}
