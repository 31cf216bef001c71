//! Simplifying one group to half, and the chain of fallbacks.
//!
//! The simplifier is meshoptimizer's, with vertices moved to their optimum and attributes in the metric
//! (Garland and Heckbert 1997; Hoppe, "New Quadric Metric for Simplifying Meshes with Appearance Attributes",
//! 1999). The chain: attribute-aware with seams protected → permissive (seams may collapse, loose parts may
//! go) → sloppy with its error doubled → give up.

use meshopt::{
    SimplifyOptions, SimplifyVertex, VertexDataAdapter, simplify_sloppy_with_locks, simplify_with_update,
};

use super::lock_borders::{border_kept, locked_edges_kept};
use super::store::LocalMesh;
use crate::config::BuildOptions;
use crate::math::Aabb;
use crate::model::{AttributeLayout, StuckReason};

/// Part of the triangles to keep.
const TARGET_RATIO: f32 = 0.5;
/// A result that keeps more than this part is not worth a level.
const ACCEPT_RATIO: f32 = 0.85;
/// The sloppy simplifier measures vertex moves within cells; the surface may deviate more.
const SLOPPY_ERROR_FACTOR: f32 = 2.0;

/// A step of the chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Attribute-aware, seams protected, topology preserved.
    Attributes,
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
    /// Distance against the group's own input, internal units, as the simplifier estimates it.
    pub error: f32,
    /// The step that made it.
    pub step: Step,
}

/// Simplifies a group, `locked` by local vertex.
pub fn simplify(
    mesh: &LocalMesh,
    locked: &[bool],
    layout: AttributeLayout,
    options: &BuildOptions,
) -> Result<Simplified, StuckReason> {
    let triangles = mesh.indices.len() / 3;
    let mut reason = StuckReason::TooFewCollapses;
    let before = by_position(mesh, &mesh.indices);
    for step in Step::CHAIN {
        let (result, error) = run(mesh, locked, layout, options, step);
        let left = result.indices.len() / 3;
        if left == 0 {
            reason = StuckReason::Vanished;
            continue;
        }
        if left as f32 > triangles as f32 * ACCEPT_RATIO {
            continue;
        }
        let after = by_position(mesh, &result.indices);
        let is_locked = |v: u32| locked[v as usize];
        let kept = match step {
            Step::Sloppy => border_kept(before.iter().copied(), after.into_iter(), is_locked),
            _ => locked_edges_kept(&before, &after, is_locked),
        };
        if !kept {
            reason = StuckReason::BorderChanged;
            continue;
        }
        return Ok(Simplified { mesh: result, error, step });
    }
    Err(reason)
}

/// Triangles by the representatives of their corners' positions.
fn by_position(mesh: &LocalMesh, indices: &[u32]) -> Vec<[u32; 3]> {
    indices.chunks_exact(3).map(|t| [0, 1, 2].map(|k| mesh.position_ids[t[k] as usize])).collect()
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
            let p = [0, 1, 2].map(|k| mesh.positions[t[k] as usize].map(f64::from));
            let u: [f64; 3] = std::array::from_fn(|k| p[1][k] - p[0][k]);
            let v: [f64; 3] = std::array::from_fn(|k| p[2][k] - p[0][k]);
            let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
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
    let mut out = LocalMesh {
        ids: mesh.ids.clone(),
        positions: mesh.positions.clone(),
        attributes: mesh.attributes.clone(),
        position_ids: mesh.position_ids.clone(),
        indices: Vec::new(),
    };
    if step == Step::Sloppy {
        let bytes: &[u8] = bytemuck::cast_slice(&mesh.positions);
        // The adapter fails on a misfit of bytes and stride only, which a slice of [f32; 3] cannot have.
        let Ok(adapter) = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0) else { return (out, 0.0) };
        out.indices =
            simplify_sloppy_with_locks(&mesh.indices, &adapter, locked, target, f32::MAX, Some(&mut error));
        return (out, error * extent(mesh) * SLOPPY_ERROR_FACTOR);
    }
    let weights = weights(mesh, layout, options);
    let locks: Vec<SimplifyVertex> =
        locked.iter().map(|l| if *l { SimplifyVertex::Lock } else { SimplifyVertex::None }).collect();
    let mut flags = SimplifyOptions::ErrorAbsolute | SimplifyOptions::ErrorClamped;
    if step == Step::Permissive {
        flags |= SimplifyOptions::Permissive | SimplifyOptions::Prune;
    }
    let mut indices = mesh.indices.clone();
    let kept = simplify_with_update(
        &mut indices,
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
    indices.truncate(kept);
    out.indices = indices;
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
