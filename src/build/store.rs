//! The vertices of all levels. A vertex is an identity: what moves gets a new one, so that an identity has one
//! position for ever and cuts weld by it.

use super::clusterize::ClusterMesh;
use crate::limits::CLUSTER_MAX_VERTICES;
use crate::mesh::{WeldedMesh, attributes};
use crate::model::AttributeLayout;

/// Positions and attributes of every identity.
#[derive(Debug, Default)]
pub struct VertexStore {
    /// Internal positions.
    pub positions: Vec<[f32; 3]>,
    /// Rows of `stride` floats.
    pub attributes: Vec<f32>,
    /// The smallest identity at the same position *and of the same origin*: what adjacency and locks go by.
    pub position_ids: Vec<u32>,
    /// Floats per attribute row.
    pub stride: usize,
    /// What the rows hold.
    pub layout: AttributeLayout,
}

impl VertexStore {
    /// The vertices of the source.
    pub fn new(mesh: &mut WeldedMesh) -> Self {
        Self {
            positions: std::mem::take(&mut mesh.positions),
            attributes: std::mem::take(&mut mesh.attributes),
            position_ids: std::mem::take(&mut mesh.position_ids),
            stride: attributes::stride(mesh.layout),
            layout: mesh.layout,
        }
    }

    /// Number of identities.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// The attribute row of a vertex.
    pub fn row(&self, v: u32) -> &[f32] {
        &self.attributes[v as usize * self.stride..][..self.stride]
    }
}

/// A group's own copy of its vertices, numbered from 0, in order of first use.
#[derive(Debug, Default)]
pub struct LocalMesh {
    /// Identity of each local vertex.
    pub ids: Vec<u32>,
    /// Internal positions.
    pub positions: Vec<[f32; 3]>,
    /// Attribute rows.
    pub attributes: Vec<f32>,
    /// The first local vertex with the same position id.
    pub position_ids: Vec<u32>,
    /// Three local vertices per triangle.
    pub indices: Vec<u32>,
}

/// Numbers keys by first appearance: a small open-addressing table, reused.
#[derive(Debug, Default)]
pub struct Numbering {
    table: Vec<(u32, u32)>,
    count: u32,
}

impl Numbering {
    const EMPTY: (u32, u32) = (u32::MAX, u32::MAX);

    /// An empty numbering for at most `keys` keys below `u32::MAX`.
    pub fn reset(&mut self, keys: usize) {
        self.table.clear();
        self.table.resize((2 * keys).next_power_of_two().max(16), Self::EMPTY);
        self.count = 0;
    }

    /// The number of `key`, and whether it is new.
    pub fn number(&mut self, key: u32) -> (u32, bool) {
        let mask = self.table.len() - 1;
        let mut slot = (key.wrapping_mul(0x9e37_79b1) as usize >> 7) & mask;
        loop {
            match &mut self.table[slot] {
                entry if *entry == Self::EMPTY => {
                    *entry = (key, self.count);
                    self.count += 1;
                    return (self.count - 1, true);
                }
                (k, number) if *k == key => return (*number, false),
                _ => slot = (slot + 1) & mask,
            }
        }
    }
}

impl LocalMesh {
    /// Gathers whole clusters.
    pub fn of_clusters<'a>(
        store: &VertexStore,
        clusters: impl Iterator<Item = &'a ClusterMesh> + Clone,
    ) -> Self {
        let mut gathering = Gathering::new(clusters.clone().map(|c| c.vertices.len()).sum());
        for cluster in clusters {
            let mut numbers = [0; CLUSTER_MAX_VERTICES];
            for (number, v) in numbers.iter_mut().zip(&cluster.vertices) {
                *number = gathering.number(*v);
            }
            gathering
                .local
                .indices
                .extend(cluster.triangles.iter().flatten().map(|c| numbers[usize::from(*c)]));
        }
        gathering.finish(store)
    }

    /// Gathers triangles over identities.
    pub fn of_faces(store: &VertexStore, faces: impl ExactSizeIterator<Item = [u32; 3]>) -> Self {
        let mut gathering = Gathering::new(3 * faces.len());
        for face in faces {
            let face = face.map(|v| gathering.number(v));
            gathering.local.indices.extend(face);
        }
        gathering.finish(store)
    }
}

/// A [`LocalMesh`] in the making.
struct Gathering {
    local: LocalMesh,
    numbering: Numbering,
}

impl Gathering {
    fn new(corners: usize) -> Self {
        let mut numbering = Numbering::default();
        numbering.reset(corners);
        Self { local: LocalMesh::default(), numbering }
    }

    fn number(&mut self, v: u32) -> u32 {
        let (number, new) = self.numbering.number(v);
        if new {
            self.local.ids.push(v);
        }
        number
    }

    fn finish(self, store: &VertexStore) -> LocalMesh {
        let Self { mut local, mut numbering } = self;
        local.positions = local.ids.iter().map(|v| store.positions[*v as usize]).collect();
        local.attributes.reserve(local.ids.len() * store.stride);
        local.ids.iter().for_each(|v| local.attributes.extend_from_slice(store.row(*v)));
        numbering.reset(local.ids.len());
        let mut first = Vec::new();
        for (i, v) in local.ids.iter().enumerate() {
            let (number, new) = numbering.number(store.position_ids[*v as usize]);
            if new {
                first.push(i as u32);
            }
            local.position_ids.push(first[number as usize]);
        }
        local
    }
}
