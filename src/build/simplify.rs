//! Simplifying one group to half, and the chain of fallbacks.
//!
//! The simplifier is `collapse` or, where speed matters more, meshoptimizer's, with vertices moved to their optimum and attributes in the metric
//! (Garland and Heckbert 1997; Hoppe, "New Quadric Metric for Simplifying Meshes with Appearance Attributes",
//! 1999). The chain: attribute-aware with seams protected → permissive (seams may collapse, loose parts may
//! go) → sloppy → give up.

use meshopt::{
    SimplifyOptions, SimplifyVertex, VertexDataAdapter, simplify_sloppy_with_locks, simplify_with_update,
};
use rustc_hash::FxHashSet;

use super::collapse::{Policy, collapse};
use super::islands::Islands;
use super::lock_borders::border_kept;
use super::silhouette::Sight;
use super::store::LocalMesh;
use crate::config::{BuildOptions, Quality};
use crate::math::Aabb;
use crate::math::sphere::round_up;
use crate::math::triangle::area_normal;
use crate::mesh::edges::Edges;
use crate::mesh::hash;
use crate::model::{AttributeLayout, StuckReason};

/// Part of the triangles to keep.
const TARGET_RATIO: f32 = 0.5;
/// A result that keeps more than this part is not worth a level.
const ACCEPT_RATIO: f32 = 0.85;

/// Repeats of the first step, each with more vertices locked, before a change of topology is accepted.
const TOPOLOGY_RETRIES: usize = 3;

/// A step of the chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Step {
    /// Attribute-aware, seams protected, topology kept.
    Attributes,
    /// The same, but the topology changed: a handle or a small part collapsed.
    Topology,
    /// Collapses across seams, loose parts pruned.
    Permissive,
    /// Vertex clustering.
    Sloppy,
}

impl Step {
    const CHAIN: [Self; 3] = [Self::Attributes, Self::Permissive, Self::Sloppy];
}

/// What a group became.
#[derive(Debug)]
pub struct Simplified {
    /// The simplified mesh; `ids` still name the vertices it came from.
    pub mesh: LocalMesh,
    /// The simplifier's estimate of the distance to the group's own input, internal units.
    pub estimate: f32,
    /// What islands that went or grew add to it: no point of theirs is farther off.
    pub moved: f32,
    /// The step that made it.
    pub step: Step,
}

/// Simplifies a group. With `preserve_area` it goes on covering what it does, or as much as in `sight`.
pub fn simplify(
    mesh: &LocalMesh,
    layout: AttributeLayout,
    options: &BuildOptions,
    sight: Option<Sight>,
) -> Result<Simplified, StuckReason> {
    if options.preserve_area
        && let Ok(result) = with_islands(mesh, layout, options, sight)
    {
        return Ok(result);
    }
    chain(mesh, layout, options)
}

/// Leaves go or grow as a whole, the rest passes the chain and keeps the area of its open islands.
fn with_islands(
    mesh: &LocalMesh,
    layout: AttributeLayout,
    options: &BuildOptions,
    sight: Option<Sight>,
) -> Result<Simplified, StuckReason> {
    let islands = Islands::of(mesh);
    let (leaves, rest) = islands.split(mesh);
    let rest = LocalMesh { indices: rest, ..mesh.clone() };
    let bounds = Aabb::of_points(&mesh.positions);
    let sight = sight.unwrap_or_else(|| Sight::of(bounds, &mesh.positions, &mesh.indices));
    let rest_sight =
        if leaves.is_empty() { sight } else { Sight::of(bounds, &rest.positions, &rest.indices) };
    let outcome =
        if rest.indices.is_empty() { Err(StuckReason::Vanished) } else { chain(&rest, layout, options) };
    let mut result = match outcome {
        Ok(result) => result,
        Err(reason) if leaves.is_empty() => return Err(reason),
        Err(_) => Simplified { mesh: rest, estimate: 0.0, moved: 0.0, step: Step::Permissive },
    };
    // Vertex clustering takes no notice of islands.
    let grew = if result.step == Step::Sloppy { 0.0 } else { islands.restore(&mut result.mesh, &rest_sight) };
    let mut moved = f64::from(result.estimate) + grew;
    if !leaves.is_empty() {
        let target = (mesh.indices.len() / 6).saturating_sub(result.mesh.indices.len() / 3);
        let target = target.clamp(leaves.len() / 12, leaves.len() / 6);
        let thinned = islands.thin(&result.mesh, &leaves, target, &sight);
        let rest = std::mem::replace(&mut result.mesh, thinned.mesh);
        result.mesh.indices.extend(rest.indices);
        moved = moved.max(thinned.moved);
        result.step = result.step.max(Step::Permissive);
    }
    result.moved = round_up(moved);
    if result.mesh.indices.len() as f32 > mesh.indices.len() as f32 * ACCEPT_RATIO {
        return Err(StuckReason::TooFewCollapses);
    }
    let before: Vec<[u32; 3]> = faces(&mesh.indices, |v| mesh.position_ids[v as usize]).collect();
    let after = by_position(mesh, &result.mesh);
    let kept = border_kept(&Edges::of(&before), &Edges::of(&after), is_locked(mesh));
    if kept { Ok(result) } else { Err(StuckReason::BorderChanged) }
}

/// The first step that makes something of a group.
fn chain(
    mesh: &LocalMesh,
    layout: AttributeLayout,
    options: &BuildOptions,
) -> Result<Simplified, StuckReason> {
    let mut reason = StuckReason::TooFewCollapses;
    let before: Vec<[u32; 3]> = faces(&mesh.indices, |v| mesh.position_ids[v as usize]).collect();
    let before = Topology::of(&before);
    for step in Step::CHAIN {
        match attempt(mesh, &before, layout, options, step) {
            Ok(result) => return Ok(result),
            Err(StuckReason::TooFewCollapses) => {}
            Err(other) => reason = other,
        }
    }
    Err(reason)
}

/// One step of the chain, checked and measured.
fn attempt(
    mesh: &LocalMesh,
    before: &Topology,
    layout: AttributeLayout,
    options: &BuildOptions,
    step: Step,
) -> Result<Simplified, StuckReason> {
    let most = (mesh.indices.len() / 3) as f32 * ACCEPT_RATIO;
    let checked = |locked: &[bool]| {
        let (result, error) = run(mesh, locked, layout, options, step);
        let left = result.indices.len() / 3;
        if left == 0 {
            return Err(StuckReason::Vanished);
        }
        if left as f32 > most {
            return Err(StuckReason::TooFewCollapses);
        }
        let after = by_position(mesh, &result);
        let topology = Topology::of(&after);
        let kept = border_kept(&before.edges, &topology.edges, is_locked(mesh));
        if kept { Ok((result, error, after, topology)) } else { Err(StuckReason::BorderChanged) }
    };
    let (mut result, mut error, mut after, mut topology) = checked(&mesh.locked)?;
    let mut done = step;
    if step == Step::Attributes {
        let mut locked = mesh.locked.clone();
        // Collapses have no link condition: where sheets were pinched together, hold what they met at and repeat.
        for _ in 0..TOPOLOGY_RETRIES {
            if topology.crowded.len() <= before.crowded.len() {
                break;
            }
            let ends: FxHashSet<u32> = topology.crowded.iter().flat_map(|e| [e.0, e.1]).collect();
            // Vertices of the result are numbered like those of the group, wherever they moved.
            let corners = after.iter().flatten().zip(&result.indices);
            let met = corners.filter(|(p, _)| ends.contains(p)).map(|(_, v)| mesh.position_ids[*v as usize]);
            let met: FxHashSet<u32> = met.collect();
            locked.iter_mut().zip(&mesh.position_ids).for_each(|(lock, p)| *lock |= met.contains(p));
            let Ok(again) = checked(&locked) else { break };
            (result, error, after, topology) = again;
        }
        if !topology.same_as(before) {
            done = Step::Topology;
        }
    }
    Ok(Simplified { mesh: result, estimate: error, moved: 0.0, step: done })
}

/// Whether points of [`by_position`] are locked.
fn is_locked(mesh: &LocalMesh) -> impl Fn(u32) -> bool {
    |p| mesh.locked.get(p as usize).copied().unwrap_or(false)
}

/// What collapses may change without being asked to.
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

/// Triangles of a result by position: below the number of vertices the first one that *was* there before, above
/// it a new place. By what the positions are now: seams may have come apart and sheets may have met.
fn by_position(before: &LocalMesh, after: &LocalMesh) -> Vec<[u32; 3]> {
    let mut ids = before.position_ids.clone();
    let mut used = vec![false; ids.len()];
    after.indices.iter().for_each(|v| used[*v as usize] = true);
    let moved = |v: &usize| {
        used[*v] && after.positions[*v].map(f32::to_bits) != before.positions[*v].map(f32::to_bits)
    };
    let moved: Vec<usize> = (0..ids.len()).filter(moved).collect();
    let mut places = before.positions.clone();
    places.extend(moved.iter().map(|v| after.positions[*v]));
    let first = hash::first_equal(bytemuck::cast_slice(&places), 3);
    moved.iter().zip(&first[before.positions.len()..]).for_each(|(v, place)| ids[*v] = *place);
    faces(&after.indices, |v| ids[v as usize]).collect()
}

/// Weights of the attribute row, unit-free: a unit of an attribute against one mean edge length. The
/// simplifier works in units of the group's extent.
fn weights(mesh: &LocalMesh, layout: AttributeLayout, options: &BuildOptions) -> Vec<f32> {
    let extent = extent(mesh);
    let edge = if extent > 0.0 { mean_edge(mesh) / extent } else { 0.0 };
    let mut weights = vec![options.normal_weight * edge; 3];
    weights.extend(std::iter::repeat_n(options.color_weight * edge, 4 * usize::from(layout.colors)));
    weights.extend(std::iter::repeat_n(options.uv_weight * edge, 2 * usize::from(layout.uv_sets)));
    weights
}

/// Longest side of the box of all vertices: the simplifier's unit of length.
fn extent(mesh: &LocalMesh) -> f32 {
    let bounds = Aabb::of_points(&mesh.positions);
    (0..3).map(|k| bounds.max[k] - bounds.min[k]).fold(0.0, f32::max)
}

/// The edge of the equilateral triangle of mean area.
fn mean_edge(mesh: &LocalMesh) -> f32 {
    let area: f64 = mesh
        .indices
        .chunks_exact(3)
        .map(|t| {
            let n = area_normal([0, 1, 2].map(|k| mesh.positions[t[k] as usize]));
            0.5 * (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt()
        })
        .sum();
    let mean = area / (mesh.indices.len() / 3).max(1) as f64;
    (mean * 4.0 / 3f64.sqrt()).sqrt() as f32
}

fn run(
    mesh: &LocalMesh,
    locked: &[bool],
    layout: AttributeLayout,
    options: &BuildOptions,
    step: Step,
) -> (LocalMesh, f32) {
    let target = (mesh.indices.len() as f32 / 3.0 * TARGET_RATIO) as usize * 3;
    let mut error = 0.0;
    let mut out = mesh.clone();
    if step == Step::Sloppy {
        let bytes: &[u8] = bytemuck::cast_slice(&mesh.positions);
        // The adapter fails on a misfit of bytes and stride only, which a slice of [f32; 3] cannot have.
        let Ok(adapter) = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0) else { return (out, 0.0) };
        out.indices =
            simplify_sloppy_with_locks(&mesh.indices, &adapter, locked, target, f32::MAX, Some(&mut error));
        return (out, error * extent(mesh));
    }
    let weights = weights(mesh, layout, options);
    if step == Step::Attributes && options.quality == Quality::Best {
        return collapse(mesh, locked, &weights, target / 3, &Policy::default());
    }
    let locks: Vec<SimplifyVertex> =
        locked.iter().map(|l| if *l { SimplifyVertex::Lock } else { SimplifyVertex::None }).collect();
    let mut flags = SimplifyOptions::ErrorAbsolute | SimplifyOptions::ErrorClamped;
    if step == Step::Permissive {
        flags |= SimplifyOptions::Permissive | SimplifyOptions::Prune;
    }
    let kept = simplify_with_update(
        &mut out.indices,
        &mut out.positions,
        &mut out.attributes,
        &weights,
        weights.len() * 4,
        Some(&locks),
        target,
        f32::MAX,
        flags,
        Some(&mut error),
    );
    out.indices.truncate(kept);
    normalize(&mut out.attributes, weights.len());
    (out, error)
}

/// Solved normals are not unit, solved colours may leave their range.
fn normalize(attributes: &mut [f32], stride: usize) {
    for row in attributes.chunks_exact_mut(stride) {
        let size = row[..3].iter().map(|x| x * x).sum::<f32>().sqrt();
        if size > 0.0 && (size - 1.0).abs() > 1.0e-6 {
            row[..3].iter_mut().for_each(|x| *x /= size);
        }
    }
}
