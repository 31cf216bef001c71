//! What coarse levels are measured against. Errors measured against the level below add up, and after many levels
//! their sum is several times the true distance. So every few rounds the surface as it then is becomes the
//! reference, and the rounds after it are measured against that: its own error enters once, and is small.
//!
//! From the new surface to the reference any nearest point will do. The other way the reference's vertices travel
//! up the DAG with the clusters that they are nearest to, so that each is measured by the group that answers for
//! its part of the surface.

use super::clusterize::ClusterMesh;
use super::dag::BuildCluster;
use super::store::{RoundPositions, VertexStore};
use crate::math::{Aabb, morton};
use crate::measure::TriangleTree;

/// The first round that is measured against a reference: before, there are too many triangles to be worth it.
const FIRST_ROUND: u32 = 4;
/// Rounds that share a reference: each has half the triangles of the one before.
const ROUNDS: u32 = 3;

/// A vertex of the reference.
#[derive(Clone, Copy, Debug)]
pub struct Tracked {
    position: [f32; 3],
    /// Error of the reference there.
    error: f32,
}

/// A cluster that is being measured.
#[derive(Debug)]
pub struct Patch<'a> {
    /// Positions of its vertices.
    pub positions: Vec<[f32; 3]>,
    /// Corners as indices into `positions`.
    pub triangles: &'a [[u8; 3]],
}

/// The surface of an earlier round.
#[derive(Debug)]
pub struct Reference {
    tree: TriangleTree,
    /// Error of the surface at each triangle.
    errors: Vec<f32>,
}

impl Reference {
    /// Whether a round starts with a new reference.
    pub fn is_due(round: u32) -> bool {
        round >= FIRST_ROUND && (round - FIRST_ROUND).is_multiple_of(ROUNDS)
    }

    /// The surface of clusters.
    pub fn new(store: &VertexStore, clusters: &[&BuildCluster], bounds: &Aabb) -> Self {
        let corner = |c: &ClusterMesh, v: u8| store.positions[c.vertices[usize::from(v)] as usize];
        let mut triangles: Vec<(u64, [[f32; 3]; 3], f32)> = Vec::new();
        for cluster in clusters {
            for t in &cluster.mesh.triangles {
                let p = t.map(|v| corner(&cluster.mesh, v));
                let centroid = [0, 1, 2].map(|k| (p[0][k] + p[1][k] + p[2][k]) / 3.0);
                triangles.push((morton::code(centroid, bounds), p, cluster.error.max(0.0)));
            }
        }
        triangles.sort_by_key(|t| t.0);
        let errors = triangles.iter().map(|t| t.2).collect();
        Self { tree: TriangleTree::of(triangles.into_iter().map(|t| t.1).collect()), errors }
    }

    /// The vertices of clusters of the reference itself, each given to the first cluster that has it.
    pub fn track(round: &RoundPositions, clusters: &[&BuildCluster]) -> Vec<Vec<Tracked>> {
        let mut seen = vec![false; round.positions.len()];
        let tracked = |(i, cluster): (usize, &&BuildCluster)| {
            let error = cluster.error.max(0.0);
            let new = |p: &&u32| !std::mem::replace(&mut seen[**p as usize], true);
            let numbers = round.of(i).iter().filter(new);
            numbers.map(|p| Tracked { position: round.positions[*p as usize], error }).collect()
        };
        clusters.iter().enumerate().map(tracked).collect()
    }

    /// The error of patches that replace the surface on which the `tracked` vertices lie: the larger of
    /// `estimate` and the distances at the vertices of either surface, times `margin`, plus the error of the
    /// reference there. Also hands the tracked vertices over to the patches.
    pub fn measure(
        &self,
        tracked: &[Tracked],
        patches: &[Patch<'_>],
        estimate: f32,
        margin: f32,
    ) -> (f32, Vec<Vec<Tracked>>) {
        let mut owners = Vec::new();
        let mut triangles = Vec::new();
        for (i, patch) in patches.iter().enumerate() {
            owners.resize(owners.len() + patch.triangles.len(), i);
            triangles.extend(patch.triangles.iter().map(|t| t.map(|v| patch.positions[usize::from(v)])));
        }
        let tree = TriangleTree::of(triangles);
        let mut error = tracked.iter().fold(0.0, |e, t| t.error.max(e)) + margin * estimate;
        let mut handed = vec![Vec::new(); patches.len()];
        // Both lists run along the surface: what was nearest to one point is near the next.
        let mut nearest = 0;
        for vertex in tracked {
            let squared;
            (squared, nearest) = tree.nearest(vertex.position, nearest);
            error = error.max(vertex.error + margin * squared.sqrt());
            handed[owners[nearest as usize]].push(*vertex);
        }
        nearest = 0;
        for p in patches.iter().flat_map(|patch| &patch.positions) {
            let squared;
            (squared, nearest) = self.tree.nearest(*p, nearest);
            error = error.max(self.errors[nearest as usize] + margin * squared.sqrt());
        }
        (error, handed)
    }
}
