//! Gathering clusters into groups: meshoptimizer's partitioner over shared vertices, by position.

use meshopt::{VertexDataAdapter, partition_clusters_with_positions};

use super::clusterize::ClusterMesh;
use super::store::RoundPositions;
use crate::limits::{GROUP_MAX_CLUSTERS, PAGE_MAX_BYTES};
use crate::model::AttributeLayout;
use crate::model::cluster::RECORD_WORDS;

/// Partitions clusters. Every cluster is in exactly one group; a group fits a page.
pub fn partition(
    layout: AttributeLayout,
    clusters: &[&ClusterMesh],
    round: &RoundPositions,
    target: usize,
) -> Vec<Vec<u32>> {
    if clusters.len() <= 1 {
        return vec![(0..clusters.len() as u32).collect()];
    }
    let counts: Vec<u32> = clusters.iter().map(|c| c.vertices.len() as u32).collect();
    let bytes: &[u8] = bytemuck::cast_slice(&round.positions);
    let mut part = vec![0; clusters.len()];
    let Ok(adapter) = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0) else { return Vec::new() };
    let count = partition_clusters_with_positions(&mut part, round.all(), &counts, &adapter, target);
    let mut groups = vec![Vec::new(); count];
    for (cluster, part) in part.iter().enumerate() {
        groups[*part as usize].push(cluster as u32);
    }
    groups.retain(|g| !g.is_empty());
    groups.into_iter().flat_map(|g| split_to_fit(layout, clusters, g)).collect()
}

/// Cuts a group that exceeds a page or the most clusters of a group.
fn split_to_fit(layout: AttributeLayout, clusters: &[&ClusterMesh], group: Vec<u32>) -> Vec<Vec<u32>> {
    let words = |c: u32| {
        let c = clusters[c as usize];
        RECORD_WORDS + layout.cluster_words(c.vertices.len(), c.triangles.len())
    };
    let total: usize = group.iter().map(|c| words(*c)).sum();
    if group.len() <= GROUP_MAX_CLUSTERS && 4 * total <= PAGE_MAX_BYTES || group.len() == 1 {
        return vec![group];
    }
    let (a, b) = group.split_at(group.len() / 2);
    [a, b].into_iter().flat_map(|half| split_to_fit(layout, clusters, half.to_vec())).collect()
}
