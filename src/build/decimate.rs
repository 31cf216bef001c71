//! One result instead of all levels: a whole mesh simplified to a number of triangles, without a DAG and without proof.

use super::collapse::{Collapsed, Limit, Policy, collapse};
use super::content::Content;
use super::simplify::mean_edge;
use super::store::{LocalMesh, VertexStore};
use crate::config::BuildOptions;
use crate::error::Result;
use crate::lod::CutArrays;
use crate::mesh::{SourceMesh, weld};
use crate::model::{BuildReport, Frame};

/// A mesh simplified to at most `target` triangles, as far as its topology allows.
pub fn decimate(
    source: &SourceMesh<'_>,
    target: usize,
    options: &BuildOptions,
) -> Result<(CutArrays, Frame)> {
    let mut report = BuildReport::default();
    let mut mesh = weld(source, &mut report)?;
    let content = Content::new(&mesh, report.computed_normals, options);
    let store = VertexStore::new(&mut mesh);
    let local = LocalMesh::whole(&store, &mesh.faces, &mesh.materials);
    let unit = mean_edge(&local) / local.extent();
    let scale = if content.is_bare() { 0.0 } else { unit };
    let weights: Vec<f32> = content.weights().map(|weight| weight * scale).collect();
    let rows = local.attributes.clone();
    let Collapsed { mesh: made, .. } =
        collapse(&local, &local.locked, rows, &weights, Limit::triangles(target), &Policy::default());
    let mut out = CutArrays::default();
    let mut number = vec![u32::MAX; made.positions.len()];
    for t in made.indices.chunks_exact(3) {
        let corners = [t[0], t[1], t[2]].map(|v| {
            let slot = &mut number[v as usize];
            if *slot == u32::MAX {
                *slot = out.positions.len() as u32;
                out.positions.push(made.positions[v as usize]);
                out.ids.push(v);
            }
            *slot
        });
        out.faces.push(corners);
    }
    Ok((out, mesh.frame))
}
