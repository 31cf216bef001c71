//! Stitching what was made into a cut.

use super::gather::Region;
use super::measure::Changes;
use super::{Made, Part};
use crate::error::Result;
use crate::lod::CutArrays;
use crate::mesh::channels::Scale;
use crate::model::{ClusterAddress, Dag};

impl Changes {
    /// The clusters of a region that did not change, and the triangles that replace the others.
    pub fn stitch(
        mut self,
        dag: &Dag,
        region: &Region,
        scales: &[Scale],
    ) -> Result<(Vec<ClusterAddress>, Made)> {
        let touched = self.touched(region);
        let is_touched = |owner: u32| touched.binary_search(&region.clusters[owner as usize]).is_ok();
        let level_of = |at: &ClusterAddress| dag.record(*at).level;
        let made_level = touched.iter().map(level_of).fold(0, u8::max).saturating_add(1);
        let mut faces = Vec::new();
        for (t, was) in self.after.indices.chunks_exact(3).zip(&self.was) {
            let level = match was.map(|t| region.owners[t as usize]) {
                Some(owner) if !is_touched(owner) => continue,
                Some(owner) => level_of(&region.clusters[owner as usize]),
                None => made_level,
            };
            let material = self.after.materials.get(t[0] as usize).map_or(0, |m| m.cast_signed());
            faces.push((material, level, [t[0], t[1], t[2]]));
        }
        // Stable: triangles of a part stay in their order.
        faces.sort_by_key(|(material, level, _)| (*material, *level));
        let parts = faces.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1));
        let part = |faces: &[(i32, u8, _)]| Part {
            material: faces[0].0,
            level: faces[0].1,
            faces: faces.len() as u32,
        };
        let parts = parts.map(part).collect();
        self.after.indices = faces.iter().flat_map(|(_, _, t)| *t).collect();
        // New identities, by first use.
        let mut new = Vec::new();
        for v in &self.after.indices {
            let v = *v as usize;
            if std::mem::take(&mut self.moved[v]) {
                self.after.ids[v] = dag.vertex_count + new.len() as u32;
                new.push(v);
            }
        }
        let channels = made_channels(dag, region, &self, &new, scales)?;
        let whole = (0..region.clusters.len() as u32).filter(|owner| !is_touched(*owner));
        let whole = whole.map(|owner| region.clusters[owner as usize]).collect();
        Ok((whole, Made { mesh: self.after, parts, channels, distance: 0.0, attribute_error: 0.0 }))
    }
}

/// For each channel the rows of new vertices.
fn made_channels(
    dag: &Dag,
    region: &Region,
    changes: &Changes,
    new: &[usize],
    scales: &[Scale],
) -> Result<Vec<Vec<u32>>> {
    let after = &changes.after;
    let stride = after.attributes.len() / after.ids.len().max(1);
    let mut column = stride - scales.len();
    let mut scales = scales;
    let mut channels = Vec::new();
    for channel in &dag.channels {
        let (words, width) = (channel.words.load()?, channel.info.width());
        let mut rows = Vec::with_capacity(new.len() * width);
        if channel.info.dtype.is_label() {
            for v in new {
                // Labels are named by the first vertex that has them.
                let id = region.mesh.ids[after.labels[*v] as usize];
                rows.extend_from_slice(&words[id as usize * width..][..width]);
            }
        } else {
            let (own, rest) = scales.split_at(width);
            for v in new {
                let row = &after.attributes[v * stride + column..][..width];
                rows.extend(row.iter().zip(own).map(|(x, scale)| scale.word(*x)));
            }
            (scales, column) = (rest, column + width);
        }
        channels.push(rows);
    }
    Ok(channels)
}

impl Made {
    /// Appends it to the arrays of the clusters; `number` has one more than the row of each identity there.
    pub fn append(&self, dag: &Dag, out: &mut CutArrays, number: &[u32]) {
        let mesh = &self.mesh;
        let stride = mesh.attributes.len() / mesh.ids.len().max(1);
        let mut local = vec![0u32; mesh.ids.len()];
        for t in mesh.indices.chunks_exact(3) {
            for v in t {
                let at = *v as usize;
                if local[at] > 0 {
                    continue;
                }
                let known = number.get(mesh.ids[at] as usize).copied().unwrap_or(0);
                local[at] = if known > 0 { known } else { self.push(dag, out, at, stride) };
            }
            out.faces.push([t[0], t[1], t[2]].map(|v| local[v as usize] - 1));
        }
        let mut end = out.first_face.pop().unwrap_or(0);
        for part in &self.parts {
            out.first_face.push(end);
            end += part.faces;
        }
        out.first_face.push(end);
    }

    /// Adds a vertex; returns one more than its row.
    fn push(&self, dag: &Dag, out: &mut CutArrays, at: usize, stride: usize) -> u32 {
        let row = &self.mesh.attributes[at * stride..][..stride];
        // Normals of vertices that other cuts have are what they are there.
        let id = self.mesh.ids[at];
        out.push(dag.layout(), self.mesh.positions[at], id, row, id < dag.vertex_count)
    }
}
