//! Longest-edge bisection (Rivara, "Algorithms for Refining Triangular Grids Suitable for Adaptive and Multigrid
//! Techniques", 1984), where collapses of the finer cut do not meet the budget: the coarser cut gets more triangles
//! without a change of its shape.

use std::collections::BinaryHeap;

use rustc_hash::FxHashMap;

use crate::build::store::LocalMesh;
use crate::math::triangle::area;

/// An edge by its points, and its faces.
type Faces = FxHashMap<(u32, u32), Vec<u32>>;

/// A mesh whose edges are bisected.
struct Bisector {
    mesh: LocalMesh,
    stride: usize,
    /// The point of each vertex: the first one there.
    points: Vec<u32>,
    faces: Faces,
    queue: BinaryHeap<(u32, (u32, u32))>,
}

/// Bisects the longest edges of a mesh until it has `target` triangles, or nearly. Edges between locked points
/// stay. Vertices keep their numbers; new ones follow.
pub fn bisect_to(mesh: &LocalMesh, target: usize) -> LocalMesh {
    let stride = mesh.attributes.len() / mesh.ids.len().max(1);
    let mut bisector = Bisector {
        points: mesh.position_ids.clone(),
        mesh: mesh.clone(),
        stride,
        faces: Faces::default(),
        queue: BinaryHeap::new(),
    };
    for face in 0..mesh.indices.len() as u32 / 3 {
        bisector.enter(face);
    }
    let mut edges: Vec<(u32, u32)> = bisector.faces.keys().copied().collect();
    edges.sort_unstable();
    edges.into_iter().for_each(|edge| bisector.push(edge));
    while let Some((_, edge)) = bisector.queue.pop() {
        let Some(faces) = bisector.faces.get(&edge).filter(|faces| !faces.is_empty()) else { continue };
        let room = target.saturating_sub(bisector.mesh.indices.len() / 3);
        if room == 0 {
            break;
        }
        if faces.len() <= room {
            bisector.halve(edge);
        }
    }
    bisector.fill(target);
    bisector.mesh
}

impl Bisector {
    /// Splits the largest faces at their centres, where no more edges can be bisected.
    fn fill(&mut self, target: usize) {
        let area = |mesh: &LocalMesh, t: &[u32]| area([0, 1, 2].map(|k| mesh.positions[t[k] as usize]));
        while self.mesh.indices.len() / 3 + 2 <= target {
            let faces = self.mesh.indices.chunks_exact(3).map(|t| area(&self.mesh, t)).zip(0u32..);
            let largest = faces.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
            let Some((_, face)) = largest else { return };
            let [a, b, c] = self.corners(face);
            let center = self.vertex([a, b, c], None);
            self.mesh.indices[3 * face as usize..][..3].copy_from_slice(&[a, b, center]);
            self.mesh.indices.extend([b, c, center, c, a, center]);
        }
    }

    fn corners(&self, face: u32) -> [u32; 3] {
        let at = 3 * face as usize;
        [self.mesh.indices[at], self.mesh.indices[at + 1], self.mesh.indices[at + 2]]
    }

    /// An edge of a face by its points.
    fn edge(&self, corners: [u32; 3], k: usize) -> (u32, u32) {
        let [a, b] = [corners[k], corners[(k + 1) % 3]].map(|v| self.points[v as usize]);
        (a.min(b), a.max(b))
    }

    fn enter(&mut self, face: u32) {
        let corners = self.corners(face);
        for k in 0..3 {
            let edge = self.edge(corners, k);
            self.faces.entry(edge).or_default().push(face);
        }
    }

    fn leave(&mut self, face: u32) {
        let corners = self.corners(face);
        for k in 0..3 {
            let edge = self.edge(corners, k);
            self.faces.entry(edge).or_default().retain(|f| *f != face);
        }
    }

    fn push(&mut self, edge: (u32, u32)) {
        let [a, b] = [edge.0, edge.1].map(|p| self.mesh.positions[p as usize]);
        let squared: f32 = (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum();
        let locked = [edge.0, edge.1].iter().all(|p| self.mesh.locked[*p as usize]);
        let between = self.middle([edge.0, edge.1]);
        // A midpoint that rounds onto an end would leave faces without area.
        if !locked && edge.0 != edge.1 && between != a && between != b {
            self.queue.push((squared.to_bits(), edge));
        }
    }

    fn middle<const N: usize>(&self, of: [u32; N]) -> [f32; 3] {
        let sum = |k: usize| of.map(|v| f64::from(self.mesh.positions[v as usize][k])).iter().sum::<f64>();
        std::array::from_fn(|k| (sum(k) / N as f64) as f32 + 0.0)
    }

    /// A vertex between others, at a point that may exist already. It does not depend on the order of the others.
    fn vertex<const N: usize>(&mut self, mut of: [u32; N], point: Option<u32>) -> u32 {
        let new = self.mesh.ids.len() as u32;
        of.sort_unstable();
        let place = self.middle(of);
        let mesh = &mut self.mesh;
        mesh.ids.push(u32::MAX);
        mesh.positions.push(place);
        let value = |v: u32, k: usize| mesh.attributes[v as usize * self.stride + k];
        let mean = |k: usize| of.map(|v| value(v, k)).iter().sum::<f32>() / N as f32;
        let mut row: Vec<f32> = (0..self.stride).map(mean).collect();
        let size = row[..3].iter().map(|x| x * x).sum::<f32>().sqrt();
        if size > 0.0 {
            row[..3].iter_mut().for_each(|x| *x /= size);
        }
        mesh.attributes.extend(row);
        if !mesh.labels.is_empty() {
            mesh.labels.push(mesh.labels[of[0] as usize]);
        }
        if !mesh.materials.is_empty() {
            mesh.materials.push(mesh.materials[of[0] as usize]);
        }
        mesh.locked.push(false);
        let point = point.unwrap_or(new);
        mesh.position_ids.push(point);
        self.points.push(point);
        new
    }

    fn halve(&mut self, edge: (u32, u32)) {
        let faces = self.faces.get(&edge).cloned().unwrap_or_default();
        let mut made: Vec<((u32, u32), u32)> = Vec::new();
        let mut touched = Vec::new();
        for face in faces {
            let corners = self.corners(face);
            let Some(k) = (0..3).find(|k| self.edge(corners, *k) == edge) else { continue };
            let (a, b, c) = (corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]);
            let ends = (a.min(b), a.max(b));
            let middle = match made.iter().find(|(of, _)| *of == ends) {
                Some((_, v)) => *v,
                None => {
                    let point = made.first().map(|(_, v)| *v);
                    let v = self.vertex([a, b], point);
                    made.push((ends, v));
                    v
                }
            };
            self.leave(face);
            let other = self.mesh.indices.len() as u32 / 3;
            self.mesh.indices[3 * face as usize..][..3].copy_from_slice(&[a, middle, c]);
            self.mesh.indices.extend([middle, b, c]);
            for face in [face, other] {
                self.enter(face);
                let corners = self.corners(face);
                touched.extend((0..3).map(|k| self.edge(corners, k)));
            }
        }
        touched.sort_unstable();
        touched.dedup();
        let point = made.first().map_or(0, |(_, v)| *v);
        for edge in touched {
            // Edges from before are in the queue.
            if edge.0 == point || edge.1 == point {
                self.push(edge);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_edges_are_halved_and_nothing_opens() {
        let positions = vec![[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]];
        let mesh = LocalMesh {
            ids: vec![0, 1, 2, 3],
            attributes: positions.iter().flat_map(|_| [0.0, 0.0, 1.0]).collect(),
            positions,
            position_ids: vec![0, 1, 2, 3],
            locked: vec![true, true, false, false],
            indices: vec![0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2],
            ..LocalMesh::default()
        };
        let divided = bisect_to(&mesh, 11);
        assert_eq!(divided.indices.len() / 3, 10, "two at a time, and never more");
        assert_eq!(bisect_to(&divided, 13).indices.len() / 3, 12);
        let mut edges = FxHashMap::<(u32, u32), i32>::default();
        for t in divided.indices.chunks_exact(3) {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
        assert!(edges.values().all(|open| *open == 0));
        assert!(edges.contains_key(&(0, 1)), "between locked points");
        assert_eq!(divided.positions[4], [2.0, 1.0, 0.0], "the longest of the others");
        let held = LocalMesh { locked: vec![true; 4], ..mesh };
        let filled = bisect_to(&held, 7);
        assert_eq!(filled.indices.len() / 3, 6, "a point in the largest face");
        assert_eq!(filled.indices[3..9], [0, 1, 3, 1, 2, 4]);
    }
}
