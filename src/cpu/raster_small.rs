//! Stage 4. Clusters of small triangles → visibility buffer. One task per handful of clusters; a cluster's
//! vertices are transformed once, then each triangle tests the pixels of its box in 32-bit arithmetic.
//!
//! Depth comes from the plane through the snapped corners, held to their range: at every covered pixel it is a
//! mean of the corners' depths, so even on a surface seen edge-on a pixel lies beside the point it shows.

use rayon::prelude::*;

use super::project::{InstanceView, Screen};
use super::triangle::{UNIT, edge_bias, pixels, project, snap};
use super::visibility::{Sink, Visible, payload};
use crate::limits::CLUSTER_MAX_VERTICES;
use crate::model::ClusterGeometry;

/// Longest side, pixels, of a cluster on the screen: with it, products of two snapped differences and their
/// difference fit 32 bits.
pub const MAX_SPAN: u16 = 120;
const _: () = {
    let side = (MAX_SPAN as i64 + 2) * UNIT as i64;
    assert!(2 * side * side < i32::MAX as i64);
};

/// Clusters per task.
const CLUSTERS_PER_TASK: usize = 8;

/// The vertices of a cluster on the screen.
struct Vertices {
    x: [f32; CLUSTER_MAX_VERTICES + 1],
    y: [f32; CLUSTER_MAX_VERTICES + 1],
    value: [f32; CLUSTER_MAX_VERTICES + 1],
    snapped: [[i32; 2]; CLUSTER_MAX_VERTICES + 1],
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
    numbers
        .par_chunks(CLUSTERS_PER_TASK)
        .map(|chunk| {
            let mut vertices = Vertices {
                x: [0.0; CLUSTER_MAX_VERTICES + 1],
                y: [0.0; CLUSTER_MAX_VERTICES + 1],
                value: [0.0; CLUSTER_MAX_VERTICES + 1],
                snapped: [[0; 2]; CLUSTER_MAX_VERTICES + 1],
            };
            let mut drawn = 0;
            for &number in chunk {
                let at = visible[number as usize];
                let view = &views[at.instance as usize];
                let geometry = view.mesh.geometry(at.cluster);
                transform(&geometry, view, screen, &mut vertices);
                drawn += draw(&geometry, &vertices, view, screen, payload(number as usize), sink);
            }
            drawn
        })
        .sum()
}

#[inline]
fn transform(geometry: &ClusterGeometry<'_>, view: &InstanceView, screen: &Screen, out: &mut Vertices) {
    for (i, &p) in geometry.positions.iter().enumerate() {
        let [x, y, value] = project(screen, view.homogeneous(p));
        let [x, y] = [snap(x), snap(y)];
        out.snapped[i] = [x, y];
        (out.x[i], out.y[i], out.value[i]) = (x as f32 / UNIT as f32, y as f32 / UNIT as f32, value);
    }
}

fn draw<S: Sink>(
    geometry: &ClusterGeometry<'_>,
    vertices: &Vertices,
    view: &InstanceView,
    screen: &Screen,
    payload: u32,
    sink: &S,
) -> u64 {
    let mut drawn = 0;
    for (t, &[a, b, c]) in geometry.triangles.iter().enumerate() {
        // Counter-clockwise in the world is clockwise with y down: the inside is on the right of every edge.
        let (a, mut b, mut c) = (usize::from(a), usize::from(b), usize::from(c));
        if !view.mirrored {
            (b, c) = (c, b);
        }
        let [x0, y0] = vertices.snapped[a];
        let [mut x1, mut y1] = vertices.snapped[b];
        let [mut x2, mut y2] = vertices.snapped[c];
        let (left, right) = pixels(x0.min(x1).min(x2), x0.max(x1).max(x2));
        let (top, bottom) = pixels(y0.min(y1).min(y2), y0.max(y1).max(y2));
        if left > right || top > bottom {
            continue;
        }
        let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
        if area <= 0 {
            if area == 0 || !view.material.double_sided {
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
        let edges = [
            Edge::new([x1, y1], [x2, y2], left, top),
            Edge::new([x2, y2], [x0, y0], left, top),
            Edge::new([x0, y0], [x1, y1], left, top),
        ];
        let plane = Plane::new(vertices, [a, b, c], left, top);
        let low = payload - t as u32;
        let word = |value: f32| u64::from(screen.key(value)) << 32 | u64::from(low);
        let width = screen.width as usize;
        let mut row_start = edges.map(|e| e.start);
        let mut pixel_row = top as usize * width + left as usize;
        for j in 0..=bottom - top {
            let mut e = row_start;
            for i in 0..=right - left {
                if e[0] | e[1] | e[2] >= 0 {
                    sink.put(pixel_row + i as usize, word(plane.at(i as f32, j as f32)));
                }
                // The last step may leave the range; nothing reads its result.
                for k in 0..3 {
                    e[k] = e[k].wrapping_add(edges[k].step_x);
                }
            }
            for k in 0..3 {
                row_start[k] = row_start[k].wrapping_add(edges[k].step_y);
            }
            pixel_row += width;
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
        Self { start, dx, dy, low: v[a].min(v[b]).min(v[c]), high: v[a].max(v[b]).max(v[c]) }
    }

    /// `max` and `min` also turn the NaN of an overflown plane into a corner's value.
    #[inline(always)]
    fn at(&self, i: f32, j: f32) -> f32 {
        (self.start + i * self.dx + j * self.dy).max(self.low).min(self.high)
    }
}
