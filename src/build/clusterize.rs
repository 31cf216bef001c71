//! Splitting triangles into clusters.
//!
//! Large inputs are first cut into blocks by a k-d tree over triangle centroids: blocks fit in cache, and both
//! cores work from the start. The blocks depend on the input alone, never on the number of threads. Within a
//! block one of meshoptimizer's builders makes the clusters, see [`Clusterizer`].

use meshopt::{VertexDataAdapter, build_meshlets_flex, build_meshlets_spatial};
use rayon::prelude::*;

use super::store::{LocalMesh, VertexStore};
use crate::config::{BuildOptions, Clusterizer};

/// Triangles of a block. Cluster borders are somewhat longer along block borders: at this size that costs
/// below half a per cent of the clusters.
const BLOCK_TRIANGLES: usize = 1 << 15;
/// A cluster may be closed early once it has this part of the triangles allowed.
const MIN_FILL: f32 = 1.0 / 3.0;
/// How much the spatial builder prefers full clusters to compact ones.
const FILL_WEIGHT: f32 = 0.5;
/// With the flexible builder, a cluster that grew this much beyond its expected radius is closed early.
const SPLIT_FACTOR: f32 = 2.0;

/// The triangles of one cluster over vertex identities.
#[derive(Clone, Debug, PartialEq)]
pub struct ClusterMesh {
    /// Identities.
    pub vertices: Vec<u32>,
    /// Corners as indices into `vertices`.
    pub triangles: Vec<[u8; 3]>,
}

/// Clusters of a whole mesh.
pub fn clusterize(store: &VertexStore, faces: &[[u32; 3]], options: &BuildOptions) -> Vec<ClusterMesh> {
    let centroids: Vec<[f32; 3]> = faces
        .par_iter()
        .map(|f| {
            let p = f.map(|v| store.positions[v as usize]);
            std::array::from_fn(|k| p[0][k] + p[1][k] + p[2][k])
        })
        .collect();
    let mut order: Vec<u32> = (0..faces.len() as u32).collect();
    let mut blocks: Vec<&mut [u32]> = Vec::new();
    split_blocks(&mut order, &centroids, &mut blocks);
    blocks
        .into_par_iter()
        .map(|block| {
            // The order inside a block is the caller's, which keeps what locality it has.
            block.sort_unstable();
            let local = LocalMesh::of_faces(store, block.iter().map(|f| faces[*f as usize]));
            clusterize_local(&local, options)
        })
        .flatten_iter()
        .collect()
}

/// Clusters of a group's own mesh.
pub fn clusterize_local(mesh: &LocalMesh, options: &BuildOptions) -> Vec<ClusterMesh> {
    let bytes: &[u8] = bytemuck::cast_slice(&mesh.positions);
    // The adapter fails on a misfit of bytes and stride only, which a slice of [f32; 3] cannot have.
    let Ok(adapter) = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0) else { return Vec::new() };
    let min_triangles = ((options.cluster_triangles as f32 * MIN_FILL) as usize).max(1);
    let (vertices, most) = (options.cluster_vertices, options.cluster_triangles);
    let meshlets = match options.clusterizer {
        Clusterizer::Spatial => {
            build_meshlets_spatial(&mesh.indices, &adapter, vertices, min_triangles, most, FILL_WEIGHT)
        }
        Clusterizer::Flex => {
            build_meshlets_flex(&mesh.indices, &adapter, vertices, min_triangles, most, 0.0, SPLIT_FACTOR)
        }
    };
    meshlets
        .iter()
        .map(|m| ClusterMesh {
            vertices: m.vertices.iter().map(|v| mesh.ids[*v as usize]).collect(),
            triangles: m.triangles.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        })
        .collect()
}

/// Halves `order` by the median along the longest axis until blocks are small enough.
fn split_blocks<'a>(order: &'a mut [u32], centroids: &[[f32; 3]], out: &mut Vec<&'a mut [u32]>) {
    if order.len() <= BLOCK_TRIANGLES {
        out.push(order);
        return;
    }
    let middle = order.len() / 2;
    median_split(order, middle, |f| centroids[f as usize]);
    let (a, b) = order.split_at_mut(middle);
    let mut right = Vec::new();
    rayon::join(|| split_blocks(a, centroids, out), || split_blocks(b, centroids, &mut right));
    out.append(&mut right);
}

/// Reorders so that the `middle` smallest along the longest axis of the points come first. Ties go by number,
/// so the two halves, as sets, depend on the points alone.
pub fn median_split(order: &mut [u32], middle: usize, point: impl Fn(u32) -> [f32; 3]) {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for i in order.iter() {
        let p = point(*i);
        for k in 0..3 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
    }
    let axis = (0..3).fold(0, |a, b| if high[b] - low[b] > high[a] - low[a] { b } else { a });
    order.select_nth_unstable_by(middle, |a, b| {
        point(*a)[axis].total_cmp(&point(*b)[axis]).then_with(|| a.cmp(b))
    });
}
