//! A bounding-box tree over triangles in the order given.
//!
//! No sorting: clusters come in spatial order and so do their triangles, so a balanced binary tree over
//! consecutive triangles is nearly as good as a sorted one and costs a single pass.

use super::triangle::squared_distance;
use crate::math::Aabb;

/// Triangles of a leaf.
const LEAF: usize = 2;

/// A tree over triangles.
#[derive(Clone, Debug)]
pub struct TriangleTree {
    triangles: Vec<[[f32; 3]; 3]>,
    /// Heap layout: children of `i` are `2i + 1` and `2i + 2`; the last `leaves` boxes are the leaves.
    boxes: Vec<Aabb>,
    leaves: usize,
}

fn squared_to_box(p: [f32; 3], b: &Aabb) -> f32 {
    (0..3).map(|k| (b.min[k] - p[k]).max(p[k] - b.max[k]).max(0.0)).map(|d| d * d).sum()
}

impl TriangleTree {
    /// A tree over the triangles of an index buffer.
    pub fn new(positions: &[[f32; 3]], indices: &[u32]) -> Self {
        Self::of(indices.chunks_exact(3).map(|t| [0, 1, 2].map(|k| positions[t[k] as usize])).collect())
    }

    /// A tree over triangles; the nearer they are to their neighbours in the list, the better.
    pub fn of(triangles: Vec<[[f32; 3]; 3]>) -> Self {
        let leaves = triangles.len().div_ceil(LEAF).next_power_of_two();
        let mut boxes = vec![Aabb::EMPTY; 2 * leaves - 1];
        for (leaf, group) in triangles.chunks(LEAF).enumerate() {
            boxes[leaves - 1 + leaf] = Aabb::of_points(group.as_flattened());
        }
        for i in (0..leaves - 1).rev() {
            boxes[i] = boxes[2 * i + 1].union(&boxes[2 * i + 2]);
        }
        Self { triangles, boxes, leaves }
    }

    /// Square of the distance to the surface and the nearest triangle, looked for around triangle `near` first.
    /// +∞ without triangles or for a point that is not finite.
    pub fn nearest(&self, p: [f32; 3], near: u32) -> (f32, u32) {
        let best = self.triangles.get(near as usize).map_or(f32::INFINITY, |t| squared_distance(p, *t));
        self.nearest_between(p, f32::NEG_INFINITY, (best, near))
    }

    /// Square of the distance to the surface if it is below `best`, or anything up to `enough` as soon as the
    /// distance is known to be at most that: callers look for a maximum. Otherwise `best`.
    pub fn squared_distance_between(&self, p: [f32; 3], enough: f32, best: f32) -> f32 {
        self.nearest_between(p, enough, (best, 0)).0
    }

    fn nearest_between(&self, p: [f32; 3], enough: f32, found: (f32, u32)) -> (f32, u32) {
        let (mut best, mut nearest) = found;
        let mut stack = [(0u32, 0.0f32); 64];
        let mut top = 1;
        stack[0] = (0, squared_to_box(p, &self.boxes[0]));
        while top > 0 && best > enough {
            top -= 1;
            let (node, distance) = stack[top];
            if distance >= best {
                continue;
            }
            let node = node as usize;
            if node + 1 >= self.leaves {
                let first = (node + 1 - self.leaves) * LEAF;
                for (t, triangle) in self.triangles.iter().enumerate().skip(first).take(LEAF) {
                    let distance = squared_distance(p, *triangle);
                    if distance < best {
                        (best, nearest) = (distance, t as u32);
                    }
                }
                continue;
            }
            let [a, b] = [2 * node + 1, 2 * node + 2].map(|c| (c as u32, squared_to_box(p, &self.boxes[c])));
            let (near, far) = if a.1 <= b.1 { (a, b) } else { (b, a) };
            stack[top] = far;
            stack[top + 1] = near;
            top += 2;
        }
        (best, nearest)
    }

    /// The corners of all triangles.
    pub fn triangles(&self) -> &[[[f32; 3]; 3]] {
        &self.triangles
    }
}
