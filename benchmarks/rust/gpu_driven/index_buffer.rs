//! A compacted index buffer and one draw of it, beside the rasterizer of the visible cluster list.
//!
//! Haar and Aaltonen, "GPU-Driven Rendering Pipelines" (SIGGRAPH 2015): triangles of clusters that culling leaves are tested
//! one by one, the indices of what stays go into one buffer, and one draw takes that. Their places come from atomics there;
//! here from prefix sums over the visible list, so that the buffer is the same in every run.
//!
//! A triangle takes two words: the number of its cluster and its own, as in the visibility buffer, and three corners of eight
//! bits. Indices as a device wants them, three words and something that leads to the instance, take twice as much. What stays
//! faces the eye, has an area and a pixel centre in its box. Rasterizing it is `src/cpu/raster_small.rs`, triangle by triangle,
//! bit for bit; vertices of a cluster are transformed once for the tests and once for the draw.

use nanite_rs::cpu::lanes::{LANES, Lanes};
use nanite_rs::cpu::triangle::{UNIT, VERTICES, edge_bias, homogeneous_rows, pixels, snap};
use nanite_rs::cpu::visibility::Sink;
use nanite_rs::limits::TRIANGLE_BITS;
use nanite_rs::model::packing::Positions;
use nanite_rs::views::{InstanceView, Screen, Visible, payload};
use rayon::prelude::*;

/// Clusters per task of the tests, as of the rasterizer.
const CLUSTERS_PER_TASK: usize = 8;
/// Triangles per task of the draw.
const TRIANGLES_PER_TASK: usize = 1024;

/// Cluster and triangle; corners.
pub type Entry = [u32; 2];

/// What both steps look at.
#[derive(Clone, Copy)]
pub struct Seen<'a> {
    pub visible: &'a [Visible],
    pub views: &'a [InstanceView],
    pub screen: &'a Screen,
}

/// The vertices of a cluster on the screen, snapped: in pixels and in units.
struct Vertices {
    x: [f32; VERTICES],
    y: [f32; VERTICES],
    value: [f32; VERTICES],
    snapped: [[i32; 2]; VERTICES],
}

impl Vertices {
    const NONE: Self =
        Self { x: [0.0; VERTICES], y: [0.0; VERTICES], value: [0.0; VERTICES], snapped: [[0; 2]; VERTICES] };

    #[inline(always)]
    fn transform(&mut self, positions: Positions<'_>, rows: &[[f32; 4]; 3], screen: &Screen) {
        homogeneous_rows(positions, rows, |at, h| {
            let r = Lanes::splat(1.0) / h[2];
            let h = [h[0] * r, h[1] * r, r * screen.near];
            self.value[at..at + LANES].copy_from_slice(&h[2].0);
            for lane in 0..LANES {
                let (x, y) = (snap(h[0].0[lane]), snap(h[1].0[lane]));
                self.snapped[at + lane] = [x, y];
                self.x[at + lane] = x as f32 * (1.0 / UNIT as f32);
                self.y[at + lane] = y as f32 * (1.0 / UNIT as f32);
            }
        });
    }
}

/// Makes the buffer of clusters given as numbers in the visible list, ascending.
pub fn compact(numbers: &[u32], seen: Seen<'_>, buffer: &mut Vec<Entry>) {
    // One bit for each triangle that stays.
    let mut kept = vec![0u128; numbers.len()];
    let chunks = kept.par_chunks_mut(CLUSTERS_PER_TASK).zip(numbers.par_chunks(CLUSTERS_PER_TASK));
    chunks.for_each(|(kept, numbers)| test_chunk(numbers, seen, kept));
    // Prefix sums: every chunk gets the part of the buffer that its triangles fill.
    let total: usize = kept.iter().map(|bits| bits.count_ones() as usize).sum();
    buffer.resize(total, [0; 2]);
    let mut rest = &mut buffer[..];
    let mut parts = Vec::with_capacity(numbers.len() / CLUSTERS_PER_TASK + 1);
    for (kept, numbers) in kept.chunks(CLUSTERS_PER_TASK).zip(numbers.chunks(CLUSTERS_PER_TASK)) {
        let (part, after) = rest.split_at_mut(kept.iter().map(|bits| bits.count_ones() as usize).sum());
        parts.push((kept, numbers, part));
        rest = after;
    }
    parts.into_par_iter().for_each(|(kept, numbers, part)| write(kept, numbers, seen, part));
}

fn write(kept: &[u128], numbers: &[u32], seen: Seen<'_>, part: &mut [Entry]) {
    let mut entries = part.iter_mut();
    for (&bits, &number) in kept.iter().zip(numbers) {
        let at = seen.visible[number as usize];
        let triangles = seen.views[at.instance as usize].cluster(at.cluster).triangles;
        let mut left = bits;
        while left != 0 {
            let triangle = left.trailing_zeros();
            left &= left - 1;
            let [a, b, c] = triangles.get(triangle as usize).map(u32::from);
            let entry = entries.next().expect("as many as were counted");
            *entry = [number << TRIANGLE_BITS | triangle, a | b << 8 | c << 16];
        }
    }
}

/// Draws the buffer.
pub fn draw<S: Sink>(buffer: &[Entry], seen: Seen<'_>, sink: &S) {
    buffer.par_chunks(TRIANGLES_PER_TASK).for_each(|entries| draw_chunk(entries, seen, sink));
}

fn test_chunk(numbers: &[u32], seen: Seen<'_>, kept: &mut [u128]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
        // SAFETY: the processor has AVX2 and BMI2.
        return unsafe { test_chunk_avx2(numbers, seen, kept) };
    }
    test_chunk_anywhere(numbers, seen, kept);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi2")]
fn test_chunk_avx2(numbers: &[u32], seen: Seen<'_>, kept: &mut [u128]) {
    test_chunk_anywhere(numbers, seen, kept);
}

#[inline(always)]
fn test_chunk_anywhere(numbers: &[u32], seen: Seen<'_>, kept: &mut [u128]) {
    let mut vertices = Vertices::NONE;
    for (&number, kept) in numbers.iter().zip(kept) {
        let at = seen.visible[number as usize];
        let view = &seen.views[at.instance as usize];
        let geometry = view.cluster(at.cluster);
        vertices.transform(geometry.positions, &view.screen, seen.screen);
        for (t, corners) in geometry.triangles.iter().enumerate() {
            let stays = facing(&vertices, corners, view.mirrored, seen.screen).is_some();
            *kept |= u128::from(stays) << t;
        }
    }
}

fn draw_chunk<S: Sink>(entries: &[Entry], seen: Seen<'_>, sink: &S) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
        // SAFETY: the processor has AVX2 and BMI2.
        return unsafe { draw_chunk_avx2(entries, seen, sink) };
    }
    draw_chunk_anywhere(entries, seen, sink);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi2")]
fn draw_chunk_avx2<S: Sink>(entries: &[Entry], seen: Seen<'_>, sink: &S) {
    draw_chunk_anywhere(entries, seen, sink);
}

#[inline(always)]
fn draw_chunk_anywhere<S: Sink>(entries: &[Entry], seen: Seen<'_>, sink: &S) {
    let mut vertices = Vertices::NONE;
    let (mut transformed, mut mirrored) = (u32::MAX, false);
    for &[low, corners] in entries {
        let (number, triangle) = (low >> TRIANGLE_BITS, low & ((1 << TRIANGLE_BITS) - 1));
        if number != transformed {
            let at = seen.visible[number as usize];
            let view = &seen.views[at.instance as usize];
            vertices.transform(view.cluster(at.cluster).positions, &view.screen, seen.screen);
            (transformed, mirrored) = (number, view.mirrored);
        }
        let corners = [0, 8, 16].map(|shift| (corners >> shift) as u8);
        if let Some(bounded) = facing(&vertices, corners, mirrored, seen.screen) {
            fill(&vertices, &bounded, payload(number as usize) - triangle, seen.screen, sink);
        }
    }
}

/// A triangle with the inside on the right of every edge, and the pixels of its box.
struct Bounded {
    corners: [usize; 3],
    left: i32,
    top: i32,
    right: i32,
    bottom: i32,
}

/// What is left of a single-sided triangle.
#[inline(always)]
fn facing(vertices: &Vertices, [a, b, c]: [u8; 3], mirrored: bool, screen: &Screen) -> Option<Bounded> {
    let (a, mut b, mut c) = (usize::from(a), usize::from(b), usize::from(c));
    if !mirrored {
        (b, c) = (c, b);
    }
    let [[x0, y0], [x1, y1], [x2, y2]] = [a, b, c].map(|v| vertices.snapped[v]);
    let (left, right) = pixels(x0.min(x1).min(x2), x0.max(x1).max(x2));
    let (top, bottom) = pixels(y0.min(y1).min(y2), y0.max(y1).max(y2));
    let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
    if left > right || top > bottom || area <= 0 {
        return None;
    }
    let (left, top) = (left.max(0), top.max(0));
    let (right, bottom) = (right.min(screen.width as i32 - 1), bottom.min(screen.height as i32 - 1));
    (left <= right && top <= bottom).then_some(Bounded { corners: [a, b, c], left, top, right, bottom })
}

#[inline(always)]
fn fill<S: Sink>(vertices: &Vertices, bounded: &Bounded, low: u32, screen: &Screen, sink: &S) {
    let &Bounded { corners, left, top, right, bottom } = bounded;
    let [p0, p1, p2] = corners.map(|v| vertices.snapped[v]);
    let edges = [edge(p1, p2, left, top), edge(p2, p0, left, top), edge(p0, p1, left, top)];
    let plane = Plane::new(vertices, corners, left, top);
    let [mut row0, mut row1, mut row2] = edges.map(|e| e[0]);
    for j in 0..=bottom - top {
        let (mut at0, mut at1, mut at2) = (row0, row1, row2);
        let start = screen.pixel_address(left as usize, (top + j) as usize);
        for i in 0..=right - left {
            if at0 | at1 | at2 >= 0 {
                let key = plane.at(i as f32, j as f32).to_bits();
                sink.put(start + i as usize, u64::from(key) << 32 | u64::from(low));
            }
            at0 = at0.wrapping_add(edges[0][1]);
            at1 = at1.wrapping_add(edges[1][1]);
            at2 = at2.wrapping_add(edges[2][1]);
        }
        row0 = row0.wrapping_add(edges[0][2]);
        row1 = row1.wrapping_add(edges[1][2]);
        row2 = row2.wrapping_add(edges[2][2]);
    }
}

/// An edge function at the centre of a pixel, and its steps right and down.
#[inline(always)]
fn edge([ax, ay]: [i32; 2], [bx, by]: [i32; 2], left: i32, top: i32) -> [i32; 3] {
    let (dx, dy) = (bx - ax, by - ay);
    let (px, py) = (left * UNIT + UNIT / 2, top * UNIT + UNIT / 2);
    [dx * (py - ay) - dy * (px - ax) + edge_bias(dx, dy), -dy * UNIT, dx * UNIT]
}

/// The depth value as a function of the pixel.
struct Plane {
    start: f32,
    dx: f32,
    dy: f32,
    low: f32,
    high: f32,
}

impl Plane {
    #[inline(always)]
    fn new(vertices: &Vertices, [a, b, c]: [usize; 3], left: i32, top: i32) -> Self {
        let (x, y, v) = (&vertices.x, &vertices.y, &vertices.value);
        let (x1, y1, v1) = (x[b] - x[a], y[b] - y[a], v[b] - v[a]);
        let (x2, y2, v2) = (x[c] - x[a], y[c] - y[a], v[c] - v[a]);
        let determinant = x1 * y2 - x2 * y1;
        let inverse = if determinant == 0.0 { 0.0 } else { 1.0 / determinant };
        let dx = (v1 * y2 - v2 * y1) * inverse;
        let dy = (v2 * x1 - v1 * x2) * inverse;
        let start = v[a] + (left as f32 + 0.5 - x[a]) * dx + (top as f32 + 0.5 - y[a]) * dy;
        Self { start, dx, dy, low: least(least(v[a], v[b]), v[c]), high: most(most(v[a], v[b]), v[c]) }
    }

    #[inline(always)]
    fn at(&self, i: f32, j: f32) -> f32 {
        least(most(self.start + i * self.dx + j * self.dy, self.low), self.high)
    }
}

#[inline(always)]
fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}
