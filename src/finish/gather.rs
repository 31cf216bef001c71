//! Gathering clusters of a cut into one mesh of the kind that building simplifies.

use rustc_hash::FxHashSet;

use crate::build::store::{LocalMesh, Numbering};
use crate::error::Result;
use crate::limits::CLUSTER_MAX_VERTICES;
use crate::math::octahedral;
use crate::mesh::channels::Scale;
use crate::mesh::hash;
use crate::model::{ClusterAddress, ClusterRecord, Dag};

/// Some clusters of a cut as one mesh. Vertices that the rest of the cut shares are locked.
#[derive(Debug)]
pub struct Region {
    /// Their vertices and triangles.
    pub mesh: LocalMesh,
    /// The clusters.
    pub clusters: Vec<ClusterAddress>,
    /// For each triangle the number of its cluster.
    pub owners: Vec<u32>,
}

impl Region {
    /// Gathers clusters; `rest` are the others of the cut. Reads channels.
    pub fn gather(
        dag: &Dag,
        clusters: Vec<ClusterAddress>,
        rest: &[ClusterAddress],
        scales: &[Scale],
    ) -> Result<Self> {
        let mut mesh = LocalMesh::default();
        let mut owners = Vec::new();
        let layout = dag.layout();
        let sets = usize::from(layout.uv_sets);
        let room = clusters.iter().map(|at| usize::from(dag.record(*at).vertex_count)).sum();
        let mut numbering = Numbering::with_room(room);
        let words = channel_words(dag)?;
        for (owner, at) in clusters.iter().enumerate() {
            let (record, geometry) = (dag.record(*at), dag.geometry(*at));
            let count = geometry.positions.len();
            let mut local = [0u32; CLUSTER_MAX_VERTICES];
            for (i, id) in geometry.ids.iter().enumerate() {
                let (number, new) = numbering.number(id);
                local[i] = number;
                if !new {
                    continue;
                }
                mesh.ids.push(id);
                mesh.positions.push(geometry.positions.get(i));
                if layout.materials {
                    mesh.materials.push(record.material.cast_unsigned());
                }
                let row = &mut mesh.attributes;
                row.extend(octahedral::decode(geometry.normals[i]));
                if layout.colors.is_some() {
                    let words = layout.colors.words();
                    row.extend(layout.colors.unpack(&geometry.colors[words * i..][..words]));
                }
                (0..sets).for_each(|set| row.extend(geometry.uvs[set * count + i]));
                let mut scales = scales.iter();
                for (words, width, _) in words.iter().filter(|(_, _, is_label)| !is_label) {
                    let values = &words[id as usize * width..][..*width];
                    row.extend(values.iter().zip(&mut scales).map(|(word, scale)| scale.scaled(*word)));
                }
            }
            for t in geometry.triangles.iter() {
                mesh.indices.extend(t.map(|v| local[usize::from(v)]));
                owners.push(owner as u32);
            }
        }
        mesh.position_ids = hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3);
        mesh.labels = labels(&mesh.ids, &words);
        mesh.locked = locked(dag, &mesh, &clusters, rest);
        Ok(Self { mesh, clusters, owners })
    }

    /// Number of triangles.
    pub fn faces(&self) -> usize {
        self.owners.len()
    }
}

/// Words, width, and whether they are labels, of each channel.
type ChannelWords<'a> = Vec<(&'a [u32], usize, bool)>;

fn channel_words(dag: &Dag) -> Result<ChannelWords<'_>> {
    dag.channels
        .iter()
        .map(|channel| Ok((channel.words.load()?, channel.info.width(), channel.info.dtype.is_label())))
        .collect()
}

/// For each vertex the first one with the same labels; empty when there are none.
fn labels(ids: &[u32], words: &ChannelWords<'_>) -> Vec<u32> {
    let labels: Vec<_> = words.iter().filter(|(_, _, is_label)| *is_label).collect();
    let width: usize = labels.iter().map(|(_, width, _)| width).sum();
    if width == 0 {
        return Vec::new();
    }
    let mut rows = Vec::with_capacity(ids.len() * width);
    for id in ids {
        labels.iter().for_each(|(words, width, _)| rows.extend(&words[*id as usize * width..][..*width]));
    }
    hash::first_equal(&rows, width)
}

/// A box of clusters.
struct Around {
    low: [f32; 3],
    high: [f32; 3],
}

impl Around {
    fn of(record: &ClusterRecord) -> Self {
        // Grown: centres and extents are rounded, each by less than this part of the largest coordinate.
        let most = |k: usize| record.center[k].abs() + record.extent[k];
        let margin = |k: usize| record.extent[k] + most(k) * 4.0 * f32::EPSILON;
        Self {
            low: std::array::from_fn(|k| record.center[k] - margin(k)),
            high: std::array::from_fn(|k| record.center[k] + margin(k)),
        }
    }

    fn meets(&self, other: &Self) -> bool {
        (0..3).all(|k| self.low[k] <= other.high[k] && other.low[k] <= self.high[k])
    }

    fn join(&mut self, other: &Self) {
        for k in 0..3 {
            self.low[k] = self.low[k].min(other.low[k]);
            self.high[k] = self.high[k].max(other.high[k]);
        }
    }
}

/// For each vertex whether the rest of the cut has one at its position.
fn locked(dag: &Dag, mesh: &LocalMesh, own: &[ClusterAddress], rest: &[ClusterAddress]) -> Vec<bool> {
    let bits = |p: [f32; 3]| p.map(|x| (x + 0.0).to_bits());
    // Boxes of the groups, whose clusters lie together: few clusters of the rest are near any.
    let mut near: Vec<(u32, Around)> = Vec::new();
    for at in own {
        let record = dag.record(*at);
        let around = Around::of(record);
        match near.iter_mut().find(|(group, _)| *group == record.group) {
            Some((_, all)) => all.join(&around),
            None => near.push((record.group, around)),
        }
    }
    let places: FxHashSet<[u32; 3]> = mesh.positions.iter().map(|p| bits(*p)).collect();
    let mut shared = FxHashSet::default();
    for at in rest {
        let around = Around::of(dag.record(*at));
        if near.iter().any(|(_, group)| group.meets(&around)) {
            let positions = dag.geometry(*at).positions;
            let of_cluster = (0..positions.len()).map(|i| bits(positions.get(i)));
            shared.extend(of_cluster.filter(|place| places.contains(place)));
        }
    }
    mesh.positions.iter().map(|p| shared.contains(&bits(*p))).collect()
}
