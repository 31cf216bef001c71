//! The loop that grows the DAG, round by round: group, lock, simplify, split. A round's groups are simplified
//! in parallel, each on its own copy of its vertices; their results are appended in the order of the groups, so
//! nothing depends on which finished first.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;

use super::Progress;
use super::clusterize::{self, ClusterMesh};
use super::lock_borders::shared_positions;
use super::measure::{SAMPLING_MARGIN, step_error};
use super::partition::partition;
use super::reference::{Patch, Reference, Tracked};
use super::simplify::{Simplified, simplify};
use super::store::{LocalMesh, RoundPositions, VertexStore};
use crate::config::{BuildOptions, ErrorMeasure};
use crate::error::{Error, Result};
use crate::limits::MAX_ROUNDS;
use crate::math::{Aabb, Sphere};
use crate::mesh::WeldedMesh;
use crate::model::cluster::NO_GROUP;
use crate::model::rule::{ERROR_FLOOR, ERROR_STEP, ROOT_ERROR, SOURCE_ERROR};
use crate::model::{BuildReport, Frame, LevelReport, StuckGroup, StuckReason};

/// A cluster of the growing DAG.
#[derive(Clone, Debug)]
pub struct BuildCluster {
    /// Triangles.
    pub mesh: ClusterMesh,
    /// Own error and the sphere it is projected at.
    pub error: f32,
    /// Sphere of the group that made it.
    pub lod_sphere: Sphere,
    /// Longest chain of simplifications behind it.
    pub level: u8,
    /// The group that made it; [`NO_GROUP`] at level 0.
    pub refined: u32,
    /// Vertices of the reference that lie nearest to it.
    pub tracked: Vec<Tracked>,
}

/// A group of the growing DAG.
#[derive(Clone, Debug)]
pub struct BuildGroup {
    /// Indices of clusters.
    pub members: Vec<u32>,
    /// Encloses the members' spheres.
    pub lod_sphere: Sphere,
    /// Parent error of the members.
    pub error: f32,
    /// Round in which it was formed.
    pub level: u32,
}

/// The finished DAG before it is laid out in pages.
#[derive(Debug)]
pub struct Graph {
    /// Internal to object space.
    pub frame: Frame,
    /// Box of the source.
    pub bounds: Aabb,
    /// All vertices.
    pub store: VertexStore,
    /// All clusters.
    pub clusters: Vec<BuildCluster>,
    /// All groups; every cluster is in exactly one.
    pub groups: Vec<BuildGroup>,
    /// Faces of the source after mending, and their rows in the caller's array when asked for.
    pub source: (Vec<[u32; 3]>, Option<Vec<u32>>),
    /// Vertices of the source after welding.
    pub source_vertices: usize,
}

/// Counts work and passes it on; remembers a wish to stop.
struct Meter<'a> {
    progress: &'a dyn Progress,
    done: AtomicU64,
    total: u64,
    cancelled: AtomicBool,
}

impl Meter<'_> {
    fn advance(&self, by: usize) -> bool {
        if self.cancelled.load(Ordering::Relaxed) {
            return false;
        }
        let done = self.done.fetch_add(by as u64, Ordering::Relaxed) + by as u64;
        let go_on = self.progress.update(done.min(self.total), self.total);
        if !go_on {
            self.cancelled.store(true, Ordering::Relaxed);
        }
        go_on
    }
}

/// Grows the whole DAG of a welded mesh.
pub fn grow(
    mut mesh: WeldedMesh,
    options: &BuildOptions,
    progress: &dyn Progress,
    report: &mut BuildReport,
) -> Result<Graph> {
    // Every level halves, so the levels above the source add up to as much again.
    let total = 2 * mesh.faces.len() as u64;
    let meter = Meter { progress, done: AtomicU64::new(0), total, cancelled: AtomicBool::new(false) };
    if !meter.advance(0) {
        return Err(Error::Cancelled);
    }
    let mut store = VertexStore::new(&mut mesh);
    let source_vertices = store.count();
    let clusters = source_clusters(&store, &mesh.faces, options);
    if !meter.advance(mesh.faces.len()) {
        return Err(Error::Cancelled);
    }
    let mut graph = Growth { clusters, groups: Vec::new(), bounds: mesh.bounds, reference: None };
    let mut pending: Vec<u32> = (0..graph.clusters.len() as u32).collect();
    for round in 0.. {
        pending = graph.round(&mut store, pending, round, options, &meter, report)?;
        if pending.is_empty() {
            break;
        }
    }
    for level in &mut report.levels {
        level.max_error *= mesh.frame.scale;
    }
    let face_rows = options.face_ids.then_some(mesh.face_rows);
    Ok(Graph {
        frame: mesh.frame,
        bounds: mesh.bounds,
        store,
        clusters: graph.clusters,
        groups: graph.groups,
        source: (mesh.faces, face_rows),
        source_vertices,
    })
}

fn source_clusters(store: &VertexStore, faces: &[[u32; 3]], options: &BuildOptions) -> Vec<BuildCluster> {
    clusterize::clusterize(store, faces, options)
        .into_par_iter()
        .map(|mesh| {
            let points: Vec<[f32; 3]> = mesh.vertices.iter().map(|v| store.positions[*v as usize]).collect();
            let lod_sphere = Sphere::of_points(&points);
            BuildCluster {
                mesh,
                error: SOURCE_ERROR,
                lod_sphere,
                level: 0,
                refined: NO_GROUP,
                tracked: Vec::new(),
            }
        })
        .collect()
}

struct Growth {
    clusters: Vec<BuildCluster>,
    groups: Vec<BuildGroup>,
    bounds: Aabb,
    reference: Option<Reference>,
}

impl Growth {
    /// One round over the pending clusters; returns those of the next.
    fn round(
        &mut self,
        store: &mut VertexStore,
        pending: Vec<u32>,
        round: u32,
        options: &BuildOptions,
        meter: &Meter<'_>,
        report: &mut BuildReport,
    ) -> Result<Vec<u32>> {
        let meshes: Vec<&ClusterMesh> = pending.iter().map(|c| &self.clusters[*c as usize].mesh).collect();
        let mut level = LevelReport {
            clusters: pending.len() as u32,
            triangles: meshes.iter().map(|m| m.triangles.len() as u64).sum(),
            ..LevelReport::default()
        };
        let positions = RoundPositions::new(store, &meshes);
        let groups = partition(store.layout, &meshes, &positions, options.group_clusters);
        if pending.len() == 1 || round + 1 == MAX_ROUNDS {
            level.groups = groups.len() as u32;
            for group in &groups {
                let members: Vec<u32> = group.iter().map(|c| pending[*c as usize]).collect();
                self.terminal(&members, round);
            }
            report.levels.push(level);
            return Ok(Vec::new());
        }
        let shared = shared_positions(&positions, &groups);
        if options.error == ErrorMeasure::Sampled && Reference::is_due(round) {
            self.start_reference(store, &positions, &pending);
        }
        let meshes: Vec<&ClusterMesh> = pending.iter().map(|c| &self.clusters[*c as usize].mesh).collect();
        let outcomes: Vec<_> = groups
            .par_iter()
            .map(|members| {
                let local = LocalMesh::of_clusters(store, &meshes, &positions, members, &shared);
                let members: Vec<&BuildCluster> =
                    members.iter().map(|c| &self.clusters[pending[*c as usize] as usize]).collect();
                let outcome = simplify_group(store, &local, &members, self.reference.as_ref(), options);
                (meter.advance(local.indices.len() / 6), outcome)
            })
            .collect();
        if outcomes.iter().any(|(go_on, _)| !go_on) {
            return Err(Error::Cancelled);
        }
        level.groups = groups.len() as u32;
        let mut next = Vec::new();
        let mut stuck = Vec::new();
        for (group, (_, outcome)) in groups.iter().zip(outcomes) {
            let members: Vec<u32> = group.iter().map(|c| pending[*c as usize]).collect();
            match outcome {
                Ok(split) => {
                    level.steps[split.step as usize] += 1;
                    level.max_error =
                        level.max_error.max(self.append(store, members, split, round, &mut next)?);
                }
                Err(reason) => stuck.push((members, reason)),
            }
        }
        level.retried = stuck.len() as u32;
        let progress_made = !next.is_empty();
        for (members, reason) in stuck {
            if progress_made {
                // Other neighbours next round: the border that was in the way may lie elsewhere.
                next.extend(members);
            } else {
                report.stuck.push(self.stuck_report(&members, round, reason));
                self.terminal(&members, round);
            }
        }
        report.levels.push(level);
        Ok(next)
    }

    /// Makes the surface of the pending clusters the reference.
    fn start_reference(&mut self, store: &VertexStore, positions: &RoundPositions, pending: &[u32]) {
        let clusters: Vec<&BuildCluster> = pending.iter().map(|c| &self.clusters[*c as usize]).collect();
        let tracked = Reference::track(positions, &clusters);
        self.reference = Some(Reference::new(store, &clusters, &self.bounds));
        for (c, tracked) in pending.iter().zip(tracked) {
            self.clusters[*c as usize].tracked = tracked;
        }
    }

    fn stuck_report(&self, members: &[u32], round: u32, reason: StuckReason) -> StuckGroup {
        let triangles = members.iter().map(|c| self.clusters[*c as usize].mesh.triangles.len() as u32).sum();
        StuckGroup { level: round, clusters: members.len() as u32, triangles, reason }
    }

    fn sphere_of(&self, members: &[u32]) -> Sphere {
        let spheres: Vec<Sphere> = members.iter().map(|c| self.clusters[*c as usize].lod_sphere).collect();
        Sphere::of_spheres(&spheres)
    }

    fn terminal(&mut self, members: &[u32], round: u32) {
        let lod_sphere = self.sphere_of(members);
        self.groups.push(BuildGroup {
            members: members.to_vec(),
            lod_sphere,
            error: ROOT_ERROR,
            level: round,
        });
    }

    /// Adds a simplified group and its clusters; returns its error.
    fn append(
        &mut self,
        store: &mut VertexStore,
        members: Vec<u32>,
        split: Split,
        round: u32,
        next: &mut Vec<u32>,
    ) -> Result<f64> {
        let level = members.iter().map(|c| self.clusters[*c as usize].level).fold(0, u8::max);
        let level = level
            .checked_add(1)
            .ok_or_else(|| Error::TooLarge("more than 255 levels of simplification".into()))?;
        let error = split.error;
        members.iter().for_each(|c| self.clusters[*c as usize].tracked = Vec::new());
        let lod_sphere = self.sphere_of(&members);
        let first = u32::try_from(store.count())
            .ok()
            .filter(|n| n.checked_add(split.new_positions.len() as u32).is_some_and(|n| n <= NEW_VERTEX))
            .ok_or_else(|| Error::TooLarge("more than 2^31 vertices over all levels".into()))?;
        store.positions.extend_from_slice(&split.new_positions);
        store.attributes.extend_from_slice(&split.new_attributes);
        let mut tracked = split.tracked.into_iter();
        for mut mesh in split.clusters {
            for v in &mut mesh.vertices {
                if let Some(new) = v.checked_sub(NEW_VERTEX) {
                    *v = first + new;
                }
            }
            next.push(self.clusters.len() as u32);
            let refined = self.groups.len() as u32;
            let tracked = tracked.next().unwrap_or_default();
            self.clusters.push(BuildCluster { mesh, error, lod_sphere, level, refined, tracked });
        }
        self.groups.push(BuildGroup { members, lod_sphere, error, level: round });
        Ok(f64::from(error))
    }
}

/// The error of a group: what was measured, and a true step above each of its members.
fn parent_error(below: f32, measured: f32) -> f32 {
    measured.max((below * ERROR_STEP).next_up()).max(ERROR_FLOOR)
}

/// Vertices of a split at and above this are new: their number is the rest.
const NEW_VERTEX: u32 = 1 << 31;

/// A simplified group, split into clusters, before its new vertices have identities.
struct Split {
    clusters: Vec<ClusterMesh>,
    new_positions: Vec<[f32; 3]>,
    new_attributes: Vec<f32>,
    /// For each cluster the vertices of the reference nearest to it, when there is a reference.
    tracked: Vec<Vec<Tracked>>,
    /// Parent error of the group.
    error: f32,
    step: super::simplify::Step,
}

fn simplify_group(
    store: &VertexStore,
    local: &LocalMesh,
    members: &[&BuildCluster],
    reference: Option<&Reference>,
    options: &BuildOptions,
) -> std::result::Result<Split, StuckReason> {
    let Simplified { mut mesh, estimate, step } = simplify(local, store.layout, options)?;
    let below = members.iter().map(|c| c.error).fold(0.0, f32::max);
    let mut error = 0.0;
    if reference.is_none() {
        let errors = members.iter().map(|c| (c.error.max(0.0), c.mesh.triangles.len()));
        let errors: Vec<f32> = errors.flat_map(|(error, count)| std::iter::repeat_n(error, count)).collect();
        error = step_error(options.error, local, &mesh, &errors, estimate);
    }
    let stride = store.stride;
    let mut new_positions = Vec::new();
    let mut new_attributes = Vec::new();
    let mut used = vec![false; local.ids.len()];
    mesh.indices.iter().for_each(|v| used[*v as usize] = true);
    for v in (0..local.ids.len()).filter(|v| used[*v]) {
        let row = v * stride..(v + 1) * stride;
        if mesh.positions[v] != local.positions[v]
            || mesh.attributes[row.clone()] != local.attributes[row.clone()]
        {
            mesh.ids[v] = NEW_VERTEX + new_positions.len() as u32;
            new_positions.push(mesh.positions[v]);
            new_attributes.extend_from_slice(&mesh.attributes[row]);
        }
    }
    let clusters = clusterize::clusterize_local(&compact(&mesh, &used), options);
    let mut tracked = Vec::new();
    if let Some(reference) = reference {
        let place = |v: &u32| match v.checked_sub(NEW_VERTEX) {
            Some(new) => new_positions[new as usize],
            None => store.positions[*v as usize],
        };
        let patches: Vec<Patch<'_>> = clusters
            .iter()
            .map(|c| Patch { positions: c.vertices.iter().map(place).collect(), triangles: &c.triangles })
            .collect();
        let arrived: Vec<Tracked> = members.iter().flat_map(|c| &c.tracked).copied().collect();
        (error, tracked) = reference.measure(&arrived, &patches, estimate, SAMPLING_MARGIN);
    }
    let error = parent_error(below, error);
    Ok(Split { clusters, new_positions, new_attributes, tracked, error, step })
}

/// The part of a mesh that its triangles use: the clusterizer works in proportion to the vertices given.
fn compact(mesh: &LocalMesh, used: &[bool]) -> LocalMesh {
    let mut rename = vec![0; used.len()];
    let mut out = LocalMesh::default();
    for v in (0..used.len()).filter(|v| used[*v]) {
        rename[v] = out.ids.len() as u32;
        out.ids.push(mesh.ids[v]);
        out.positions.push(mesh.positions[v]);
    }
    out.indices = mesh.indices.iter().map(|v| rename[*v as usize]).collect();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parent_errors_step_up_from_anything() {
        for (below, measured) in [(0.0, 0.0), (0.0, 1.0e-20), (0.5, 0.0), (1.0e-7, 1.0e-12), (0.25, 0.5)] {
            let error = parent_error(below, measured);
            assert!(error >= below * ERROR_STEP && error >= ERROR_FLOOR && error > below);
            assert!(error >= measured);
        }
    }
}
