//! The vertices of all levels. A vertex is an identity: a vertex that moves gets a new one. So an identity has one
//! position, and cuts weld by it.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::clusterize::ClusterMesh;
use crate::limits::CLUSTER_MAX_VERTICES;
use crate::math::Aabb;
use crate::mesh::{WeldedMesh, hash};
use crate::model::AttributeLayout;

/// Positions and attributes of every identity.
#[derive(Debug, Default)]
pub struct VertexStore {
    /// Internal positions.
    pub positions: Vec<[f32; 3]>,
    /// Rows of `stride` floats.
    pub attributes: Vec<f32>,
    /// Floats per attribute row.
    pub stride: usize,
    /// What the rows hold.
    pub layout: AttributeLayout,
    /// The source vertex whose labels each identity has; empty when there are no labels.
    pub labels: Vec<u32>,
}

impl VertexStore {
    /// The vertices of the source.
    pub fn new(mesh: &mut WeldedMesh) -> Self {
        Self {
            positions: std::mem::take(&mut mesh.positions),
            attributes: std::mem::take(&mut mesh.attributes),
            stride: mesh.stride,
            layout: mesh.layout,
            labels: mesh.channels.label_numbers(),
        }
    }

    /// Number of identities.
    pub fn count(&self) -> usize {
        self.positions.len()
    }

    /// The attribute row of a vertex.
    pub fn row(&self, v: u32) -> &[f32] {
        &self.attributes[v as usize * self.stride..][..self.stride]
    }
}

/// The distinct positions of a level's clusters: adjacency, borders and locks go by position, never by identity
/// (seams have several identities at one position) and never by distance.
#[derive(Debug, Default)]
pub struct LevelPositions {
    /// Each distinct position once.
    pub positions: Vec<[f32; 3]>,
    /// The number of each cluster vertex's position, cluster after cluster.
    numbers: Vec<u32>,
    /// Where each cluster starts in `numbers`; one more entry than clusters.
    starts: Vec<u32>,
}

impl LevelPositions {
    /// Numbers the positions of clusters.
    pub fn new(store: &VertexStore, clusters: &[&ClusterMesh]) -> Self {
        let mut starts = vec![0];
        let mut vertices = Vec::with_capacity(clusters.iter().map(|c| c.vertices.len()).sum());
        for cluster in clusters {
            vertices.extend_from_slice(&cluster.vertices);
            starts.push(vertices.len() as u32);
        }
        let bits: Vec<[f32; 3]> = vertices.par_iter().map(|v| store.positions[*v as usize]).collect();
        drop(vertices);
        let mut numbers = hash::first_equal(bytemuck::cast_slice(&bits), 3);
        let mut positions = Vec::new();
        for i in 0..numbers.len() {
            numbers[i] = if numbers[i] as usize == i {
                positions.push(bits[i]);
                positions.len() as u32 - 1
            } else {
                numbers[numbers[i] as usize]
            };
        }
        Self { positions, numbers, starts }
    }

    /// The position numbers of a cluster's vertices.
    pub fn of(&self, cluster: usize) -> &[u32] {
        &self.numbers[self.starts[cluster] as usize..self.starts[cluster + 1] as usize]
    }

    /// The position numbers of all clusters, one after the other.
    pub fn all(&self) -> &[u32] {
        &self.numbers
    }
}

/// A group's own copy of its vertices, numbered from 0, in order of first use.
#[derive(Clone, Debug, Default)]
pub struct LocalMesh {
    /// Identity of each local vertex.
    pub ids: Vec<u32>,
    /// Internal positions.
    pub positions: Vec<[f32; 3]>,
    /// Attribute rows.
    pub attributes: Vec<f32>,
    /// Labels, see [`VertexStore::labels`].
    pub labels: Vec<u32>,
    /// The first local vertex at the same position.
    pub position_ids: Vec<u32>,
    /// Material of each vertex; empty when there are none.
    pub materials: Vec<u32>,
    /// Vertices that must stay as they are.
    pub locked: Vec<bool>,
    /// Three local vertices per triangle.
    pub indices: Vec<u32>,
    /// For each vertex at the end, which a simplifier added where it separated sheets, the one that it is a copy
    /// of.
    pub copies: Vec<u32>,
}

/// Numbers keys by first appearance: a small open-addressing table, at most half full.
#[derive(Debug)]
pub struct Numbering {
    table: Vec<(u32, u32)>,
    count: u32,
}

impl Numbering {
    const EMPTY: (u32, u32) = (u32::MAX, u32::MAX);

    /// An empty numbering of keys below `u32::MAX`, with room for so many; it grows where there are more.
    pub fn with_room(keys: usize) -> Self {
        Self { table: vec![Self::EMPTY; (2 * keys).next_power_of_two().max(16)], count: 0 }
    }

    /// The number of `key`, and whether it is new.
    #[inline]
    pub fn number(&mut self, key: u32) -> (u32, bool) {
        let slot = self.slot(key);
        let (known, number) = self.table[slot];
        if known == key {
            return (number, false);
        }
        let number = self.count;
        self.table[slot] = (key, number);
        self.count += 1;
        if 2 * self.count as usize > self.table.len() {
            self.grow();
        }
        (number, true)
    }

    /// Where a key is or belongs.
    #[inline]
    fn slot(&self, key: u32) -> usize {
        let mask = self.table.len() - 1;
        let mut slot = (key.wrapping_mul(0x9e37_79b1) as usize >> 7) & mask;
        while self.table[slot].0 != key && self.table[slot] != Self::EMPTY {
            slot = (slot + 1) & mask;
        }
        slot
    }

    #[cold]
    fn grow(&mut self) {
        let known = std::mem::take(&mut self.table);
        self.table = vec![Self::EMPTY; 2 * known.len()];
        for entry in known.into_iter().filter(|entry| *entry != Self::EMPTY) {
            let slot = self.slot(entry.0);
            self.table[slot] = entry;
        }
    }
}

impl LocalMesh {
    /// Gathers whole clusters of a level; `shared` says which positions are locked.
    pub fn of_clusters(
        store: &VertexStore,
        clusters: &[&ClusterMesh],
        level: &LevelPositions,
        members: &[u32],
        shared: &[bool],
    ) -> Self {
        let vertices = members.iter().map(|c| clusters[*c as usize].vertices.len()).sum();
        let [mut numbering, mut at_position] = [0; 2].map(|_| Numbering::with_room(vertices));
        let triangles: usize = members.iter().map(|c| clusters[*c as usize].triangles.len()).sum();
        let mut local = Self {
            ids: Vec::with_capacity(vertices),
            position_ids: Vec::with_capacity(vertices),
            locked: Vec::with_capacity(vertices),
            indices: Vec::with_capacity(3 * triangles),
            ..Self::default()
        };
        let mut first = Vec::with_capacity(vertices);
        for c in members {
            let cluster = clusters[*c as usize];
            let mut numbers = [0; CLUSTER_MAX_VERTICES];
            for ((number, v), position) in
                numbers.iter_mut().zip(&cluster.vertices).zip(level.of(*c as usize))
            {
                let (n, new) = numbering.number(*v);
                *number = n;
                if new {
                    local.ids.push(*v);
                    let (p, new) = at_position.number(*position);
                    if new {
                        first.push(n);
                    }
                    local.position_ids.push(first[p as usize]);
                    local.locked.push(shared[*position as usize]);
                    if store.layout.materials {
                        local.materials.push(cluster.material);
                    }
                }
            }
            local.indices.extend(cluster.triangles.iter().flatten().map(|c| numbers[usize::from(*c)]));
        }
        local.positions = local.ids.iter().map(|v| store.positions[*v as usize]).collect();
        local.attributes.reserve(local.ids.len() * store.stride);
        local.ids.iter().for_each(|v| local.attributes.extend_from_slice(store.row(*v)));
        if !store.labels.is_empty() {
            local.labels = local.ids.iter().map(|v| store.labels[*v as usize]).collect();
        }
        local
    }

    /// The same vertices and copies of some after them, each a position of its own; without triangles.
    pub fn with_copies(&self, copies: &[u32]) -> Self {
        fn and_copies<T: Copy>(values: &[T], copies: &[u32], stride: usize) -> Vec<T> {
            let mut out = Vec::with_capacity(values.len() + copies.len() * stride);
            out.extend_from_slice(values);
            if !values.is_empty() {
                let of = |v: &u32| &values[*v as usize * stride..(*v as usize + 1) * stride];
                copies.iter().for_each(|v| out.extend_from_slice(of(v)));
            }
            out
        }
        let count = self.ids.len() as u32;
        let stride = self.attributes.len() / self.ids.len().max(1);
        let mut position_ids = self.position_ids.clone();
        position_ids.extend(count..count + copies.len() as u32);
        Self {
            ids: and_copies(&self.ids, copies, 1),
            positions: and_copies(&self.positions, copies, 1),
            attributes: and_copies(&self.attributes, copies, stride),
            labels: and_copies(&self.labels, copies, 1),
            position_ids,
            materials: and_copies(&self.materials, copies, 1),
            locked: and_copies(&self.locked, copies, 1),
            indices: Vec::new(),
            copies: copies.to_vec(),
        }
    }

    /// The vertex that one is, or is a copy of, among so many.
    pub fn origin(&self, v: usize) -> usize {
        v.checked_sub(self.ids.len() - self.copies.len()).map_or(v, |copy| self.copies[copy] as usize)
    }

    /// Whether a vertex is another one than it was, or than it was copied from, in the mesh that this was made from.
    pub fn differs(&self, before: &Self, v: usize) -> bool {
        let stride = before.attributes.len() / before.ids.len().max(1);
        let (was, row) = (self.origin(v), |v: usize| v * stride..(v + 1) * stride);
        self.positions[v] != before.positions[was]
            || self.attributes[row(v)] != before.attributes[row(was)]
            || self.labels.get(v) != before.labels.get(was)
    }

    /// Lets triangles use what copies were copied from where neither of them `moved`, and else the first copy of it that
    /// did not: an identity has one vertex.
    pub fn join_copies(&mut self, moved: impl Fn(&Self, usize) -> bool) {
        let first = self.ids.len() - self.copies.len();
        let mut stays: FxHashMap<usize, u32> = FxHashMap::default();
        for i in 0..self.indices.len() {
            let v = self.indices[i] as usize;
            if v >= first && !moved(self, v) {
                let was = self.origin(v);
                let known = if moved(self, was) { *stays.entry(was).or_insert(v as u32) } else { was as u32 };
                self.indices[i] = known;
            }
        }
    }

    /// Longest side of the box of all vertices.
    pub fn extent(&self) -> f32 {
        let bounds = Aabb::of_points(&self.positions);
        (0..3).map(|k| bounds.max[k] - bounds.min[k]).fold(0.0, f32::max)
    }

    /// Some of the triangles with the vertices they use; enough to clusterize.
    fn part(&self, triangles: &[u32]) -> Self {
        let mut numbering = Numbering::with_room(triangles.len());
        let mut part = Self::default();
        for t in triangles {
            for v in &self.indices[3 * *t as usize..][..3] {
                let (number, new) = numbering.number(*v);
                if new {
                    part.ids.push(self.ids[*v as usize]);
                    part.positions.push(self.positions[*v as usize]);
                }
                part.indices.push(number);
            }
        }
        part
    }

    /// The material of a triangle; zero when there are none.
    pub fn material(&self, triangle: u32) -> u32 {
        self.materials.get(self.indices[3 * triangle as usize] as usize).copied().unwrap_or(0)
    }

    /// Triangles of each material, in the order of the materials.
    pub fn by_material(&self) -> Vec<Vec<u32>> {
        let mut triangles: Vec<u32> = (0..self.indices.len() as u32 / 3).collect();
        triangles.sort_by_key(|t| self.material(*t));
        triangles.chunk_by(|a, b| self.material(*a) == self.material(*b)).map(<[u32]>::to_vec).collect()
    }

    /// The parts of each material with it.
    pub fn materials_apart(&self) -> impl Iterator<Item = (u32, Self)> {
        self.by_material().into_iter().map(|triangles| (self.material(triangles[0]), self.part(&triangles)))
    }

    /// Gathers the positions of triangles over identities; enough to clusterize.
    pub fn of_faces(store: &VertexStore, faces: impl ExactSizeIterator<Item = [u32; 3]>) -> Self {
        let mut numbering = Numbering::with_room(faces.len());
        let mut local = Self::default();
        for v in faces.flatten() {
            let (number, new) = numbering.number(v);
            if new {
                local.ids.push(v);
            }
            local.indices.push(number);
        }
        local.positions = local.ids.iter().map(|v| store.positions[*v as usize]).collect();
        local
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_go_by_first_appearance_however_many_keys_there_are() {
        let mut numbering = Numbering::with_room(3);
        // Each key twice, the second time far behind the first.
        let keys = || (0..1000u32).map(|i| i.wrapping_mul(0x0100_0193) >> 1);
        for (key, i) in keys().zip(0..) {
            assert_eq!(numbering.number(key), (i, true));
        }
        for (key, i) in keys().zip(0..) {
            assert_eq!(numbering.number(key), (i, false));
        }
    }
}
