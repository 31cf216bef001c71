//! Vertex attributes as rows of f32: normal (3), then colour (4, 0 to 1) if any, then UV sets (2 each).

use std::f64::consts::PI;

use rayon::prelude::*;

use super::source::{Colors, SourceMesh};
use crate::model::{AttributeLayout, ColorFormat};

/// Faces whose weights are kept at a time: few enough to stay in cache.
const CHUNK_FACES: usize = 1 << 14;

/// Floats per vertex.
pub fn stride(layout: AttributeLayout) -> usize {
    3 + 4 * usize::from(layout.colors.is_some()) + 2 * usize::from(layout.uv_sets)
}

/// Which attributes a source has.
pub fn layout(source: &SourceMesh<'_>) -> AttributeLayout {
    AttributeLayout {
        colors: source.colors.map_or(ColorFormat::None, Colors::format),
        uv_sets: source.uvs.len() as u8,
        materials: source.materials.is_some(),
    }
}

/// The rows of all vertices. Normals are given ones as they are, or zero to be filled in by
/// [`fill_normals`].
pub fn gather(source: &SourceMesh<'_>) -> Vec<f32> {
    let stride = stride(layout(source));
    let mut rows = vec![0.0; source.positions.len() * stride];
    rows.par_chunks_mut(stride).enumerate().for_each(|(i, row)| {
        if let Some(normals) = source.normals {
            row[..3].copy_from_slice(&normals[i]);
        }
        let mut at = 3;
        if let Some(colors) = source.colors {
            row[at..at + 4].copy_from_slice(&colors.get(i));
            at += 4;
        }
        for set in &source.uvs {
            row[at..at + 2].copy_from_slice(&set[i]);
            at += 2;
        }
        // Equal values get equal bits.
        row.iter_mut().for_each(|x| *x += 0.0);
    });
    rows
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// A triangle's unit normal and its angle at each corner; zero for a triangle without area.
fn corner_weights(p: [[f32; 3]; 3]) -> ([f64; 3], [f64; 3]) {
    let p = p.map(|v| v.map(f64::from));
    let edges = [sub(p[1], p[0]), sub(p[2], p[1]), sub(p[0], p[2])];
    let normal = cross(edges[0], edges[1]);
    let size = length(normal);
    if size == 0.0 {
        return ([0.0; 3], [0.0; 3]);
    }
    // At every corner the sides span the same parallelogram. Weights need no more than single precision.
    let angle = |i: usize| {
        let along = -dot(edges[(i + 2) % 3], edges[i]);
        let unit = 1.0 / (size + along.abs());
        f64::from(((size * unit) as f32).atan2((along * unit) as f32))
    };
    let (a, b) = (angle(0), angle(1));
    (normal.map(|x| x / size), [a, b, (PI - a - b).max(0.0)])
}

/// Adds the weighted normals of faces at their corners.
fn add_normals(
    sums: &mut [[f64; 3]],
    position_ids: &[u32],
    faces: &[[u32; 3]],
    weights: &[([f64; 3], [f64; 3])],
) {
    for (face, (normal, angles)) in faces.iter().zip(weights) {
        for k in 0..3 {
            let sum = &mut sums[position_ids[face[k] as usize] as usize];
            (0..3).for_each(|c| sum[c] += normal[c] * angles[k]);
        }
    }
}

/// Replaces zero-length normals by the angle-weighted mean of the faces around the position, and scales all
/// to unit length. Returns how many were replaced.
///
/// Thürmer and Wüthrich, "Computing Vertex Normals from Polygonal Facets", JGT 3(1), 1998.
pub fn fill_normals(
    rows: &mut [f32],
    stride: usize,
    positions: &[[f32; 3]],
    position_ids: &[u32],
    faces: &[[u32; 3]],
) -> usize {
    let needed = |row: &[f32]| length([0, 1, 2].map(|k| f64::from(row[k]))) < 1.0e-30;
    let missing = rows.par_chunks(stride).filter(|row| needed(row)).count();
    let mut sums = vec![[0.0f64; 3]; if missing > 0 { positions.len() } else { 0 }];
    if missing > 0 {
        // One chunk is added up, in order, while the next is weighed.
        let (mut ready, mut weights): (&[[u32; 3]], _) = (&[], Vec::new());
        let mut next = Vec::new();
        for chunk in faces.chunks(CHUNK_FACES).chain([&[][..]]) {
            let corners = |f: &[u32; 3]| f.map(|v| positions[v as usize]);
            rayon::join(
                || add_normals(&mut sums, position_ids, ready, &weights),
                || chunk.par_iter().map(|f| corner_weights(corners(f))).collect_into_vec(&mut next),
            );
            ready = chunk;
            std::mem::swap(&mut weights, &mut next);
        }
    }
    rows.par_chunks_mut(stride).enumerate().for_each(|(i, row)| {
        let n =
            if needed(row) { sums[position_ids[i] as usize] } else { [0, 1, 2].map(|k| f64::from(row[k])) };
        let size = length(n);
        let unit = if size > 0.0 { n.map(|x| (x / size) as f32 + 0.0) } else { [0.0, 0.0, 1.0] };
        row[..3].copy_from_slice(&unit);
    });
    missing
}
