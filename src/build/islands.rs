//! Preserving the area that foliage and hair cover. Islands, such as leaves, are so small that edge collapses soon
//! make them vanish, and a crown of leaves thins out. Here an island is removed as a whole, and the remaining ones
//! grow (Cook, Halstead, Planck and Ryu, "Stochastic Simplification of Aggregate Detail", 2007).
//!
//! Islands are sampled with a probability in proportion to their area, evenly along a space-filling curve. So large
//! islands, such as trunks, stay as they are, and the small ones that stay share the area evenly. They take over
//! the visible area, not all of it: few leaves hide each other less than many do. With all of the area, the
//! measured trees covered up to three times what they had. Visible area is counted in small images from all
//! directions, see `silhouette`.

use super::silhouette::{Silhouette, Silhouettes};
use super::store::LocalMesh;
use crate::math::triangle::area_normal;
use crate::math::{Aabb, morton};
use crate::mesh::hash;

/// An island with more triangles is simplified first. It is a *leaf*, which is removed as a whole, once it has at
/// most so many.
const LEAF_TRIANGLES: u32 = 8;
/// Leaves take over the area of removed ones, divided by at most two to this power, or times its root, so that as
/// much is covered as before.
const FACTOR_BITS: f64 = 4.0;
/// Bisections that find a thickness.
const HALVINGS: usize = 10;
/// Closed islands grow thicker by at most this part of the root of their area.
const THICKEST: f64 = 0.25;

const NONE: u32 = u32::MAX;

/// The connected components of a group's mesh, by position. Large ones, and those that reach into other groups, are
/// islands too.
#[derive(Debug)]
pub struct Islands {
    /// The island of each vertex.
    of_vertex: Vec<u32>,
    /// Area of each island.
    area: Vec<f64>,
    /// Triangles of each island.
    triangles: Vec<u32>,
    /// Whether an island must stay as it is because other groups share it.
    locked: Vec<bool>,
    /// Whether an island has a border.
    open: Vec<bool>,
    /// The box of each island.
    boxes: Vec<Aabb>,
}

/// The leaves after thinning.
#[derive(Debug)]
pub struct Thinned {
    /// The remaining leaves, with the vertices of everything else in place.
    pub mesh: LocalMesh,
    /// A bound of the two-sided distance of the surfaces before and after.
    pub moved: f64,
}

fn find(parents: &mut [u32], mut v: u32) -> u32 {
    while parents[v as usize] != v {
        parents[v as usize] = parents[parents[v as usize] as usize];
        v = parents[v as usize];
    }
    v
}

fn area(positions: &[[f32; 3]], t: &[u32]) -> f64 {
    let n = area_normal([0, 1, 2].map(|k| positions[t[k] as usize]));
    0.5 * (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt()
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    (0..3).map(|k| (f64::from(a[k]) - f64::from(b[k])).powi(2)).sum::<f64>().sqrt()
}

impl Islands {
    /// The islands of a mesh.
    pub fn of(mesh: &LocalMesh) -> Self {
        let mut parents: Vec<u32> = (0..mesh.ids.len() as u32).collect();
        let mut edges = Vec::with_capacity(mesh.indices.len());
        for t in mesh.indices.chunks_exact(3) {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let (root, other) = (find(&mut parents, a), find(&mut parents, b));
                parents[root.max(other) as usize] = root.min(other);
                let [p, q] = [a, b].map(|v| mesh.position_ids[v as usize]);
                edges.push((p.min(q), p.max(q), a));
            }
        }
        edges.sort_unstable();
        let same_edge = |x: &(u32, u32, u32), y: &(u32, u32, u32)| (x.0, x.1) == (y.0, y.1);
        for uses in edges.chunk_by(same_edge) {
            for (_, _, v) in &uses[1..] {
                let (root, other) = (find(&mut parents, uses[0].2), find(&mut parents, *v));
                parents[root.max(other) as usize] = root.min(other);
            }
        }
        // The root of an island is its smallest vertex, so it is numbered first.
        let mut count = 0;
        let mut of_vertex = vec![0; parents.len()];
        for v in 0..parents.len() {
            let root = find(&mut parents, v as u32) as usize;
            of_vertex[v] = if root == v {
                count += 1;
                count - 1
            } else {
                of_vertex[root]
            };
        }
        let count = count as usize;
        let mut islands = Self {
            area: vec![0.0; count],
            triangles: vec![0; count],
            locked: vec![false; count],
            open: vec![false; count],
            boxes: Vec::new(),
            of_vertex,
        };
        islands.boxes = islands.boxes(mesh);
        for t in mesh.indices.chunks_exact(3) {
            let i = islands.of_vertex[t[0] as usize] as usize;
            islands.area[i] += area(&mesh.positions, t);
            islands.triangles[i] += 1;
            islands.locked[i] |= t.iter().any(|v| mesh.locked[*v as usize]);
        }
        for uses in edges.chunk_by(same_edge).filter(|uses| uses.len() == 1) {
            islands.open[islands.of_vertex[uses[0].2 as usize] as usize] = true;
        }
        islands
    }

    /// Whether an island is a leaf: removed or scaled as a whole.
    fn is_leaf(&self, island: u32) -> bool {
        let i = island as usize;
        (1..=LEAF_TRIANGLES).contains(&self.triangles[i]) && !self.locked[i]
    }

    /// The triangles of leaves, and all others.
    pub fn split(&self, mesh: &LocalMesh) -> (Vec<u32>, Vec<u32>) {
        let (mut leaves, mut rest) = (Vec::new(), Vec::new());
        for t in mesh.indices.chunks_exact(3) {
            let list = if self.is_leaf(self.of_vertex[t[0] as usize]) { &mut leaves } else { &mut rest };
            list.extend_from_slice(t);
        }
        (leaves, rest)
    }

    /// Enlarges islands that simplification shrank until as much is covered as in `silhouette`: closed ones become
    /// thicker, others are scaled. Returns the largest distance that a vertex moved.
    pub fn restore(&self, after: &mut LocalMesh, silhouette: &Silhouette) -> f64 {
        let mut left = vec![0.0; self.area.len()];
        let mut order: Vec<(u32, u32)> = Vec::with_capacity(after.indices.len() / 3);
        for (i, t) in after.indices.chunks_exact(3).enumerate() {
            let island = self.of_vertex[t[0] as usize];
            left[island as usize] += area(&after.positions, t);
            order.push((island, i as u32));
        }
        let free = |i: usize| left[i] > 0.0 && !self.locked[i] && left[i] < self.area[i];
        // Within their box: a trunk that lost area must not grow taller.
        let boxes = self.boxes(after);
        let side = |b: &Aabb, k: usize| f64::from(b.max[k]) - f64::from(b.min[k]);
        let room = |i: usize| {
            (0..3).map(|k| side(&self.boxes[i], k) / side(&boxes[i], k)).fold(f64::INFINITY, f64::min)
        };
        let scale = |i: usize| (self.area[i] / left[i]).sqrt().min(room(i).max(1.0));
        let scale = |i| Some(scale(i)).filter(|_| free(i) && self.open[i]);
        let scales: Vec<_> = (0..left.len()).map(scale).collect();
        let places = after.positions.clone();
        self.scale(after, &scales);
        order.sort_unstable();
        for triangles in order.chunk_by(|a, b| a.0 == b.0) {
            let island = triangles[0].0 as usize;
            if free(island) && !self.open[island] {
                let corners = |(_, t): &(u32, u32)| [0, 1, 2].map(|k| after.indices[3 * *t as usize + k]);
                let indices: Vec<u32> = triangles.iter().flat_map(corners).collect();
                thicken(after, &indices, self.area[island]);
            }
        }
        // All of their area may cover too much: part of it was hidden.
        let grown = after.positions.clone();
        let grow = |by: f64| -> Vec<[f32; 3]> {
            places.iter().zip(&grown).map(|(p, q)| between(*p, *q, by)).collect()
        };
        let covered = |by| Silhouette::of(silhouette.bounds, &grow(by), &after.indices).covered;
        let by = if grown == places || covered(0.0) >= silhouette.covered {
            0.0
        } else {
            silhouette.solve(0.0, 2.0, covered)
        };
        after.positions = grow(by);
        places.iter().zip(&after.positions).fold(0.0, |most, (p, q)| distance(*p, *q).max(most))
    }

    /// The boxes of islands in a mesh.
    fn boxes(&self, mesh: &LocalMesh) -> Vec<Aabb> {
        let mut boxes = vec![Aabb::EMPTY; self.area.len()];
        for v in &mesh.indices {
            let b = &mut boxes[self.of_vertex[*v as usize] as usize];
            *b = b.union(&Aabb::of_points([&mesh.positions[*v as usize]]));
        }
        boxes
    }

    /// Scales islands of a mesh about their centres, and moves them back into the box of the mesh before. Returns
    /// the largest distance that a vertex moved.
    fn scale(&self, mesh: &mut LocalMesh, scales: &[Option<f64>]) -> f64 {
        let whole = Aabb::of_points(&mesh.positions);
        let boxes = self.boxes(mesh);
        let mut used = vec![false; mesh.positions.len()];
        mesh.indices.iter().for_each(|v| used[*v as usize] = true);
        let mut most = 0.0f64;
        for v in (0..used.len()).filter(|v| used[*v]) {
            let island = self.of_vertex[v] as usize;
            let (Some(scale), b) = (scales[island], &boxes[island]) else { continue };
            let old = mesh.positions[v];
            mesh.positions[v] = std::array::from_fn(|k| {
                let [low, high] = [b.min[k], b.max[k]].map(f64::from);
                let [least, greatest] = [whole.min[k], whole.max[k]].map(f64::from);
                let half = (high - low) * 0.5 * scale;
                let room = ((greatest - least) * 0.5 - half).max(0.0);
                let middle = (least + greatest) * 0.5;
                let center = ((low + high) * 0.5).clamp(middle - room, middle + room);
                (center + (f64::from(old[k]) - (low + high) * 0.5) * scale) as f32 + 0.0
            });
            most = most.max(distance(old, mesh.positions[v]));
        }
        most
    }

    /// Keeps leaves of about `target` triangles, at least one, and scales them to cover as much as in `silhouette`.
    /// `after` already holds the rest. `exactly`: at most `target` triangles, and as many as fit.
    pub fn thin(
        &self,
        after: &LocalMesh,
        leaves: &[u32],
        target: usize,
        silhouette: &Silhouette,
        exactly: bool,
    ) -> Thinned {
        let bounds = silhouette.bounds;
        let mut order: Vec<(u64, u32)> = Vec::new();
        let mut first = vec![NONE; self.area.len()];
        for t in leaves.chunks_exact(3) {
            let island = self.of_vertex[t[0] as usize];
            if first[island as usize] == NONE {
                first[island as usize] = t[0];
                order.push((morton::code(after.positions[t[0] as usize], &bounds), island));
            }
        }
        order.sort_unstable();
        let share = self.share(&order, target);
        // One of every `share` of area stays; those larger than that always do.
        let chance = |island: u32| (self.area[island as usize] / share).min(1.0);
        let (mut sum, mut kept) = (0.5f64, vec![false; self.area.len()]);
        for (_, island) in &order {
            let next = sum + chance(*island);
            kept[*island as usize] = next.floor() > sum.floor();
            sum = next;
        }
        if !order.iter().any(|(_, i)| kept[*i as usize]) {
            let areas = order.iter().map(|(_, i)| (self.area[*i as usize], *i));
            let largest = areas.max_by(|a, b| a.0.total_cmp(&b.0));
            largest.into_iter().for_each(|(_, i)| kept[i as usize] = true);
        }
        if exactly {
            self.correct(&order, target, &mut kept);
        }
        let (stay, go): (Vec<&[u32]>, Vec<&[u32]>) =
            leaves.chunks_exact(3).partition(|t| kept[self.of_vertex[t[0] as usize] as usize]);
        let stay = LocalMesh { indices: stay.concat(), ..after.clone() };
        let grow = |bits: f64| {
            let mut mesh = stay.clone();
            let stands_for_others = |i: usize| kept[i] && self.area[i] < share;
            let scale = |i: usize| Some((share / self.area[i] * bits.exp2()).sqrt());
            let scale = |i: usize| scale(i).filter(|s| stands_for_others(i) && s.is_finite());
            let scales: Vec<_> = (0..kept.len()).map(scale).collect();
            let moved = self.scale(&mut mesh, &scales);
            (mesh, moved)
        };
        let mut rest = Silhouettes::new(&silhouette.bounds);
        rest.draw_all(&after.positions, &after.indices);
        let covered = |bits| {
            let (mut all, grown) = (rest.clone(), grow(bits).0);
            all.draw_all(&grown.positions, &grown.indices);
            all.covered()
        };
        let (grown, mut moved) = grow(silhouette.solve(-FACTOR_BITS, 0.5 * FACTOR_BITS, covered));
        let stay = order.iter().filter(|(_, i)| kept[*i as usize]);
        let stay: Vec<_> = stay.map(|(_, i)| grown.positions[first[*i as usize] as usize]).collect();
        for t in go {
            moved = moved.max(farthest_gone(t.iter().map(|v| after.positions[*v as usize]), &stay));
        }
        Thinned { mesh: grown, moved }
    }

    /// Removes the smallest kept leaves, or restores the largest removed ones, until `target` triangles are kept.
    fn correct(&self, order: &[(u64, u32)], target: usize, kept: &mut [bool]) {
        let mut by_area: Vec<u32> = order.iter().map(|(_, island)| *island).collect();
        by_area.sort_by(|a, b| self.area[*a as usize].total_cmp(&self.area[*b as usize]).then(a.cmp(b)));
        let count = |island: u32| self.triangles[island as usize] as usize;
        let mut sum: usize = by_area.iter().filter(|i| kept[**i as usize]).map(|i| count(*i)).sum();
        for island in &by_area {
            if sum > target && std::mem::take(&mut kept[*island as usize]) {
                sum -= count(*island);
            }
        }
        for island in by_area.iter().rev().filter(|i| count(**i) > 0) {
            if !kept[*island as usize] && sum + count(*island) <= target {
                kept[*island as usize] = true;
                sum += count(*island);
            }
        }
    }

    /// The triangles of a mesh without the smallest leaves: at most `target`, and as many as fit; `None` where
    /// leaves do not suffice.
    pub fn prune(&self, mesh: &LocalMesh, target: usize) -> Option<Vec<u32>> {
        let (leaves, rest) = self.split(mesh);
        let target = target.checked_sub(rest.len() / 3)?;
        let mut order: Vec<(u64, u32)> =
            leaves.chunks_exact(3).map(|t| (0, self.of_vertex[t[0] as usize])).collect();
        order.dedup();
        order.sort_unstable();
        order.dedup();
        let mut kept = vec![false; self.area.len()];
        order.iter().for_each(|(_, island)| kept[*island as usize] = true);
        self.correct(&order, target, &mut kept);
        let stays = |t: &[u32]| {
            !self.is_leaf(self.of_vertex[t[0] as usize]) || kept[self.of_vertex[t[0] as usize] as usize]
        };
        let left: Vec<u32> = mesh.indices.chunks_exact(3).filter(|t| stays(t)).flatten().copied().collect();
        Some(left).filter(|left| !left.is_empty())
    }

    /// The area that one leaf stands for, so that `target` triangles are to be expected.
    fn share(&self, order: &[(u64, u32)], target: usize) -> f64 {
        let mut sorted: Vec<(f64, f64)> = order
            .iter()
            .map(|(_, i)| (self.area[*i as usize], f64::from(self.triangles[*i as usize])))
            .collect();
        sorted.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut rest: f64 = sorted.iter().map(|(area, n)| area * n).sum();
        let mut room = target as f64;
        for (area, n) in sorted {
            let share = rest / room.max(1.0);
            if area <= share {
                return share;
            }
            rest -= area * n;
            room -= n;
        }
        f64::MIN_POSITIVE
    }
}

/// The point part of the way from one to another.
fn between(p: [f32; 3], q: [f32; 3], by: f64) -> [f32; 3] {
    std::array::from_fn(|k| (f64::from(p[k]) + (f64::from(q[k]) - f64::from(p[k])) * by) as f32 + 0.0)
}

/// The largest distance of the corners of a removed triangle to the point that is nearest to its first corner.
fn farthest_gone(mut corners: impl Iterator<Item = [f32; 3]>, points: &[[f32; 3]]) -> f64 {
    let Some(first) = corners.next() else { return 0.0 };
    let squared = |p: &[f32; 3]| (0..3).map(|k| (p[k] - first[k]) * (p[k] - first[k])).sum::<f32>();
    let near = points.iter().map(|p| (squared(p), p)).reduce(|a, b| if b.0 < a.0 { b } else { a });
    let Some((_, near)) = near else { return 0.0 };
    corners.fold(distance(first, *near), |most, corner| distance(corner, *near).max(most))
}

/// Moves the vertices of triangles outwards until they have an area, or nearly.
fn thicken(mesh: &mut LocalMesh, indices: &[u32], wanted: f64) {
    let mut vertices = indices.to_vec();
    vertices.sort_unstable();
    vertices.dedup();
    let places: Vec<[f32; 3]> = vertices.iter().map(|v| mesh.positions[*v as usize]).collect();
    let same = hash::first_equal(bytemuck::cast_slice(&places), 3);
    let local: Vec<usize> = indices.iter().map(|v| vertices.partition_point(|w| w < v)).collect();
    let mut normals = vec![[0.0f64; 3]; places.len()];
    for t in local.chunks_exact(3) {
        let normal = area_normal([0, 1, 2].map(|k| places[t[k]]));
        for v in t {
            (0..3).for_each(|k| normals[same[*v] as usize][k] += normal[k]);
        }
    }
    for n in &mut normals {
        let length = n.iter().map(|x| x * x).sum::<f64>().sqrt();
        *n = if length > 0.0 { n.map(|x| x / length) } else { [0.0; 3] };
    }
    let mut put = |by: f64| {
        for (i, v) in vertices.iter().enumerate() {
            let normal = normals[same[i] as usize];
            mesh.positions[*v as usize] =
                std::array::from_fn(|k| (f64::from(places[i][k]) + by * normal[k]) as f32 + 0.0);
        }
        indices.chunks_exact(3).map(|t| area(&mesh.positions, t)).sum::<f64>()
    };
    let (mut low, mut high) = (0.0, wanted.sqrt() * THICKEST);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if put(middle) < wanted { low = middle } else { high = middle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quads of growing size in rows of eight, and a triangle that others share.
    fn quads(count: u32) -> LocalMesh {
        let mut mesh = LocalMesh::default();
        for i in 0..count {
            let (x, size) = (2.0 * i as f32, 0.5 + i as f32 / count as f32);
            mesh.positions.extend([
                [x, 0.0, 0.0],
                [x + size, 0.0, 0.0],
                [x + size, size, 0.0],
                [x, size, 0.0],
            ]);
            mesh.indices.extend([0, 1, 2, 0, 2, 3].map(|v| 4 * i + v));
        }
        let first = mesh.positions.len() as u32;
        mesh.positions.extend([[0.0, -3.0, 0.0], [1.0, -3.0, 0.0], [0.0, -2.0, 1.0]]);
        mesh.indices.extend([first, first + 1, first + 2]);
        mesh.ids = (0..mesh.positions.len() as u32).collect();
        mesh.position_ids = mesh.ids.clone();
        mesh.locked = mesh.ids.iter().map(|v| *v >= first).collect();
        mesh
    }

    #[test]
    fn half_of_the_leaves_cover_as_much() {
        let mesh = quads(64);
        let islands = Islands::of(&mesh);
        let (leaves, rest) = islands.split(&mesh);
        assert_eq!((leaves.len(), rest.len()), (6 * 64, 3));
        let silhouette = Silhouette::of(Aabb::of_points(&mesh.positions), &mesh.positions, &mesh.indices);
        let after = LocalMesh { indices: rest.clone(), ..mesh.clone() };
        let thinned = islands.thin(&after, &leaves, leaves.len() / 6, &silhouette, false);
        let left = thinned.mesh.indices.len() / 3;
        assert!((60..=68).contains(&left), "{left}");
        let mut both = Silhouettes::new(&silhouette.bounds);
        both.draw_all(&mesh.positions, &rest);
        both.draw_all(&thinned.mesh.positions, &thinned.mesh.indices);
        let ratio = f64::from(both.covered()) / f64::from(silhouette.covered);
        assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
        // Leaves are two apart: a few steps to the next one that stays, and how much that grew.
        assert!(thinned.moved > 2.0 && thinned.moved < 8.0, "{}", thinned.moved);
        assert_eq!(mesh.positions[256..], thinned.mesh.positions[256..]);
    }

    #[test]
    fn what_shrank_is_as_large_as_it_was() {
        // A fan of eight around a centre, of which collapses left a square; its box is the same.
        let turn = |i: u32| f64::from(i) / 16.0 * std::f64::consts::TAU;
        let ring = |i: u32| [turn(i).cos() as f32, turn(i).sin() as f32, 0.0];
        let mut mesh = LocalMesh { positions: (0..16).map(ring).collect(), ..LocalMesh::default() };
        mesh.indices = (1..15).flat_map(|i| [0, i, i + 1]).collect();
        mesh.ids = (0..16).collect();
        mesh.position_ids = mesh.ids.clone();
        mesh.locked = vec![false; 16];
        let islands = Islands::of(&mesh);
        let silhouette = Silhouette::of(Aabb::of_points(&mesh.positions), &mesh.positions, &mesh.indices);
        let mut after = LocalMesh { indices: vec![2, 6, 10, 2, 10, 14], ..mesh.clone() };
        let covered =
            |m: &LocalMesh| f64::from(Silhouette::of(silhouette.bounds, &m.positions, &m.indices).covered);
        let before = covered(&after) / f64::from(silhouette.covered);
        let moved = islands.restore(&mut after, &silhouette);
        let restored = covered(&after) / f64::from(silhouette.covered);
        assert!(before < 0.7 && (restored - 1.0).abs() < 0.03 && moved > 0.1, "{before} {restored} {moved}");
    }
}
