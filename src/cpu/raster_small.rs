//! Stage 4. Clusters of small triangles, of points and of lines → visibility buffer. One task per handful of clusters; a cluster's
//! vertices are transformed once, then each triangle tests the pixels of its box in 32-bit arithmetic.
//!
//! Depth comes from the plane through the snapped corners, held to their range: at every covered pixel it is a
//! mean of the corners' depths, so even on a surface seen edge-on a pixel lies beside the point it shows.

use rayon::prelude::*;

use super::lanes::{LANES, Lanes};
use super::stroke;
use super::triangle::{UNIT, VERTICES, edge_bias, homogeneous_rows, pixels, snap};
use super::visibility::Sink;
use crate::model::packing::{Positions, Triangles};
use crate::views::{InstanceView, Screen, Visible, payload};

/// Clusters per task.
const CLUSTERS_PER_TASK: usize = 8;

/// The vertices of a cluster on the screen, snapped: in pixels and in units.
struct Vertices {
    x: [f32; VERTICES],
    y: [f32; VERTICES],
    value: [f32; VERTICES],
    snapped: [[i32; 2]; VERTICES],
}

/// What drawing a cluster needs.
struct RasterTask<'a, S> {
    visible: &'a [Visible],
    views: &'a [InstanceView],
    screen: &'a Screen,
    sink: &'a S,
}

/// Draws clusters, given as numbers in the frame's visible list. Returns the triangles that faced the eye and
/// reached a pixel centre's box.
pub fn run<S: Sink>(
    numbers: &[u32],
    visible: &[Visible],
    views: &[InstanceView],
    screen: &Screen,
    sink: &S,
) -> u64 {
    let task = RasterTask { visible, views, screen, sink };
    numbers.par_chunks(CLUSTERS_PER_TASK).map(|chunk| task.draw_chunk(chunk)).sum()
}

impl<S: Sink> RasterTask<'_, S> {
    fn draw_chunk(&self, numbers: &[u32]) -> u64 {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
            // SAFETY: the processor has AVX2 and BMI2.
            return unsafe { self.draw_chunk_avx2(numbers) };
        }
        self.draw_chunk_anywhere(numbers)
    }

    /// The same with 256-bit vectors. No operation fuses, so the result is the same bit for bit.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi2")]
    fn draw_chunk_avx2(&self, numbers: &[u32]) -> u64 {
        self.draw_chunk_anywhere(numbers)
    }

    #[inline(always)]
    fn draw_chunk_anywhere(&self, numbers: &[u32]) -> u64 {
        let mut vertices = Vertices {
            x: [0.0; VERTICES],
            y: [0.0; VERTICES],
            value: [0.0; VERTICES],
            snapped: [[0; 2]; VERTICES],
        };
        let mut drawn = 0;
        for &number in numbers {
            let at = self.visible[number as usize];
            let view = &self.views[at.instance as usize];
            let geometry = view.cluster(at.cluster);
            if let Some(stroke) = &view.stroke {
                let low = payload(number as usize);
                drawn += stroke::draw(&geometry, view, stroke, self.screen, low, self.sink);
                continue;
            }
            transform_rows(geometry.positions, &view.screen, self.screen, &mut vertices);
            let low = payload(number as usize);
            let material = view.pages.record(at.cluster).material;
            let faces = Faces { mirrored: view.mirrored, double_sided: view.double_sided(material) };
            drawn += if self.screen.orthographic {
                draw::<S, true>(geometry.triangles, &vertices, faces, self.screen, low, self.sink)
            } else {
                draw::<S, false>(geometry.triangles, &vertices, faces, self.screen, low, self.sink)
            };
        }
        drawn
    }
}

/// Transforms and snaps vertices, eight at a time: the operations of [`super::triangle::project`] in the same order, so
/// that both rasterizers agree bit for bit.
#[inline(always)]
fn transform_rows(positions: Positions<'_>, rows: &[[f32; 4]; 3], screen: &Screen, out: &mut Vertices) {
    homogeneous_rows(positions, rows, |at, mut h| {
        if !screen.orthographic {
            let r = Lanes::splat(1.0) / h[2];
            h = [h[0] * r, h[1] * r, r * screen.near];
        }
        out.value[at..at + LANES].copy_from_slice(&h[2].0);
        for lane in 0..LANES {
            let (x, y) = (snap(h[0].0[lane]), snap(h[1].0[lane]));
            out.snapped[at + lane] = [x, y];
            out.x[at + lane] = x as f32 * (1.0 / UNIT as f32);
            out.y[at + lane] = y as f32 * (1.0 / UNIT as f32);
        }
    });
}

/// Which faces of a cluster are seen.
#[derive(Clone, Copy)]
struct Faces {
    mirrored: bool,
    double_sided: bool,
}

#[inline(always)]
fn draw<S: Sink, const ORTHOGRAPHIC: bool>(
    triangles: Triangles<'_>,
    vertices: &Vertices,
    faces: Faces,
    screen: &Screen,
    payload: u32,
    sink: &S,
) -> u64 {
    let mut drawn = 0;
    for (t, [a, b, c]) in triangles.iter().enumerate() {
        // Counter-clockwise in the world is clockwise with y down: the inside is on the right of every edge.
        let (a, mut b, mut c) = (usize::from(a), usize::from(b), usize::from(c));
        if !faces.mirrored {
            (b, c) = (c, b);
        }
        let [x0, y0] = vertices.snapped[a];
        let [mut x1, mut y1] = vertices.snapped[b];
        let [mut x2, mut y2] = vertices.snapped[c];
        let (left, right) = pixels(x0.min(x1).min(x2), x0.max(x1).max(x2));
        let (top, bottom) = pixels(y0.min(y1).min(y2), y0.max(y1).max(y2));
        let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
        if left > right || top > bottom || area == 0 {
            continue;
        }
        if area < 0 {
            if !faces.double_sided {
                continue;
            }
            (b, c) = (c, b);
            (x1, y1, x2, y2) = (x2, y2, x1, y1);
        }
        let (left, top) = (left.max(0), top.max(0));
        let (right, bottom) = (right.min(screen.width as i32 - 1), bottom.min(screen.height as i32 - 1));
        if left > right || top > bottom {
            continue;
        }
        drawn += 1;
        let e0 = Edge::new([x1, y1], [x2, y2], left, top);
        let e1 = Edge::new([x2, y2], [x0, y0], left, top);
        let e2 = Edge::new([x0, y0], [x1, y1], left, top);
        let plane = Plane::new(vertices, [a, b, c], left, top);
        let low = u64::from(payload - t as u32);
        let (mut row0, mut row1, mut row2) = (e0.start, e1.start, e2.start);
        for j in 0..=bottom - top {
            let (mut at0, mut at1, mut at2) = (row0, row1, row2);
            let start = screen.pixel_address(left as usize, (top + j) as usize);
            for i in 0..=right - left {
                if at0 | at1 | at2 >= 0 {
                    let value = plane.at(i as f32, j as f32);
                    // [`Screen::key`].
                    let key = if ORTHOGRAPHIC { !most(value, 0.0).to_bits() } else { value.to_bits() };
                    sink.put(start + i as usize, u64::from(key) << 32 | low);
                }
                // The last step may leave the range; nothing reads its result.
                at0 = at0.wrapping_add(e0.step_x);
                at1 = at1.wrapping_add(e1.step_x);
                at2 = at2.wrapping_add(e2.step_x);
            }
            row0 = row0.wrapping_add(e0.step_y);
            row1 = row1.wrapping_add(e1.step_y);
            row2 = row2.wrapping_add(e2.step_y);
        }
    }
    drawn
}

/// An edge function, biased by the top-left rule, from a first pixel.
#[derive(Clone, Copy)]
struct Edge {
    start: i32,
    step_x: i32,
    step_y: i32,
}

impl Edge {
    #[inline(always)]
    fn new([ax, ay]: [i32; 2], [bx, by]: [i32; 2], left: i32, top: i32) -> Self {
        let (dx, dy) = (bx - ax, by - ay);
        let (px, py) = (left * UNIT + UNIT / 2, top * UNIT + UNIT / 2);
        Self {
            start: dx * (py - ay) - dy * (px - ax) + edge_bias(dx, dy),
            step_x: -dy * UNIT,
            step_y: dx * UNIT,
        }
    }
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

    /// The NaN of an overflown plane becomes a corner's value.
    #[inline(always)]
    fn at(&self, i: f32, j: f32) -> f32 {
        least(most(self.start + i * self.dx + j * self.dy, self.low), self.high)
    }
}

/// The larger; `b` where they do not compare: one instruction, unlike `f32::max`.
#[inline(always)]
fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller; `b` where they do not compare.
#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::super::triangle::project;
    use super::*;
    use crate::model::packing::{VertexRow, vertex_row};
    use crate::model::{AttributeLayout, ClusterGeometry, Packing};
    use crate::views::homogeneous;

    #[test]
    fn eight_vertices_are_transformed_as_one() {
        let rows = [[811.3f32, 2.1, 640.7, 1300.1], [-3.3, -809.9, 361.3, 777.7], [0.013, 0.021, 0.997, 2.9]];
        for orthographic in [false, true] {
            let screen =
                Screen { width: 1280, height: 720, orthographic, near: 0.05, far: f32::INFINITY, far_key: 0 };
            let positions: Vec<[f32; 3]> =
                (0..13).map(|i| [i as f32 * 0.071 - 0.4, 0.5 - i as f32 * 0.083, i as f32 * 0.031]).collect();
            let mut out = Vertices {
                x: [0.0; VERTICES],
                y: [0.0; VERTICES],
                value: [0.0; VERTICES],
                snapped: [[0; 2]; VERTICES],
            };
            let vertices: Vec<VertexRow> = positions.iter().map(|p| vertex_row(*p, 0, 0.0)).collect();
            let packing = Packing::of(&vertices, 0.0);
            let streams = AttributeLayout::default().streams(vertices.len(), 1, packing.widths);
            let mut words = vec![0; streams.end];
            packing.write(&vertices, &mut words);
            let geometry = ClusterGeometry::new(&words, AttributeLayout::default(), vertices.len(), 1);
            transform_rows(geometry.positions, &rows, &screen, &mut out);
            for (i, p) in positions.iter().enumerate() {
                let [x, y, value] = project(&screen, homogeneous(&rows, *p));
                assert_eq!((out.snapped[i], out.value[i]), ([snap(x), snap(y)], value));
                assert_eq!([out.x[i], out.y[i]], [snap(x), snap(y)].map(|v| v as f32 / 256.0));
            }
        }
    }
}
