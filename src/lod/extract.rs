//! The arrays of a cut.

use crate::error::Result;
use crate::math::octahedral;
use crate::model::{AttributeLayout, Channel, ClusterAddress, Dag};

/// A cut as arrays: one mesh, welded by vertex identity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CutArrays {
    /// Internal positions.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals.
    pub normals: Vec<[f32; 3]>,
    /// As many words each as [`AttributeLayout::colors`] says; empty when the mesh has none.
    pub colors: Vec<u32>,
    /// UV sets.
    pub uvs: Vec<Vec<[f32; 2]>>,
    /// Vertex identities.
    pub ids: Vec<u32>,
    /// Triangles.
    pub faces: Vec<[u32; 3]>,
    /// For each cluster its first triangle; one more entry than clusters.
    pub first_face: Vec<u32>,
}

impl CutArrays {
    /// Adds a vertex with an attribute row as building has it; returns one more than its number. Normals that are not
    /// `known` to be of one length are made so.
    pub fn push(
        &mut self,
        layout: AttributeLayout,
        position: [f32; 3],
        id: u32,
        row: &[f32],
        known: bool,
    ) -> u32 {
        self.positions.push(position);
        self.ids.push(id);
        let size = if known { 1.0 } else { row[..3].iter().map(|x| x * x).sum::<f32>().sqrt() };
        let unit = |k: usize| if size > 0.0 { row[k] / size } else { f32::from(u8::from(k == 2)) };
        self.normals.push([0, 1, 2].map(unit));
        let mut next = 3;
        if layout.colors.is_some() {
            let color = layout.colors.pack([0, 1, 2, 3].map(|k| row[next + k]));
            self.colors.extend_from_slice(&color[..layout.colors.words()]);
            next += 4;
        }
        for set in &mut self.uvs {
            set.push([row[next], row[next + 1]]);
            next += 2;
        }
        self.positions.len() as u32
    }
}

/// Concatenates clusters; vertices with the same identity become one, in order of first use.
pub fn extract(dag: &Dag, clusters: &[ClusterAddress]) -> CutArrays {
    extract_numbered(dag, clusters).0
}

/// The same, and for each identity one more than its row; 0 where it has none.
pub fn extract_numbered(dag: &Dag, clusters: &[ClusterAddress]) -> (CutArrays, Vec<u32>) {
    let counts = clusters.iter().map(|at| {
        let record = dag.record(*at);
        (usize::from(record.vertex_count), usize::from(record.triangle_count))
    });
    let (vertices, triangles) = counts.fold((0, 0), |sum, c| (sum.0 + c.0, sum.1 + c.1));
    let mut out = CutArrays::default();
    out.positions.reserve(vertices);
    out.normals.reserve(vertices);
    out.ids.reserve(vertices);
    out.faces.reserve(triangles);
    out.first_face.reserve(clusters.len() + 1);
    let (color_words, sets) = (dag.layout().colors.words(), usize::from(dag.layout().uv_sets));
    out.uvs = vec![Vec::new(); sets];
    // Zeroed memory comes lazily from the system: only the parts that the cut touches cost anything.
    let mut number = vec![0u32; dag.vertex_count as usize];
    for at in clusters {
        let geometry = dag.geometry(*at);
        let count = geometry.positions.len();
        let mut local = [0u32; crate::limits::CLUSTER_MAX_VERTICES];
        for (i, id) in geometry.ids.iter().enumerate() {
            let slot = &mut number[id as usize];
            if *slot == 0 {
                out.positions.push(geometry.positions.get(i));
                out.normals.push(octahedral::decode(geometry.normals[i]));
                out.ids.push(id);
                out.colors.extend_from_slice(&geometry.colors[color_words * i..][..color_words]);
                for set in 0..sets {
                    out.uvs[set].push(geometry.uvs[set * count + i]);
                }
                *slot = out.positions.len() as u32;
            }
            local[i] = *slot - 1;
        }
        out.first_face.push(out.faces.len() as u32);
        out.faces.extend(geometry.triangles.iter().map(|t| t.map(|v| local[usize::from(v)])));
    }
    out.first_face.push(out.faces.len() as u32);
    (out, number)
}

/// The words of a channel for the vertices of a cut, row after row; the channel is read if it is not in memory. `made` has
/// the rows of identities behind those of the mesh.
pub fn channel_rows(channel: &Channel, ids: &[u32], made: &[u32]) -> Result<Vec<u32>> {
    let (words, width) = (channel.words.load()?, channel.info.width());
    let mut rows = Vec::with_capacity(ids.len() * width);
    for id in ids {
        let at = *id as usize * width;
        let row = words.get(at..at + width);
        rows.extend_from_slice(row.unwrap_or_else(|| &made[at - words.len()..][..width]));
    }
    Ok(rows)
}
