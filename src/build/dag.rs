//! The loop that grows the DAG, level by level: group, lock, simplify, split. The groups of a level are simplified
//! in parallel, each on its own copy of its vertices. Their results are appended in the order of the groups, so
//! that nothing depends on which finished first.
//!
//! A level of a group counts these iterations. A level of a cluster counts the simplifications behind it, of which
//! there are fewer where a group was stuck.

use std::sync::Arc;

use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::attribute_error::step_deviation;
use super::clusterize::{self, ClusterMesh};
use super::collapse::{Limit, Policy};
use super::content::{Content, weights};
use super::lock_borders::shared_positions;
use super::memory;
use super::partition::{most_words, partition, split_to_fit};
use super::reference::{Patch, Pieces, Reference};
use super::relax::relax;
use super::silhouette::Silhouette;
use super::simplify::{Effort, Simplified, Step, ratio, simplify, trace};
use super::store::{LevelPositions, LocalMesh, VertexStore};
use super::welding::Welding;
use super::{Meter, Progress};
use crate::config::{BuildOptions, ErrorMeasure, Levels, Quality};
use crate::error::{Error, Result};
use crate::limits::{MAX_LEVELS, ROOT_PAGE_MAX_BYTES};
use crate::math::sphere::round_up;
use crate::math::{Aabb, Sphere};
use crate::mesh::{Channels, WeldedMesh};
use crate::model::cluster::NO_GROUP;
use crate::model::rule::{ERROR_FLOOR, ERROR_STEP, ROOT_ERROR, SOURCE_ERROR};
use crate::model::{AttributeLayout, BuildReport, CoordinateFrame, LevelReport, StuckGroup, StuckReason};

/// A cluster of the growing DAG.
#[derive(Clone, Debug)]
pub struct BuildCluster {
    /// Triangles.
    pub mesh: ClusterMesh,
    /// Own error, of shape and attributes.
    pub error: f32,
    /// Proven distance to the source, and of the source to it; +∞ where nothing is proven.
    pub bound: f32,
    /// Sum of the simplifiers' estimates.
    pub quadric: f32,
    /// Sum of the deviations of attributes, as lengths.
    pub attribute_error: f32,
    /// The rank of the group that made it.
    pub rank: f32,
    /// Sphere of the group that made it.
    pub lod_sphere: Sphere,
    /// Longest chain of simplifications behind it.
    pub level: u8,
    /// The group that made it; [`NO_GROUP`] at level 0.
    pub refined: u32,
    /// What it corresponds to in the reference, until it is simplified.
    pub pieces: Pieces,
}

impl BuildCluster {
    /// A cluster of the source, whose vertices lie at `positions`.
    pub fn of_source(mesh: ClusterMesh, positions: &[[f32; 3]]) -> Self {
        let points: Vec<[f32; 3]> = mesh.vertices.iter().map(|v| positions[*v as usize]).collect();
        Self {
            mesh,
            error: SOURCE_ERROR,
            bound: 0.0,
            quadric: 0.0,
            attribute_error: 0.0,
            rank: 0.0,
            lod_sphere: Sphere::of_points(&points),
            level: 0,
            refined: NO_GROUP,
            pieces: Pieces::default(),
        }
    }
}

/// A group of the growing DAG.
#[derive(Clone, Debug)]
pub struct BuildGroup {
    /// Indices of clusters.
    pub members: Vec<u32>,
    /// Encloses the members' spheres.
    pub lod_sphere: Sphere,
    /// Parent error of the members, of shape and attributes.
    pub error: f32,
    /// Proven distance of what was made of them; +∞ where nothing is proven.
    pub bound: f32,
    /// The simplifiers' estimate of it.
    pub quadric: f32,
    /// Deviation of attributes in what was made of them.
    pub attribute_error: f32,
    /// See [`crate::model::Group::rank`].
    pub rank: f32,
    /// Level in which it was formed.
    pub level: u32,
}

/// The finished DAG before it is laid out in pages.
#[derive(Debug)]
pub struct Graph {
    /// Internal to object space.
    pub frame: CoordinateFrame,
    /// Box of the source.
    pub bounds: Aabb,
    /// All vertices.
    pub store: VertexStore,
    /// The named channels of the source.
    pub channels: Channels,
    /// All clusters.
    pub clusters: Vec<BuildCluster>,
    /// All groups; every cluster is in exactly one.
    pub groups: Vec<BuildGroup>,
    /// Number of faces of the source after mending.
    pub source_faces: usize,
    /// Those faces and their rows in the caller's array, when asked for.
    pub face_rows: Option<(Vec<[u32; 3]>, Vec<u32>)>,
    /// Vertices of the source after welding.
    pub source_vertices: usize,
}

/// What levels grow from: a mesh, or a part of one.
#[derive(Debug)]
pub struct Start {
    /// What it carries.
    pub content: Content,
    /// Its vertices.
    pub store: VertexStore,
    /// Its clusters.
    pub clusters: Vec<BuildCluster>,
    /// All of them are of the source.
    pub is_source: bool,
    /// The first level that is made.
    pub level: u32,
    /// Where it is a part: what is asked of it.
    pub part: Option<Part>,
    /// The silhouette of the source, where area is preserved.
    pub silhouette: Option<Silhouette>,
    /// Faces of the whole source after mending.
    pub source_faces: usize,
}

/// What is asked of a part of a mesh: others have what is beyond its border, and go on with what is left of it.
#[derive(Clone, Debug, Default)]
pub struct Part {
    /// Positions, as bits, that others share: they stay.
    pub fixed: FxHashSet<[u32; 3]>,
    /// Levels grow while there are more triangles.
    pub enough: u64,
    /// Triangles of the whole mesh for each of its own.
    pub share: f64,
    /// A level made next to nothing of the one before.
    pub stalled: bool,
}

/// What has grown.
#[derive(Debug)]
pub struct Grown {
    /// All vertices.
    pub store: VertexStore,
    /// All clusters: those of the start, and those that were made.
    pub clusters: Vec<BuildCluster>,
    /// All groups. Where a part, or what is left of parts, has grown, clusters name them with [`LOCAL_GROUP`] in the number.
    pub groups: Vec<BuildGroup>,
    /// Clusters of a part that are in no group: others go on with them.
    pub pending: Vec<u32>,
}

/// Grows the levels over a start.
pub fn grow_from(
    start: Start,
    options: &BuildOptions,
    meter: &Meter<'_>,
    report: &mut BuildReport,
) -> Result<Grown> {
    let (mut store, mut growth) = Growth::new(start);
    while growth.grow_level(&mut store, options, meter, report)? {}
    Ok(Grown { store, clusters: growth.clusters, groups: growth.groups, pending: growth.pending })
}

/// Grows the whole DAG of a welded mesh.
pub fn grow(
    mesh: WeldedMesh,
    options: &BuildOptions,
    progress: &dyn Progress,
    report: &mut BuildReport,
) -> Result<Graph> {
    let meter = Meter::new(progress, work(mesh.faces.len()));
    let mut growing = Growing::new(mesh, options, &meter, report)?;
    while growing.growth.grow_level(&mut growing.store, options, &meter, report)? {}
    Ok(growing.finish(report))
}

/// Units of work: every triangle is put into a cluster once and, but for a few, removed once.
pub(super) fn work(faces: usize) -> u64 {
    2 * faces as u64
}

/// A whole mesh whose levels grow.
pub(super) struct Growing {
    pub(super) frame: CoordinateFrame,
    bounds: Aabb,
    channels: Channels,
    face_rows: Option<(Vec<[u32; 3]>, Vec<u32>)>,
    pub(super) source_faces: usize,
    source_vertices: usize,
    /// All vertices so far.
    pub(super) store: VertexStore,
    pub(super) growth: Growth,
}

impl Growing {
    /// The clusters of a welded mesh.
    pub(super) fn new(
        mut mesh: WeldedMesh,
        options: &BuildOptions,
        meter: &Meter<'_>,
        report: &mut BuildReport,
    ) -> Result<Self> {
        if !meter.advance(0) {
            return Err(Error::Cancelled);
        }
        // Before the store takes the positions.
        let mut content = Content::new(&mesh, report.computed_normals, options);
        let store = VertexStore::new(&mut mesh);
        let source_vertices = store.count();
        let clusters = source_clusters(&store, &mesh, options);
        content.set_source(&store, &clusters);
        (report.weights, report.preserve_area) = (weights(options), options.preserve_area);
        let WeldedMesh { frame, bounds, faces, face_rows, channels, .. } = mesh;
        let source_faces = faces.len();
        if !meter.advance(source_faces) {
            return Err(Error::Cancelled);
        }
        let seen = || Silhouette::of(bounds, &store.positions, faces.as_flattened());
        let silhouette = options.preserve_area.then(seen);
        // Memory that no option asks for is freed before the levels grow.
        let face_rows = options.face_ids.then_some((faces, face_rows));
        let (store, growth) = Growth::new(Start {
            content,
            store,
            clusters,
            is_source: true,
            level: 0,
            part: None,
            silhouette,
            source_faces,
        });
        Ok(Self { frame, bounds, channels, face_rows, source_faces, source_vertices, store, growth })
    }

    /// The DAG, once all levels are grown.
    pub(super) fn finish(self, report: &mut BuildReport) -> Graph {
        let Self { frame, bounds, channels, face_rows, source_faces, source_vertices, store, growth } = self;
        for level in &mut report.levels {
            level.max_error *= frame.scale;
            level.max_attribute_error *= frame.scale;
        }
        let Growth { clusters, groups, .. } = growth;
        Graph { frame, bounds, store, channels, clusters, groups, source_faces, source_vertices, face_rows }
    }
}

fn source_clusters(store: &VertexStore, mesh: &WeldedMesh, options: &BuildOptions) -> Vec<BuildCluster> {
    clusterize::clusterize(store, &mesh.faces, &mesh.materials, options)
        .into_par_iter()
        .map(|mesh| BuildCluster::of_source(mesh, &store.positions))
        .collect()
}

/// Merges the collapses of several meshes into the order of one queue: the cost of each step, and the triangles it
/// removed. Each mesh is given by its number of triangles and its trace.
pub fn merged<'a>(traces: impl Iterator<Item = (usize, &'a [(f64, u32)])>) -> Vec<(f64, u32)> {
    let mut steps: Vec<(f64, u32)> = Vec::new();
    for (triangles, trace) in traces {
        let mut left = triangles as u32;
        for (cost, after) in trace {
            steps.push((*cost, left.saturating_sub(*after)));
            left = *after;
        }
    }
    steps.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    steps
}

/// The levels of a mesh, or of a part of one, as they grow.
pub(super) struct Growth {
    pub(super) content: Content,
    clusters: Vec<BuildCluster>,
    groups: Vec<BuildGroup>,
    /// The clusters that the next level is made from.
    pending: Vec<u32>,
    /// That level.
    level: u32,
    reference: Option<Reference>,
    /// What it starts from is the source.
    is_source: bool,
    silhouette: Option<Silhouette>,
    source_faces: usize,
    /// A root of at most so many triangles is not simplified further.
    enough: u64,
    part: Option<Part>,
    /// What the next level tries.
    tries: Tries,
    /// How levels do without texture coordinates, where they may.
    pub(super) welding: Option<Welding>,
}

/// What a level tries; the next variant where the level before it made nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Tries {
    /// Collapses up to the cost of the level.
    Cost,
    /// Collapses at any cost.
    Collapses,
    /// Everything.
    Everything,
}

/// A single cluster is simplified further while it has more than this part of the source,
const ROOT_PART: u64 = 100;
/// or more than these: a few are enough for distant meshes.
const ROOT_TRIANGLES: u64 = 32;
/// Fewer triangles make no shape: a cube would end as two back to back.
const FEWEST_TRIANGLES: u64 = 8;
/// A group keeps at least this part of its triangles, however flat it is: its border stays as it is.
const LEAST_PART: f32 = 0.1;
/// One in so many groups is sampled to find the cost of the level; at least and at most so many.
const SAMPLED_PART: usize = 20;
const LEAST_SAMPLED: usize = 4;
const MOST_SAMPLED: usize = 64;
/// Without the cost of a collapse, a rank is at least this part of the bound: single bad points count less for a
/// rank than for an error.
const RANK_OF_BOUND: f32 = 0.6;
/// Samples of the reference count up to so many times the distance of the most expensive collapse.
pub const RELAX_REACH: f64 = 4.0;
/// Levels of less than this part of the source need no more memory than those before.
const SMALL_LEVEL_PART: u64 = 40;

/// A part has ended where a level leaves more than this part of its triangles: borders are what is left.
const STALLED: f64 = 0.85;

impl Growth {
    /// Nothing has grown yet. Its vertices are apart.
    fn new(start: Start) -> (VertexStore, Self) {
        let Start { content, store, clusters, is_source, level, part, silhouette, source_faces } = start;
        let growth = Self {
            content,
            pending: (0..clusters.len() as u32).collect(),
            clusters,
            groups: Vec::new(),
            level,
            reference: None,
            is_source,
            silhouette,
            source_faces,
            enough: (source_faces as u64 / ROOT_PART).clamp(FEWEST_TRIANGLES, ROOT_TRIANGLES),
            part,
            tries: Tries::Cost,
            welding: None,
        };
        (store, growth)
    }

    /// Grows a level; false where there are no more.
    pub(super) fn grow_level(
        &mut self,
        store: &mut VertexStore,
        options: &BuildOptions,
        meter: &Meter<'_>,
        report: &mut BuildReport,
    ) -> Result<bool> {
        if self.pending.is_empty() || self.has_ended(&self.pending) {
            return Ok(false);
        }
        let pending = std::mem::take(&mut self.pending);
        self.pending = self.simplify_level(store, pending, self.level, options, meter, report)?;
        self.level += 1;
        Ok(true)
    }

    fn triangles(&self, clusters: &[u32]) -> u64 {
        clusters.iter().map(|c| self.clusters[*c as usize].mesh.triangles.len() as u64).sum()
    }

    /// Whether others go on with these clusters of a part.
    fn has_ended(&self, pending: &[u32]) -> bool {
        self.part.as_ref().is_some_and(|part| part.stalled || self.triangles(pending) <= part.enough)
    }

    /// Groups and simplifies the clusters of a level; returns those of the next level.
    fn simplify_level(
        &mut self,
        store: &mut VertexStore,
        pending: Vec<u32>,
        level: u32,
        options: &BuildOptions,
        meter: &Meter<'_>,
        report: &mut BuildReport,
    ) -> Result<Vec<u32>> {
        let meshes: Vec<&ClusterMesh> = pending.iter().map(|c| &self.clusters[*c as usize].mesh).collect();
        let mut counts = LevelReport {
            clusters: pending.len() as u32,
            triangles: self.triangles(&pending),
            ..LevelReport::default()
        };
        let positions = Arc::new(LevelPositions::new(store, &meshes));
        let groups = partition(store.layout, &meshes, &positions, options);
        let single = pending.len() == 1 && self.part.is_none();
        let last = options.levels == Levels::One || level + 1 == MAX_LEVELS;
        if self.part.is_none() && (single && counts.triangles <= self.enough || last) {
            counts.groups = groups.len() as u32;
            for group in &groups {
                let members: Vec<u32> = group.iter().map(|c| pending[*c as usize]).collect();
                self.terminal(store.layout, &members, level);
            }
            report.levels.push(counts);
            return Ok(Vec::new());
        }
        let mut shared = shared_positions(&positions, &groups);
        if let Some(part) = &self.part {
            let is_fixed = |p: &[f32; 3]| part.fixed.contains(&p.map(f32::to_bits));
            let places = shared.par_iter_mut().zip(&positions.positions);
            places.for_each(|(shared, p)| *shared |= is_fixed(p));
        }
        let (source, is_stuck) = (self.source_faces as u64, self.tries != Tries::Cost);
        if let Some(welding) = &mut self.welding {
            welding.is_on =
                welding.begins(counts.triangles, source, is_stuck, || welding.seam_part(store, &meshes));
        }
        let share = self.part.as_ref().map_or(1.0, |part| part.share);
        let ratio = ratio((counts.triangles as f64 * share) as u64, options);
        let cost = self.cost(store, &meshes, &positions, &groups, &shared, ratio, options);
        let effort = Effort { cost, fallbacks: self.tries == Tries::Everything || single };
        let part = if cost.is_finite() { LEAST_PART } else { ratio };
        if options.error == ErrorMeasure::Bound {
            // Each level measures with blocks of other sizes. What is trimmed has to be fetched again.
            if SMALL_LEVEL_PART * counts.triangles > self.source_faces as u64 {
                memory::trim_heap(self.source_faces);
            }
            if self.reference.as_ref().is_none_or(Reference::has_served) {
                self.start_reference(&positions, &pending);
            }
            let pieces = pending.iter().map(|c| &self.clusters[*c as usize].pieces);
            let target = counts.triangles as f32 * ratio;
            let ends = self.part.as_ref().is_some_and(|part| target <= part.enough as f32);
            self.reference.iter_mut().for_each(|r| r.begin(target, ends, pieces.clone()));
        }
        // A group frees the pieces of its members, and returns them where it is stuck.
        let mut take = |c: &u32| std::mem::take(&mut self.clusters[pending[*c as usize] as usize].pieces);
        let pieces: Vec<Vec<Pieces>> = groups.iter().map(|g| g.iter().map(&mut take).collect()).collect();
        let meshes: Vec<&ClusterMesh> = pending.iter().map(|c| &self.clusters[*c as usize].mesh).collect();
        // A single group is the whole mesh. It is compared with the source, so that no differences add up.
        let silhouette = self.silhouette.filter(|_| groups.len() == 1 && self.part.is_none());
        let outcomes: Vec<_> = groups
            .par_iter()
            .zip(pieces)
            // One at a time: threads steal what others have not begun.
            .with_max_len(1)
            .map(|(members, pieces)| {
                let local = self.local(store, &meshes, &positions, members, &shared);
                let members: Vec<&BuildCluster> =
                    members.iter().map(|c| &self.clusters[pending[*c as usize] as usize]).collect();
                let proof = self.reference.as_ref().map(|reference| Proof { reference, all: &self.clusters });
                let triangles = local.indices.len() / 3;
                let target = (triangles as f32 * part) as usize;
                let group =
                    GroupMesh { clusters: &members, mesh: &local, pieces, target, effort, silhouette };
                let outcome = simplify_group(store, group, self.made(options), proof);
                let made = outcome.as_ref().map_or(triangles, |split| split.triangles());
                (meter.advance(triangles - made.min(triangles)), outcome)
            })
            .collect();
        if outcomes.iter().any(|(proceed, _)| !proceed) {
            return Err(Error::Cancelled);
        }
        counts.groups = groups.len() as u32;
        let mut next = Vec::new();
        let mut stuck = Vec::new();
        for (group, (_, outcome)) in groups.iter().zip(outcomes) {
            let members: Vec<u32> = group.iter().map(|c| pending[*c as usize]).collect();
            match outcome {
                Ok(split) => {
                    counts.steps[split.step as usize] += 1;
                    let (shape, attributes) = self.append(store, members, split, level, &mut next)?;
                    counts.max_error = counts.max_error.max(shape.into());
                    counts.max_attribute_error = counts.max_attribute_error.max(attributes.into());
                }
                Err((reason, pieces)) => {
                    members.iter().zip(pieces).for_each(|(c, p)| self.clusters[*c as usize].pieces = p);
                    stuck.push((members, reason));
                }
            }
        }
        counts.retried = stuck.len() as u32;
        let progress_made = !next.is_empty();
        let last = self.tries == Tries::Everything || single;
        self.tries = match self.tries {
            _ if progress_made => Tries::Cost,
            Tries::Cost => Tries::Collapses,
            _ => Tries::Everything,
        };
        for (members, reason) in stuck {
            if progress_made || !last || self.part.is_some() {
                // The next level has other groups: the locked border that was in the way may lie elsewhere.
                next.extend(members);
            } else {
                if !single {
                    report.stuck.push(self.stuck_report(&members, level, reason));
                }
                self.terminal(store.layout, &members, level);
            }
        }
        if self.part.is_some() {
            let few = self.triangles(&next) as f64 > STALLED * counts.triangles as f64;
            let stalled = few && self.tries != Tries::Collapses;
            self.part.iter_mut().for_each(|part| part.stalled = stalled);
        }
        report.levels.push(counts);
        Ok(next)
    }

    /// How the level is welded, if it is.
    fn welding(&self) -> Option<&Welding> {
        self.welding.as_ref().filter(|welding| welding.is_on)
    }

    /// The mesh of a group.
    fn local(
        &self,
        store: &VertexStore,
        meshes: &[&ClusterMesh],
        positions: &LevelPositions,
        members: &[u32],
        shared: &[bool],
    ) -> LocalMesh {
        let local = LocalMesh::of_clusters(store, meshes, positions, members, shared);
        self.welding().map(|welding| welding.weld(&local)).unwrap_or(local)
    }

    /// What groups are made into.
    fn made<'a>(&'a self, options: &'a BuildOptions) -> Making<'a> {
        match self.welding() {
            Some(welding) => {
                Making { content: &welding.content, options: &welding.options, welding: Some(welding) }
            }
            None => Making { content: &self.content, options, welding: None },
        }
    }

    /// The largest cost of a collapse of the level: with it a sample of the groups keeps `ratio` of its triangles.
    /// One cost for all groups acts as one queue for all: flat parts are simplified first.
    fn cost(
        &self,
        store: &VertexStore,
        meshes: &[&ClusterMesh],
        positions: &LevelPositions,
        groups: &[Vec<u32>],
        shared: &[bool],
        ratio: f32,
        options: &BuildOptions,
    ) -> f64 {
        let of_triangles = options.quality == Quality::Fast || options.preserve_area;
        if of_triangles || groups.len() < 2 || self.tries != Tries::Cost {
            return f64::INFINITY;
        }
        let count = (groups.len() / SAMPLED_PART).clamp(LEAST_SAMPLED, MOST_SAMPLED).min(groups.len());
        let traces: Vec<(usize, Vec<(f64, u32)>)> = (0..count)
            .into_par_iter()
            .with_max_len(1)
            .map(|i| {
                let members = &groups[i * groups.len() / count];
                let local = self.local(store, meshes, positions, members, shared);
                let triangles = local.indices.len() / 3;
                let target = (triangles as f32 * 0.5 * ratio) as usize;
                (triangles, trace(&local, Limit::triangles(target), self.made(options).content, options))
            })
            .collect();
        let total: usize = traces.iter().map(|(triangles, _)| triangles).sum();
        let steps = merged(traces.iter().map(|(triangles, trace)| (*triangles, &trace[..])));
        let mut gone = (total as f32 * (1.0 - ratio)) as i64;
        for (cost, removed) in steps {
            gone -= i64::from(removed);
            if gone <= 0 {
                return cost;
            }
        }
        f64::INFINITY
    }

    /// Makes the surface of the pending clusters the reference.
    fn start_reference(&mut self, positions: &Arc<LevelPositions>, pending: &[u32]) {
        let is_source = self.is_source && self.reference.is_none();
        let reference = Reference::new(is_source, Arc::clone(positions), pending, &self.clusters);
        let pieces: Vec<Pieces> = reference.pieces(&self.clusters).collect();
        pending.iter().zip(pieces).for_each(|(c, pieces)| self.clusters[*c as usize].pieces = pieces);
        self.reference = Some(reference);
    }

    fn stuck_report(&self, members: &[u32], level: u32, reason: StuckReason) -> StuckGroup {
        let triangles = self.triangles(members) as u32;
        StuckGroup { level, clusters: members.len() as u32, triangles, reason }
    }

    fn sphere_of(&self, members: &[u32]) -> Sphere {
        let spheres: Vec<Sphere> = members.iter().map(|c| self.clusters[*c as usize].lod_sphere).collect();
        Sphere::of_spheres(&spheres)
    }

    /// Adds a root group, in parts that fit root pages.
    fn terminal(&mut self, layout: AttributeLayout, members: &[u32], level: u32) {
        let words = |c: u32| most_words(layout, &self.clusters[c as usize].mesh);
        for members in split_to_fit(members, ROOT_PAGE_MAX_BYTES, &words) {
            let lod_sphere = self.sphere_of(&members);
            self.groups.push(BuildGroup {
                members,
                lod_sphere,
                error: ROOT_ERROR,
                bound: ROOT_ERROR,
                quadric: ROOT_ERROR,
                attribute_error: 0.0,
                rank: ROOT_ERROR,
                level,
            });
        }
    }

    /// Adds a simplified group and its clusters; returns its errors, of shape and attributes.
    fn append(
        &mut self,
        store: &mut VertexStore,
        members: Vec<u32>,
        split: Split,
        group_level: u32,
        next: &mut Vec<u32>,
    ) -> Result<(f32, f32)> {
        let level = members.iter().map(|c| self.clusters[*c as usize].level).fold(0, u8::max);
        let level = level
            .checked_add(1)
            .ok_or_else(|| Error::TooLarge("more than 255 levels of simplification".into()))?;
        let Split { error, bound, quadric, attribute_error, rank, .. } = split;
        let lod_sphere = self.sphere_of(&members);
        let first = u32::try_from(store.count())
            .ok()
            .filter(|n| n.checked_add(split.new_positions.len() as u32).is_some_and(|n| n <= NEW_VERTEX))
            .ok_or_else(|| Error::TooLarge("more than 2^31 vertices over all levels".into()))?;
        store.positions.extend_from_slice(&split.new_positions);
        store.attributes.extend_from_slice(&split.new_attributes);
        store.labels.extend_from_slice(&split.new_labels);
        let mut pieces = split.pieces.into_iter();
        for mut mesh in split.clusters {
            for v in &mut mesh.vertices {
                if let Some(new) = v.checked_sub(NEW_VERTEX) {
                    *v = first + new;
                }
            }
            next.push(self.clusters.len() as u32);
            let refined =
                LOCAL_GROUP * u32::from(self.part.is_some() || !self.is_source) + self.groups.len() as u32;
            let pieces = pieces.next().unwrap_or_default();
            self.clusters.push(BuildCluster {
                mesh,
                error,
                bound,
                quadric,
                attribute_error,
                rank,
                lod_sphere,
                level,
                refined,
                pieces,
            });
        }
        self.groups.push(BuildGroup {
            members,
            lod_sphere,
            error,
            bound,
            quadric,
            attribute_error,
            rank,
            level: group_level,
        });
        Ok((if bound.is_finite() { bound } else { quadric }, attribute_error))
    }
}

/// The error of a group: what was measured, and a true step above each of its members.
pub(super) fn parent_error(below: f32, measured: f32) -> f32 {
    measured.max((below * ERROR_STEP).next_up()).max(ERROR_FLOOR)
}

/// In the names that clusters of a part have for the groups that made them: a group of that part.
pub const LOCAL_GROUP: u32 = 1 << 31;

/// The number over all parts of the group that a cluster of one names, whose own groups begin at `first`; [`NO_GROUP`] where it
/// names none.
pub fn group_number(named: u32, first: u32) -> u32 {
    match named {
        NO_GROUP => NO_GROUP,
        local if local & LOCAL_GROUP != 0 => first + (local ^ LOCAL_GROUP),
        global => global,
    }
}

/// Vertices of a split at and above this are new: their number is the rest.
const NEW_VERTEX: u32 = 1 << 31;

/// A simplified group, split into clusters, before its new vertices have identities.
struct Split {
    clusters: Vec<ClusterMesh>,
    new_positions: Vec<[f32; 3]>,
    new_attributes: Vec<f32>,
    new_labels: Vec<u32>,
    /// What each cluster corresponds to, if the next level has the same reference.
    pieces: Vec<Pieces>,
    /// Parent error of the group.
    error: f32,
    bound: f32,
    quadric: f32,
    attribute_error: f32,
    rank: f32,
    step: Step,
}

/// What the errors of a level are proven against.
#[derive(Clone, Copy)]
struct Proof<'a> {
    reference: &'a Reference,
    all: &'a [BuildCluster],
}

impl Split {
    fn triangles(&self) -> usize {
        self.clusters.iter().map(|c| c.triangles.len()).sum()
    }
}

/// A group that is to be simplified.
struct GroupMesh<'a> {
    clusters: &'a [&'a BuildCluster],
    /// Their triangles.
    mesh: &'a LocalMesh,
    /// What each of them corresponds to.
    pieces: Vec<Pieces>,
    target: usize,
    effort: Effort,
    silhouette: Option<Silhouette>,
}

/// How groups of a level are made into coarser ones.
#[derive(Clone, Copy)]
struct Making<'a> {
    content: &'a Content,
    options: &'a BuildOptions,
    welding: Option<&'a Welding>,
}

fn simplify_group(
    store: &VertexStore,
    group: GroupMesh<'_>,
    making: Making<'_>,
    proof: Option<Proof<'_>>,
) -> std::result::Result<Split, (StuckReason, Vec<Pieces>)> {
    let Making { content, options, welding } = making;
    let GroupMesh { clusters: members, mesh: local, pieces, target, effort, silhouette } = group;
    let Simplified { mut mesh, estimate, step_error, moved, cost, step } =
        match simplify(local, target, effort, content, options, silhouette) {
            Ok(simplified) => simplified,
            Err(reason) => return Err((reason, pieces)),
        };
    let correspondence = proof.map(|Proof { reference, all }| reference.correspondence(pieces, all));
    if let Some(correspondence) = &correspondence
        && step <= Step::Topology
        && options.quality == Quality::Best
        && !options.preserve_area
        // A vertex that moves along the surface would take its attributes along.
        && content.is_bare()
    {
        let made = mesh.indices.len() / 3;
        let reach = RELAX_REACH * f64::from(step_error);
        relax(&mut mesh, correspondence.surface(), reach, content.up, |visit| {
            correspondence.samples(made, visit)
        });
    }
    // Without a measurement, the estimate includes what islands moved.
    let estimate = if proof.is_none() { estimate.max(moved) } else { estimate };
    let most = |of: fn(&BuildCluster) -> f32| members.iter().map(|c| of(c)).fold(0.0, f32::max);
    let quadric = round_up(f64::from(most(|c| c.quadric)) + f64::from(estimate));
    let stride = store.stride;
    let mut new_positions = Vec::new();
    let mut new_attributes = Vec::new();
    let mut new_labels = Vec::new();
    mesh.join_copies(|mesh, v| mesh.differs(local, v));
    let mut used = vec![false; mesh.ids.len()];
    mesh.indices.iter().for_each(|v| used[*v as usize] = true);
    for v in (0..mesh.ids.len()).filter(|v| used[*v]) {
        // A welded vertex is none of the store.
        if welding.is_some() || mesh.differs(local, v) {
            mesh.ids[v] = NEW_VERTEX + new_positions.len() as u32;
            new_positions.push(mesh.positions[v]);
            new_attributes.extend_from_slice(&mesh.attributes[v * stride..(v + 1) * stride]);
            new_labels.extend(mesh.labels.get(v));
        }
    }
    let clusters = clusterize::clusterize_local(&compact(&mesh, &used), options);
    let (mut bound, mut handed) = (f32::INFINITY, Vec::new());
    if let Some(correspondence) = correspondence {
        let place = |v: u32| match v.checked_sub(NEW_VERTEX) {
            Some(new) => new_positions[new as usize],
            None => store.positions[v as usize],
        };
        let patches: Vec<Patch<'_>> = clusters.iter().map(|c| Patch::new(c, place)).collect();
        (bound, handed) = correspondence.measure(&patches, estimate);
        bound = parent_error(most(|c| c.bound), bound);
    }
    let distance = if bound.is_finite() { bound } else { quadric };
    // The proven bound counts. Without a cost for the rank, the estimate keeps frames as close in the mean.
    let shape = if cost.is_some() { distance } else { distance.max(quadric) };
    let deviation = step_deviation(local, &mesh, content, distance);
    // What is baked from the source does not deviate by what the levels before had to: nothing else is carried along.
    let is_baked_anew =
        |c: &BuildCluster| welding.is_some_and(|w| !content.is_measured() && !w.is_welded(c.mesh.material));
    let carried = |c: &&&BuildCluster| !is_baked_anew(c);
    let inherited = members.iter().filter(carried).map(|c| c.attribute_error).fold(0.0, f32::max);
    let attribute_error = round_up(f64::from(inherited) + f64::from(deviation));
    let error = parent_error(most(|c| c.error), shape.max(attribute_error));
    let rank = match cost {
        Some(cost) => (Policy::default().length_of(cost) as f32).max(most(|c| c.rank)),
        None => quadric.max(RANK_OF_BOUND * distance).max(attribute_error).max(most(|c| c.rank)),
    };
    Ok(Split {
        clusters,
        new_positions,
        new_attributes,
        new_labels,
        pieces: handed,
        error,
        bound,
        quadric,
        attribute_error,
        rank,
        step,
    })
}

/// The part of a mesh that its triangles use: the clusterizer works in proportion to the vertices given.
fn compact(mesh: &LocalMesh, used: &[bool]) -> LocalMesh {
    let mut rename = vec![0; used.len()];
    let mut out = LocalMesh::default();
    for v in (0..used.len()).filter(|v| used[*v]) {
        rename[v] = out.ids.len() as u32;
        out.ids.push(mesh.ids[v]);
        out.positions.push(mesh.positions[v]);
        out.materials.extend(mesh.materials.get(v));
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
