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

    /// The corners of a triangle.
    pub fn triangle(&self, t: u32) -> [[f32; 3]; 3] {
        self.triangles[t as usize]
    }

    /// The triangle nearest to a point, looked for around triangle `near` first; `near` where there is none, or the
    /// point is not finite.
    pub fn nearest(&self, p: [f32; 3], near: u32) -> u32 {
        self.nearest_where(p, near, |_, _| true).unwrap_or(near)
    }

    /// The same of the triangles that `fits`; `None` where there is none, or the point is not finite.
    #[inline]
    pub fn nearest_where(
        &self,
        p: [f32; 3],
        near: u32,
        fits: impl Fn(u32, &[[f32; 3]; 3]) -> bool,
    ) -> Option<u32> {
        let mut nearest = None;
        let mut best = f32::INFINITY;
        if let Some(triangle) = self.triangles.get(near as usize).filter(|triangle| fits(near, triangle)) {
            let distance = squared_distance(p, *triangle);
            if distance < best {
                (best, nearest) = (distance, Some(near));
            }
        }
        let mut stack = [(0u32, 0.0f32); 64];
        let mut top = 1;
        stack[0] = (0, squared_to_box(p, &self.boxes[0]));
        while top > 0 {
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
                    if distance < best && fits(t as u32, triangle) {
                        (best, nearest) = (distance, Some(t as u32));
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
        nearest
    }
}
