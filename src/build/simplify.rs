//! Simplifying one group, and the chain of fallbacks.
//!
//! The simplifier is `collapse` or, where speed matters more, meshoptimizer's, with vertices moved to their optimum
//! and attributes in the metric (Garland and Heckbert 1997; Hoppe, "New Quadric Metric for Simplifying Meshes with Appearance Attributes",
//! 1999). The chain: attribute-aware with seams protected → permissive (seams may collapse, loose parts may
//! go) → sloppy → give up.

use glam::DVec3;
use meshopt::{
    SimplifyOptions, SimplifyVertex, VertexDataAdapter, simplify_sloppy_with_locks, simplify_with_update,
};
use rustc_hash::FxHashSet;

use super::collapse::{Collapsed, Collapses, Limit, Policy, collapse};
use super::content::{Content, up};
use super::field::Field;
use super::islands::Islands;
use super::lock_borders::border_kept;
use super::silhouette::Silhouette;
use super::store::LocalMesh;
use crate::config::{BuildOptions, ErrorMeasure, Quality};
use crate::math::Aabb;
use crate::math::sphere::round_up;
use crate::math::triangle::{area, edge_of_area};
use crate::mesh::edges::{Edge, Edges};
use crate::mesh::hash;
use crate::model::StuckReason;

/// Part of the triangles that a level keeps.
const TARGET_RATIO: f32 = 0.5;
/// The same with the best quality, where a level has at most [`FINE_TRIANGLES`]: what is locked stays dense for less
/// long, and a cut of any size finds levels near it. A tenth to a fifth less error at the same size, for two thirds
/// more triangles stored, which is little where there are few.
const FINE_RATIO: f32 = 0.7;
const FINE_TRIANGLES: u64 = 1 << 18;
/// A result that keeps more than this part of the triangles is no level.
const ACCEPT_RATIO: f32 = 0.85;

/// Repeats of the first step, each with more vertices locked, before a change of topology is accepted.
const TOPOLOGY_RETRIES: usize = 3;

/// A step of the chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Step {
    /// Attribute-aware, seams protected, topology kept.
    Attributes,
    /// The same, but the topology changed: a handle or a small component collapsed.
    Topology,
    /// Collapses across attribute seams, small components pruned.
    Permissive,
    /// Vertex clustering.
    Sloppy,
    /// With the fast quality, the collapses of the best quality where meshoptimizer's would join sheets or groups.
    /// Their result counts as one of the first two.
    Collapses,
}

impl Step {
    const CHAIN: [Self; 4] = [Self::Attributes, Self::Collapses, Self::Permissive, Self::Sloppy];
}

/// A simplified group.
#[derive(Debug)]
pub struct Simplified {
    /// The simplified mesh; `ids` still name the vertices it came from.
    pub mesh: LocalMesh,
    /// The simplifier's estimate of the distance to the group's own input, internal units.
    pub estimate: f32,
    /// The same without what removed components add to it.
    pub step_error: f32,
    /// What removed and scaled islands add to it: a bound of the distance of their points.
    pub moved: f32,
    /// The largest cost of a collapse, if collapses made it: see [`super::collapse::Collapsed::cost`].
    pub cost: Option<f64>,
    /// The step that made it.
    pub step: Step,
}

/// How far groups are simplified.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// The largest cost of a collapse, with the best quality.
    pub cost: f64,
    /// Whether steps that change the topology are allowed.
    pub fallbacks: bool,
}

impl Effort {
    /// Any step that simplifies a group.
    pub const ANY: Self = Self { cost: f64::INFINITY, fallbacks: true };
}

/// The part of its triangles that a level of `triangles` keeps.
pub fn ratio(triangles: u64, options: &BuildOptions) -> f32 {
    let fine = options.quality == Quality::Best && triangles <= FINE_TRIANGLES;
    // Islands are removed one at a time: more levels would only let the covered area drift.
    if fine && !options.preserve_area { FINE_RATIO } else { TARGET_RATIO }
}

/// Simplifies a group to `target` triangles. With `preserve_area` it covers as much as before, or as much as in
/// `silhouette`.
pub fn simplify(
    mesh: &LocalMesh,
    target: usize,
    effort: Effort,
    content: &Content,
    options: &BuildOptions,
    silhouette: Option<Silhouette>,
) -> Result<Simplified, StuckReason> {
    if options.preserve_area
        && let Ok(result) = with_islands(mesh, target, content, options, silhouette)
    {
        return Ok(result);
    }
    chain(mesh, target, effort, content, options)
}

/// The trace of a group's collapses: the largest cost so far, and the triangles that were left.
pub fn trace(mesh: &LocalMesh, limit: Limit, content: &Content, options: &BuildOptions) -> Vec<(f64, u32)> {
    let guides = Guides::new(mesh, content, content.stride(), mean_edge(mesh), true);
    collapse(mesh, &mesh.locked, guides.rows, &guides.weights, limit, &policy(content, options)).trace
}

/// A mesh after the collapses of its quality, without the steps of the chain that follow them.
pub fn reduce(mesh: &LocalMesh, limit: Limit, content: &Content, options: &BuildOptions) -> Finished {
    let made = run(mesh, &mesh.locked, limit, content, options, Step::Attributes);
    Finished { mesh: made.mesh, estimate: made.error, moved: made.moved }
}

/// The same with the best quality, as collapses that can be resumed.
pub struct Reduction {
    collapses: Collapses,
    /// Columns of the mesh that steer collapses, all columns, and the mean edge length.
    own: usize,
    width: usize,
    edge: f32,
}

impl Reduction {
    /// Evaluates the edges of a mesh.
    pub fn new(mesh: &LocalMesh, content: &Content, options: &BuildOptions) -> Self {
        let edge = mean_edge(mesh);
        let Guides { rows, weights, own } = Guides::new(mesh, content, content.stride(), edge, true);
        let collapses = Collapses::new(mesh, &mesh.locked, rows, &weights, &policy(content, options));
        Self { collapses, own, width: weights.len(), edge }
    }

    /// Its collapses.
    pub fn collapses(&mut self) -> &mut Collapses {
        &mut self.collapses
    }

    /// The simplified mesh.
    pub fn finish(self, mesh: &LocalMesh, content: &Content) -> Finished {
        let Collapsed { mesh: mut made, error, moved, .. } = self.collapses.finish(mesh);
        restore_columns(&mut made, mesh, content, self.own, self.width, self.edge);
        Finished { mesh: made, estimate: error, moved }
    }
}

/// The policy of our own collapses for a group.
fn policy(content: &Content, options: &BuildOptions) -> Policy {
    Policy { cuts: !options.preserve_area, up: content.up, ..Policy::default() }
}

/// Islands are removed or scaled as a whole. The rest is simplified by the chain, and its open islands keep their
/// area.
fn with_islands(
    mesh: &LocalMesh,
    target: usize,
    content: &Content,
    options: &BuildOptions,
    silhouette: Option<Silhouette>,
) -> Result<Simplified, StuckReason> {
    let islands = Islands::of(mesh);
    let (leaves, rest) = islands.split(mesh);
    let rest = LocalMesh { indices: rest, ..mesh.clone() };
    let bounds = Aabb::of_points(&mesh.positions);
    let silhouette = silhouette.unwrap_or_else(|| Silhouette::of(bounds, &mesh.positions, &mesh.indices));
    let rest_sight =
        if leaves.is_empty() { silhouette } else { Silhouette::of(bounds, &rest.positions, &rest.indices) };
    let share = target * rest.indices.len() / mesh.indices.len().max(1);
    let outcome = if rest.indices.is_empty() {
        Err(StuckReason::Vanished)
    } else {
        chain(&rest, share, Effort::ANY, content, options)
    };
    let mut result = match outcome {
        // Vertex clustering ignores islands, and takes most of a trunk's area. Where leaves can go, the rest waits.
        Ok(result) if leaves.is_empty() || result.step != Step::Sloppy => result,
        Err(reason) if leaves.is_empty() => return Err(reason),
        _ => Simplified {
            mesh: rest,
            estimate: 0.0,
            step_error: 0.0,
            moved: 0.0,
            cost: None,
            step: Step::Permissive,
        },
    };
    let grew = if result.step == Step::Sloppy { 0.0 } else { islands.restore(&mut result.mesh, &rest_sight) };
    let mut moved = f64::from(result.estimate) + grew;
    if !leaves.is_empty() {
        let target = target.saturating_sub(result.mesh.indices.len() / 3);
        let target = target.clamp(leaves.len() / 12, leaves.len() / 6);
        let thinned = islands.thin(&result.mesh, &leaves, target, &silhouette, false);
        let rest = std::mem::replace(&mut result.mesh, thinned.mesh);
        result.mesh.indices.extend(rest.indices);
        moved = moved.max(thinned.moved);
        result.step = result.step.max(Step::Permissive);
    }
    result.moved = round_up(moved);
    if result.mesh.indices.len() as f32 > mesh.indices.len() as f32 * ACCEPT_RATIO {
        return Err(StuckReason::TooFewCollapses);
    }
    if keeps_border(mesh, &result.mesh) { Ok(result) } else { Err(StuckReason::BorderChanged) }
}

/// Whether a group's border to others is unchanged.
fn keeps_border(before: &LocalMesh, after: &LocalMesh) -> bool {
    let was: Vec<[u32; 3]> = faces(&before.indices, |v| before.position_ids[v as usize]).collect();
    border_kept(&Edges::of(&was), &Edges::of(&by_position(before, after)), is_locked(before))
}

/// The first step of the chain that simplifies a group.
fn chain(
    mesh: &LocalMesh,
    target: usize,
    effort: Effort,
    content: &Content,
    options: &BuildOptions,
) -> Result<Simplified, StuckReason> {
    let mut reason = StuckReason::TooFewCollapses;
    let before: Vec<[u32; 3]> = faces(&mesh.indices, |v| mesh.position_ids[v as usize]).collect();
    // Sheets with every face in both windings have no border for meshoptimizer, which compares positions.
    let doubled = options.quality == Quality::Fast && !options.preserve_area && has_both_windings(&before);
    let before = Topology::of(&before);
    let is_tried = |step: &Step| match step {
        Step::Attributes => !doubled,
        // These are the collapses of the first step.
        Step::Collapses => doubled || has_collapses(content, options) && !options.preserve_area,
        _ => effort.fallbacks || options.quality == Quality::Fast && !is_strict(content, options),
    };
    for step in Step::CHAIN.into_iter().filter(is_tried) {
        match attempt(mesh, &before, target, effort, content, options, step) {
            Ok(result) => return Ok(result),
            Err(StuckReason::TooFewCollapses) => {}
            Err(StuckReason::TooDear) => return Err(StuckReason::TooDear),
            Err(other) => reason = other,
        }
    }
    Err(reason)
}

/// Whether any face occurs in both windings.
fn has_both_windings(faces: &[[u32; 3]]) -> bool {
    let first = |face: &[u32; 3]| face.iter().zip(0..).min().map_or(0, |(_, k)| k);
    let from = |face: &[u32; 3], k: usize| [0, 1, 2].map(|i| face[(k + i) % 3]);
    let known: FxHashSet<[u32; 3]> = faces.iter().map(|face| from(face, first(face))).collect();
    known.iter().any(|[a, b, c]| known.contains(&[*a, *c, *b]))
}

/// With the fast quality, whether our own collapses follow where meshoptimizer's fail. Not where attributes steer
/// it.
fn has_collapses(content: &Content, options: &BuildOptions) -> bool {
    options.quality == Quality::Fast && content.is_bare()
}

/// Whether they also follow where meshoptimizer joins sheets. Not where its estimates are the stated error: ours
/// are of another kind.
fn is_strict(content: &Content, options: &BuildOptions) -> bool {
    has_collapses(content, options) && options.error == ErrorMeasure::Bound
}

/// Whether a step is by our own collapses.
fn is_collapse(step: Step, options: &BuildOptions) -> bool {
    step == Step::Collapses || step == Step::Attributes && options.quality == Quality::Best
}

/// One step of the chain, checked and measured.
fn attempt(
    mesh: &LocalMesh,
    before: &Topology,
    target: usize,
    effort: Effort,
    content: &Content,
    options: &BuildOptions,
    step: Step,
) -> Result<Simplified, StuckReason> {
    let most = (mesh.indices.len() / 3) as f32 * ACCEPT_RATIO;
    let limit = Limit { cost: effort.cost, ..Limit::triangles(target) };
    let checked = |locked: &[bool]| {
        let Made { mesh: result, error, moved, cost, stopped } =
            run(mesh, locked, limit, content, options, step);
        let left = result.indices.len() / 3;
        if left == 0 {
            return Err(StuckReason::Vanished);
        }
        if left as f32 > most {
            return Err(if stopped { StuckReason::TooDear } else { StuckReason::TooFewCollapses });
        }
        if !keeps_materials(&result) {
            return Err(StuckReason::MixedMaterials);
        }
        let after = by_position(mesh, &result);
        let topology = Topology::of(&after);
        let kept = border_kept(&before.edges, &topology.edges, is_locked(mesh));
        if kept {
            Ok((result, (error, moved, cost), after, topology))
        } else {
            Err(StuckReason::BorderChanged)
        }
    };
    let (mut result, mut error, mut after, mut topology) = checked(&mesh.locked)?;
    let is_strict = is_strict(content, options);
    if step == Step::Attributes && options.quality == Quality::Fast && !is_strict {
        let mut locked = mesh.locked.clone();
        // meshoptimizer has no link condition: where sheets were pinched together, lock the vertices where they met
        // and repeat.
        for _ in 0..TOPOLOGY_RETRIES {
            if topology.crowded.len() <= before.crowded.len() {
                break;
            }
            let ends: FxHashSet<u32> = topology.crowded.iter().flat_map(|e| [e.0, e.1]).collect();
            // Vertices of the result are numbered like those of the group, wherever they moved.
            let corners = after.iter().flatten().zip(&result.indices);
            let met = corners.filter(|(p, _)| ends.contains(p));
            let met: FxHashSet<u32> = met.map(|(_, v)| mesh.position_ids[*v as usize]).collect();
            locked.iter_mut().zip(&mesh.position_ids).for_each(|(lock, p)| *lock |= met.contains(p));
            let Ok(again) = checked(&locked) else { break };
            (result, error, after, topology) = again;
        }
    }
    // Sheets were pinched together, or locked points joined, which two groups could each do. Our own collapses
    // follow, which prevent both. The steps after them are better than a root that stays large.
    if step == Step::Attributes
        && is_strict
        && (topology.crowded.len() > before.crowded.len()
            || joins_locked(&before.edges, &topology.edges, is_locked(mesh)))
    {
        return Err(StuckReason::TooFewCollapses);
    }
    if content.up.is_some_and(|up| faces_away(mesh, up) < faces_away(&result, up)) {
        return Err(StuckReason::TooFewCollapses);
    }
    let mut done = step;
    if matches!(step, Step::Attributes | Step::Collapses) {
        done = if topology.same_as(before) { Step::Attributes } else { Step::Topology };
    }
    let (estimate, step_error, cost) = error;
    Ok(Simplified { mesh: result, estimate, step_error, moved: 0.0, cost, step: done })
}

/// Whether an edge between locked points is new.
fn joins_locked(before: &Edges, after: &Edges, locked: impl Fn(u32) -> bool) -> bool {
    let between = |e: &Edge| locked(e.ends.0) && locked(e.ends.1);
    after.iter().filter(between).any(|edge| !before.at(edge.ends.0).any(|e| e.ends == edge.ends))
}

/// Triangles that do not face a direction.
fn faces_away(mesh: &LocalMesh, up: DVec3) -> usize {
    let away = |t: &&[u32]| {
        let [a, b, c] = [0, 1, 2].map(|k| DVec3::from_array(mesh.positions[t[k] as usize].map(f64::from)));
        (b - a).cross(c - a).dot(up) <= 0.0
    };
    mesh.indices.chunks_exact(3).filter(away).count()
}

/// Whether points of [`by_position`] are locked.
fn is_locked(mesh: &LocalMesh) -> impl Fn(u32) -> bool {
    |p| mesh.locked.get(p as usize).copied().unwrap_or(false)
}

/// Whether no triangle has corners of several materials.
fn keeps_materials(mesh: &LocalMesh) -> bool {
    let same = |t: &[u32]| t.iter().all(|v| mesh.materials[*v as usize] == mesh.materials[t[0] as usize]);
    mesh.materials.is_empty() || mesh.indices.chunks_exact(3).all(same)
}

/// For each vertex whether others of its position have another entry of `values`, if there are any.
fn differ_at_position(mesh: &LocalMesh, values: &[u32]) -> Vec<bool> {
    let mut differs = vec![false; mesh.ids.len()];
    for (v, value) in values.iter().enumerate() {
        let first = mesh.position_ids[v] as usize;
        differs[first] |= values[first] != *value;
    }
    mesh.position_ids.iter().map(|first| differs[*first as usize]).collect()
}

/// The topology of a mesh, which collapses may change.
#[derive(Debug)]
struct Topology {
    edges: Edges,
    /// Vertices − edges + faces, by position.
    euler: i64,
    /// Edges with more than two faces.
    crowded: Vec<(u32, u32)>,
}

impl Topology {
    fn of(faces: &[[u32; 3]]) -> Self {
        let edges = Edges::of(faces);
        let mut seen = vec![false; edges.points() as usize];
        faces.iter().flatten().for_each(|v| seen[*v as usize] = true);
        let vertices = seen.iter().filter(|s| **s).count() as i64;
        let mut count = 0;
        let mut crowded = Vec::new();
        for edge in edges.iter() {
            count += 1;
            if edge.faces() > 2 {
                crowded.push(edge.ends);
            }
        }
        Self { euler: vertices - count + faces.len() as i64, crowded, edges }
    }

    fn same_as(&self, source: &Self) -> bool {
        self.euler == source.euler && self.crowded.len() <= source.crowded.len()
    }
}

/// Triangles with their corners renamed.
fn faces(indices: &[u32], name: impl Fn(u32) -> u32) -> impl Iterator<Item = [u32; 3]> {
    indices.chunks_exact(3).map(move |t| [t[0], t[1], t[2]].map(&name))
}

/// Triangles of a result by position. A number below the number of vertices is the first vertex that *was* at the
/// position; a number above is a new position. Positions are those of the result: seams may have opened and sheets
/// may have met.
fn by_position(before: &LocalMesh, after: &LocalMesh) -> Vec<[u32; 3]> {
    let mut ids = after.position_ids.clone();
    let mut used = vec![false; ids.len()];
    after.indices.iter().for_each(|v| used[*v as usize] = true);
    let moved = |v: &usize| {
        let was = before.positions[after.origin(*v)];
        used[*v] && after.positions[*v].map(f32::to_bits) != was.map(f32::to_bits)
    };
    let moved: Vec<usize> = (0..ids.len()).filter(moved).collect();
    let mut places: Vec<[f32; 3]> = (0..ids.len()).map(|v| before.positions[after.origin(v)]).collect();
    places.extend(moved.iter().map(|v| after.positions[*v]));
    let first = hash::first_equal(bytemuck::cast_slice(&places), 3);
    moved.iter().zip(&first[ids.len()..]).for_each(|(v, place)| ids[*v] = *place);
    faces(&after.indices, |v| ids[v as usize]).collect()
}

/// The most columns that steer collapses: meshoptimizer's limit. Further columns are interpolated on the surface
/// before.
const MOST_COLUMNS: usize = 32;
/// Columns that stand for labels, at most.
const LABEL_COLUMNS: usize = 3;

/// The attribute columns that steer a simplifier.
struct Guides {
    rows: Vec<f32>,
    /// Weights of its columns: a unit of an attribute counts as a mean edge length times its weight, relative to
    /// the group's extent.
    weights: Vec<f32>,
    /// Columns that are those of the mesh; labels follow.
    own: usize,
}

impl Guides {
    /// The columns of a mesh, the first `most` of which steer, and columns for its labels if there are several.
    fn new(mesh: &LocalMesh, content: &Content, columns: usize, edge: f32, best: bool) -> Self {
        let (stride, extent) = (content.stride(), mesh.extent());
        let unit = if extent > 0.0 { edge / extent } else { 0.0 };
        let codes = label_codes(&mesh.labels);
        let labels = codes.len() / mesh.ids.len().max(1);
        let most = MOST_COLUMNS - labels;
        let own = columns.min(stride);
        let mut weights: Vec<f32> = content.weights().take(own).map(|weight| weight * unit).collect();
        weights.iter_mut().skip(most).for_each(|weight| *weight = 0.0);
        if best && !content.has_own_normals() {
            // They follow from the shape, which is more exact.
            weights.iter_mut().take(3).for_each(|weight| *weight = 0.0);
        }
        if labels == 0 && own == stride {
            return Self { rows: mesh.attributes.clone(), weights, own };
        }
        weights.extend(std::iter::repeat_n(content.label_weight * unit, labels));
        let mut rows = Vec::with_capacity(mesh.ids.len() * weights.len());
        for (v, row) in mesh.attributes.chunks_exact(stride).enumerate() {
            rows.extend_from_slice(&row[..own]);
            rows.extend_from_slice(&codes[v * labels..][..labels]);
        }
        Self { rows, weights, own }
    }
}

/// Columns that encode the labels of vertices, so that lines between labels cost as much as lines between colours.
/// Up to four labels are a unit apart, more labels about a unit by hashing. Empty where all labels are the same.
fn label_codes(labels: &[u32]) -> Vec<f32> {
    let mut known: Vec<u32> = labels.to_vec();
    known.sort_unstable();
    known.dedup();
    let columns = known.len().saturating_sub(1).min(LABEL_COLUMNS);
    let code = |label: u32, column: usize| {
        if known.len() <= LABEL_COLUMNS + 1 {
            return f32::from(u8::from(known.get(column + 1) == Some(&label)));
        }
        let hash = label.wrapping_mul(0x9e37_79b1).rotate_left(8 * column as u32).wrapping_mul(0x85eb_ca6b);
        (hash >> 8) as f32 / (1 << 24) as f32
    };
    labels
        .iter()
        .flat_map(|label| (0..columns).map(move |column| (*label, column)))
        .map(|(l, c)| code(l, c))
        .collect()
}

/// The edge of the equilateral triangle of mean area.
pub fn mean_edge(mesh: &LocalMesh) -> f32 {
    let corners = |t: &[u32]| [0, 1, 2].map(|k| mesh.positions[t[k] as usize]);
    let areas = mesh.indices.chunks_exact(3).map(|t| area(corners(t))).sum::<f64>();
    edge_of_area(areas / (mesh.indices.len() / 3).max(1) as f64) as f32
}

/// What a step made.
struct Made {
    mesh: LocalMesh,
    error: f32,
    /// See [`Simplified::step_error`].
    moved: f32,
    /// See [`Simplified::cost`].
    cost: Option<f64>,
    /// Whether the limit of the cost ended it.
    stopped: bool,
}

fn run(
    mesh: &LocalMesh,
    locked: &[bool],
    limit: Limit,
    content: &Content,
    options: &BuildOptions,
    step: Step,
) -> Made {
    let mut error = 0.0;
    let between_materials = differ_at_position(mesh, &mesh.materials);
    // meshoptimizer asks for no more than there are.
    let target = limit.target.min(mesh.indices.len() / 3);
    if step == Step::Sloppy {
        let (mesh, error) = sloppy(mesh, locked, target, &between_materials);
        return Made { mesh, error, moved: error, cost: None, stopped: false };
    }
    let edge = mean_edge(mesh);
    let best = is_collapse(step, options);
    let columns = if best { content.stride() } else { MOST_COLUMNS - LABEL_COLUMNS };
    let guides = Guides::new(mesh, content, columns, edge, best);
    let width = guides.weights.len();
    let mut steered;
    let (mut dearest, mut moved, mut stopped) = (None, None, false);
    if best {
        let mut policy = policy(content, options);
        policy.cuts &= limit.distance == f64::INFINITY;
        let made = collapse(mesh, locked, guides.rows, &guides.weights, limit, &policy);
        (dearest, moved) = (Some(made.cost), Some(made.moved));
        Collapsed { mesh: steered, error, stopped, .. } = made;
    } else {
        steered = LocalMesh { attributes: guides.rows, ..mesh.clone() };
        let between_labels = differ_at_position(mesh, &mesh.labels);
        let lock = |v: usize| match (locked[v], between_materials[v] || between_labels[v]) {
            (true, _) => SimplifyVertex::Lock,
            (false, true) if step == Step::Permissive => SimplifyVertex::Protect,
            _ => SimplifyVertex::None,
        };
        let locks: Vec<SimplifyVertex> = (0..locked.len()).map(lock).collect();
        let mut flags = SimplifyOptions::ErrorAbsolute | SimplifyOptions::ErrorClamped;
        if step == Step::Permissive {
            flags |= SimplifyOptions::Permissive | SimplifyOptions::Prune;
        }
        let kept = simplify_with_update(
            &mut steered.indices,
            &mut steered.positions,
            &mut steered.attributes,
            &guides.weights,
            width * 4,
            Some(&locks),
            3 * target,
            f32::MAX,
            flags,
            Some(&mut error),
        );
        steered.indices.truncate(kept);
        normalize(&mut steered.attributes, width);
    }
    restore_columns(&mut steered, mesh, content, guides.own, width, edge);
    Made { mesh: steered, error, moved: moved.unwrap_or(error), cost: dearest, stopped }
}

/// Writes the columns that steered, `own` of `width`, back to a mesh that was made from `before`; the other columns
/// are interpolated there.
fn restore_columns(
    made: &mut LocalMesh,
    mesh: &LocalMesh,
    content: &Content,
    own: usize,
    width: usize,
    edge: f32,
) {
    let stride = content.stride();
    if width != stride {
        let rows = mesh.with_copies(&made.copies).attributes;
        let guided = std::mem::replace(&mut made.attributes, rows);
        for (row, guided) in made.attributes.chunks_exact_mut(stride).zip(guided.chunks_exact(width)) {
            row[..own].copy_from_slice(&guided[..own]);
        }
    }
    if width > own || own < stride {
        Field::new(mesh, content).read_off(made, content, own, edge);
    }
}

/// What [`collapse_to`] or [`reduce`] made.
#[derive(Clone, Debug)]
pub struct Finished {
    /// The mesh, numbered like the one given, with copies at the end.
    pub mesh: LocalMesh,
    /// The estimate of its distance.
    pub estimate: f32,
    /// The same without removed components.
    pub moved: f32,
}

/// Collapses edges as with the best quality, until at most `target` triangles are left or no edge may collapse.
/// `cuts`: sheets that touch are separated, necks cut, and components removed. Without it the topology is kept,
/// which is several times as fast where the surface is folded.
pub fn collapse_to(mesh: &LocalMesh, target: usize, content: &Content, cuts: bool) -> Finished {
    // Its collapses cut nothing either.
    let options = BuildOptions { quality: Quality::Best, preserve_area: !cuts, ..BuildOptions::default() };
    let faces: &[[u32; 3]] = bytemuck::cast_slice(&mesh.indices);
    let mut content = content.clone();
    content.up = up(&mesh.positions, faces);
    let made = run(mesh, &mesh.locked, Limit::triangles(target), &content, &options, Step::Attributes);
    Finished { mesh: made.mesh, estimate: made.error, moved: made.moved }
}

/// Removes the smallest islands until at most `target` triangles are left; `None` where there are too few islands.
pub fn prune_to(mesh: &LocalMesh, target: usize) -> Option<LocalMesh> {
    let indices = Islands::of(mesh).prune(mesh, target)?;
    Some(LocalMesh { indices, ..mesh.clone() })
}

/// Removes islands and scales others up to cover as much, until at most `target` triangles are left. Returns the
/// mesh and a bound of its distance to `mesh`; `None` where there are too few islands.
pub fn thin_to(mesh: &LocalMesh, target: usize) -> Option<(LocalMesh, f64)> {
    let islands = Islands::of(mesh);
    let (leaves, rest) = islands.split(mesh);
    let room = target.checked_sub(rest.len() / 3).filter(|room| *room > 0 && !leaves.is_empty())?;
    let silhouette = Silhouette::of(Aabb::of_points(&mesh.positions), &mesh.positions, &mesh.indices);
    let after = LocalMesh { indices: rest, ..mesh.clone() };
    let thinned = islands.thin(&after, &leaves, room, &silhouette, true);
    let mut out = thinned.mesh;
    out.indices.extend(after.indices);
    Some((out, thinned.moved))
}

/// Collapses edges without regard to the topology, and prunes small components. Returns the mesh, numbered like
/// `mesh`, and an estimate of its distance; `None` where it cannot replace `mesh`.
pub fn collapse_loosely_to(mesh: &LocalMesh, target: usize, content: &Content) -> Option<(LocalMesh, f32)> {
    let options = BuildOptions::default();
    let Made { mesh: result, error, .. } =
        run(mesh, &mesh.locked, Limit::triangles(target), content, &options, Step::Permissive);
    let fits = !result.indices.is_empty() && keeps_materials(&result) && keeps_border(mesh, &result);
    fits.then_some((result, error))
}

/// Clusters vertices, each material by itself, with lines between materials locked.
fn sloppy(mesh: &LocalMesh, locked: &[bool], target: usize, between_materials: &[bool]) -> (LocalMesh, f32) {
    let mut out = mesh.clone();
    let bytes: &[u8] = bytemuck::cast_slice(&mesh.positions);
    // The adapter fails on a misfit of bytes and stride only, which a slice of [f32; 3] cannot have.
    let Ok(adapter) = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0) else { return (out, 0.0) };
    let locked: Vec<bool> = locked.iter().zip(between_materials).map(|(a, b)| *a || *b).collect();
    let mut worst = 0.0f32;
    out.indices.clear();
    for triangles in mesh.by_material() {
        let corners = |t: &u32| mesh.indices[3 * *t as usize..][..3].to_vec();
        let indices: Vec<u32> = triangles.iter().flat_map(corners).collect();
        let (share, mut error) = (target * indices.len() / mesh.indices.len() * 3, 0.0);
        let left = simplify_sloppy_with_locks(&indices, &adapter, &locked, share, f32::MAX, Some(&mut error));
        out.indices.extend(left);
        worst = worst.max(error);
    }
    (out, worst * mesh.extent())
}

/// Normalizes solved normals and clamps solved colours.
fn normalize(attributes: &mut [f32], stride: usize) {
    for row in attributes.chunks_exact_mut(stride) {
        let size = row[..3].iter().map(|x| x * x).sum::<f32>().sqrt();
        if size > 0.0 && (size - 1.0).abs() > 1.0e-6 {
            row[..3].iter_mut().for_each(|x| *x /= size);
        }
    }
}
