//! Gathering clusters into groups: meshoptimizer's partitioner over shared vertices or METIS over shared border,
//! both by position.

use meshopt::{VertexDataAdapter, partition_clusters_with_positions};
#[cfg(feature = "metis")]
use rayon::prelude::*;

use super::clusterize::ClusterMesh;
#[cfg(feature = "metis")]
use super::clusterize::split_blocks;
#[cfg(feature = "metis")]
use super::graph::{Graph, pairs};
use super::store::LevelPositions;
use crate::config::{BuildOptions, Partition};
use crate::limits::{GROUP_MAX_CLUSTERS, PAGE_MAX_BYTES};
#[cfg(feature = "metis")]
use crate::math::Aabb;
#[cfg(feature = "metis")]
use crate::math::median::Place;
use crate::model::AttributeLayout;
use crate::model::cluster::RECORD_WORDS;
use crate::model::packing::WIDEST;

/// Clusters of a block: METIS takes one at a time, threads take several blocks.
#[cfg(feature = "metis")]
const BLOCK_CLUSTERS: usize = 1 << 12;

/// Partitions clusters. Every cluster is in exactly one group; a group fits a page.
pub fn partition(
    layout: AttributeLayout,
    clusters: &[&ClusterMesh],
    level: &LevelPositions,
    options: &BuildOptions,
) -> Vec<Vec<u32>> {
    if clusters.len() <= 1 {
        return vec![(0..clusters.len() as u32).collect()];
    }
    let groups = match options.partition {
        Partition::Meshopt => merged(clusters, level, options.group_clusters),
        #[cfg(feature = "metis")]
        Partition::Metis => of_graph(clusters, level, options.group_clusters),
    };
    let words = |c: u32| most_words(layout, clusters[c as usize]);
    groups.iter().flat_map(|g| split_to_fit(g, PAGE_MAX_BYTES, &words)).collect()
}

/// meshoptimizer's groups.
fn merged(clusters: &[&ClusterMesh], level: &LevelPositions, target: usize) -> Vec<Vec<u32>> {
    let counts: Vec<u32> = clusters.iter().map(|c| c.vertices.len() as u32).collect();
    let bytes: &[u8] = bytemuck::cast_slice(&level.positions);
    let mut part = vec![0; clusters.len()];
    let Ok(adapter) = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0) else { return Vec::new() };
    let count = partition_clusters_with_positions(&mut part, level.all(), &counts, &adapter, target);
    let mut groups = vec![Vec::new(); count];
    for (cluster, part) in part.iter().enumerate() {
        groups[*part as usize].push(cluster as u32);
    }
    groups.retain(|g| !g.is_empty());
    groups
}

/// METIS's groups: of clusters that share much border.
#[cfg(feature = "metis")]
fn of_graph(clusters: &[&ClusterMesh], level: &LevelPositions, target: usize) -> Vec<Vec<u32>> {
    let points = |c: usize| level.of(c).iter().map(|p| &level.positions[*p as usize]);
    let center = |c: usize| Aabb::of_points(points(c)).center();
    let place = |c: usize| Place { point: center(c), number: c as u32 };
    let mut places: Vec<Place> = (0..clusters.len()).into_par_iter().map(place).collect();
    let groups_of = |block: &mut [Place]| {
        let (centers, members): (Vec<[f32; 3]>, Vec<u32>) = block.iter().map(|c| (c.point, c.number)).unzip();
        let positions = |c: &u32| level.of(*c as usize).iter().map(|p| u64::from(*p));
        let mut uses: Vec<(u64, u32)> =
            members.iter().zip(0..).flat_map(|(c, node)| positions(c).map(move |p| (p, node))).collect();
        let graph = Graph::new(&centers, &pairs(&mut uses));
        let parts = graph.parts(members.len().div_ceil(target));
        parts.into_iter().map(|part| part.iter().map(|n| members[*n as usize]).collect()).collect()
    };
    let blocks = split_blocks(&mut places, BLOCK_CLUSTERS);
    let groups: Vec<Vec<Vec<u32>>> = blocks.into_par_iter().map(groups_of).collect();
    groups.into_iter().flatten().collect()
}

/// Words that a cluster takes of a page at most.
pub fn most_words(layout: AttributeLayout, cluster: &ClusterMesh) -> usize {
    RECORD_WORDS + layout.streams(cluster.vertices.len(), cluster.triangles.len(), WIDEST).end
}

/// Cuts a group that takes more bytes than a page may have, or exceeds the most clusters of a group; `words` says what a
/// cluster takes.
pub fn split_to_fit(group: &[u32], bytes: usize, words: &impl Fn(u32) -> usize) -> Vec<Vec<u32>> {
    let total: usize = group.iter().map(|c| words(*c)).sum();
    if group.len() <= GROUP_MAX_CLUSTERS && 4 * total <= bytes || group.len() == 1 {
        return vec![group.to_vec()];
    }
    let (a, b) = group.split_at(group.len() / 2);
    [a, b].into_iter().flat_map(|half| split_to_fit(half, bytes, words)).collect()
}
