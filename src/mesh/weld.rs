//! Welding and mending: bit-identical vertices become one, faces that cannot have area and repeated faces go.

use std::sync::atomic::{AtomicBool, Ordering};

use bytemuck::cast_slice;
use rayon::prelude::*;

use super::channels::Scale;
use super::creases::{self, Creased};
use super::edges::Edges;
use super::materials::ByMaterial;
use super::sides::{self, BySide};
use super::source::SourceMesh;
use super::{Channels, attributes, frame, hash, materials, validate};
use crate::error::{Error, Result};
use crate::math::Aabb;
use crate::model::{AttributeLayout, BuildReport, CoordinateFrame};

/// A clean indexed mesh in internal space.
#[derive(Clone, Debug)]
pub struct WeldedMesh {
    /// Internal to object space.
    pub frame: CoordinateFrame,
    /// Box of the positions.
    pub bounds: Aabb,
    /// Positions.
    pub positions: Vec<[f32; 3]>,
    /// Which attributes there are.
    pub layout: AttributeLayout,
    /// Attribute rows, see [`super::attributes`], each followed by the scaled floats of [`Channels`].
    pub attributes: Vec<f32>,
    /// Floats per attribute row.
    pub stride: usize,
    /// Named channels.
    pub channels: Channels,
    /// Material of each vertex, and so of the faces around it; empty when there are none.
    pub materials: Vec<u32>,
    /// Triangles: no two corners at one position, no face twice.
    pub faces: Vec<[u32; 3]>,
    /// For each face, its row in the caller's array.
    pub face_rows: Vec<u32>,
}

/// Validates, frames, welds and mends; where normals are computed, not over edges at which faces meet at more than
/// `crease` degrees. Counts what it did in `report`.
pub fn weld(source: &SourceMesh<'_>, crease: Option<f32>, report: &mut BuildReport) -> Result<WeldedMesh> {
    validate::validate(source)?;
    report.input_faces = source.faces.len() as u64;
    report.input_vertices = source.positions.len() as u64;
    let referenced = frame::referenced(source.faces, source.positions.len());
    let (positions, frame) = frame::to_internal(source.positions, &referenced);
    weld_in(source, positions, frame, None, crease, report)
}

/// The same of a valid source, or a part of one, whose positions are in a frame; of a part, how the floats of channels are
/// scaled in the whole.
pub fn weld_in(
    source: &SourceMesh<'_>,
    mut positions: Vec<[f32; 3]>,
    frame: CoordinateFrame,
    scales: Option<&[Scale]>,
    crease: Option<f32>,
    report: &mut BuildReport,
) -> Result<WeldedMesh> {
    let layout = attributes::layout(source);
    let stride = attributes::stride(layout);
    let mut rows = attributes::gather(source);
    let mut channels = Channels::gather(source);
    let by_material = source.materials.map(|m| materials::split(source.faces, m, positions.len()));
    if let Some(ByMaterial { copies, .. }) = &by_material {
        let copied = |v: &u32| *v as usize * stride..(*v as usize + 1) * stride;
        copies.iter().for_each(|v| positions.push(positions[*v as usize]));
        copies.iter().for_each(|v| rows.extend_from_within(copied(v)));
        channels.copy_rows(copies);
    }
    let (split_faces, materials) = match by_material {
        Some(ByMaterial { faces, materials, .. }) => (Some(faces), materials),
        None => (None, Vec::new()),
    };
    let faces = split_faces.as_deref().unwrap_or(source.faces);

    let position_ids = hash::first_equal(cast_slice(&positions), 3);
    let plain = source.normals.is_none() && layout == AttributeLayout::default() && channels.infos.is_empty();
    let vertex_ids = if plain {
        position_ids.clone()
    } else {
        let tables = [
            (cast_slice(&positions), 3),
            (cast_slice(&rows), stride),
            (&channels.words[..], channels.width()),
            (&materials[..], usize::from(layout.materials)),
        ];
        hash::first_equal_of(&tables)
    };

    let (mut faces, face_rows) = mend(faces, &vertex_ids, &position_ids, report);
    let mut vertices = Vertices { positions, rows, stride, channels, materials, vertex_ids, position_ids };
    if source.normals.is_none() {
        if let Some(BySide { faces: split, copies }) =
            sides::split(&faces, &vertices.positions, &vertices.position_ids, report.non_manifold_edges)
        {
            let sides: Vec<u32> = (vertices.positions.len() as u32..).take(copies.len()).collect();
            vertices.copy(&copies, &sides);
            faces = split;
        }
        if let Some(degrees) = crease
            && let Some(Creased { faces: split, copies, sides }) =
                creases::split(&faces, &vertices.positions, &vertices.position_ids, degrees)
        {
            vertices.copy(&copies, &sides);
            faces = split;
        }
    }
    if faces.is_empty() {
        return Err(Error::EmptyMesh("no face is left once faces without area are dropped".into()));
    }
    let (mut mesh, position_ids) = compact(vertices, faces, scales, report);
    let mended = attributes::fill_normals(
        &mut mesh.attributes,
        mesh.stride,
        &mesh.positions,
        &position_ids,
        &mesh.faces,
    );
    report.computed_normals = source.normals.is_none();
    report.mended_normals = if report.computed_normals { 0 } else { mended as u64 };
    Ok(WeldedMesh { frame, bounds: frame::bounds(&mesh.positions), layout, face_rows, ..mesh })
}

/// The vertices as given and those that splitting added, and which of them are equal.
struct Vertices {
    positions: Vec<[f32; 3]>,
    /// Attribute rows.
    rows: Vec<f32>,
    /// Floats per attribute row.
    stride: usize,
    channels: Channels,
    /// Empty when there are no materials.
    materials: Vec<u32>,
    /// For each vertex, the first one that equals it.
    vertex_ids: Vec<u32>,
    /// For each vertex, the first one at its position.
    position_ids: Vec<u32>,
}

impl Vertices {
    /// Adds copies of vertices; `sides` are their position ids. Normals are added up by position, so those of a
    /// side have a position id of their own.
    fn copy(&mut self, copies: &[u32], sides: &[u32]) {
        let count = self.positions.len() as u32;
        copies.iter().for_each(|v| {
            let v = *v as usize;
            self.positions.push(self.positions[v]);
            self.rows.extend_from_within(v * self.stride..(v + 1) * self.stride);
            self.materials.extend(self.materials.get(v).copied());
        });
        self.channels.copy_rows(copies);
        self.position_ids.extend(sides);
        self.vertex_ids.extend(count..self.positions.len() as u32);
    }
}

/// Drops faces with two corners at one position and repeated faces; counts the edges of the rest.
fn mend(
    faces: &[[u32; 3]],
    vertex_ids: &[u32],
    position_ids: &[u32],
    report: &mut BuildReport,
) -> (Vec<[u32; 3]>, Vec<u32>) {
    let (mut kept, mut rows): (Vec<_>, Vec<_>) = faces
        .par_iter()
        .enumerate()
        .filter_map(|(row, face)| {
            let [a, b, c] = face.map(|v| position_ids[v as usize]);
            let stays = a != b && b != c && c != a;
            stays.then(|| (face.map(|v| vertex_ids[v as usize]), row as u32))
        })
        .unzip();
    report.degenerate_faces = (faces.len() - kept.len()) as u64;
    // Faces that are the same run along the same edges in the same direction: mostly none do.
    if count_edges(&kept, position_ids, report) {
        let before = kept.len();
        (kept, rows) = drop_repeats(kept, rows);
        report.duplicate_faces = (before - kept.len()) as u64;
        count_edges(&kept, position_ids, report);
    }
    (kept, rows)
}

/// Drops all but the first of faces with the same corners in the same cyclic order.
fn drop_repeats(faces: Vec<[u32; 3]>, rows: Vec<u32>) -> (Vec<[u32; 3]>, Vec<u32>) {
    let canonical: Vec<[u32; 3]> = faces
        .par_iter()
        .map(|&[a, b, c]| {
            if a < b && a < c {
                [a, b, c]
            } else if b < c {
                [b, c, a]
            } else {
                [c, a, b]
            }
        })
        .collect();
    let first = hash::first_equal(cast_slice(&canonical), 3);
    let unique = |(i, _): &(usize, _)| first[*i] as usize == *i;
    faces.into_iter().zip(rows).enumerate().filter(unique).map(|(_, face)| face).unzip()
}

/// Keeps only vertices that faces use, in their order; also tells the first of them at each one's position.
fn compact(
    vertices: Vertices,
    mut faces: Vec<[u32; 3]>,
    scales: Option<&[Scale]>,
    report: &mut BuildReport,
) -> (WeldedMesh, Vec<u32>) {
    let Vertices { positions, rows, stride: base, mut channels, materials, vertex_ids, position_ids } =
        vertices;
    let used: Vec<AtomicBool> = positions.par_iter().map(|_| AtomicBool::new(false)).collect();
    faces.par_iter().flatten().for_each(|v| used[*v as usize].store(true, Ordering::Relaxed));
    let mut rename = vec![u32::MAX; positions.len()];
    let mut order = Vec::new();
    for v in 0..positions.len() {
        if used[v].load(Ordering::Relaxed) {
            rename[v] = order.len() as u32;
            order.push(v as u32);
        }
    }
    let distinct = vertex_ids.par_iter().enumerate().filter(|(i, v)| **v as usize == *i).count();
    report.welded_vertices = (positions.len() - distinct) as u64;
    report.unreferenced_vertices = (distinct - order.len()) as u64;
    drop(vertex_ids);
    faces.par_iter_mut().for_each(|f| *f = f.map(|v| rename[v as usize]));
    // The representative of a position may itself be unused: take the first used one.
    let mut first_used = rename;
    first_used.fill(u32::MAX);
    let ids = order
        .iter()
        .enumerate()
        .map(|(new, old)| {
            let first = &mut first_used[position_ids[*old as usize] as usize];
            if *first == u32::MAX {
                *first = new as u32;
            }
            *first
        })
        .collect();
    let stride = base + channels.float_widths().sum::<usize>();
    let mut attributes = vec![0.0; order.len() * stride];
    attributes
        .par_chunks_mut(stride)
        .zip(&order)
        .for_each(|(out, old)| out[..base].copy_from_slice(&rows[*old as usize * base..][..base]));
    channels.keep(&order);
    channels.scales = scales.map_or_else(|| channels.own_scales(), <[Scale]>::to_vec);
    channels.scale(&mut attributes, stride);
    let mesh = WeldedMesh {
        frame: CoordinateFrame { origin: [0.0; 3], scale: 1.0, rounding: 0.0 },
        bounds: Aabb::EMPTY,
        positions: order.par_iter().map(|v| positions[*v as usize]).collect(),
        layout: AttributeLayout::default(),
        attributes,
        stride,
        channels,
        materials: if materials.is_empty() {
            Vec::new()
        } else {
            order.iter().map(|v| materials[*v as usize]).collect()
        },
        faces,
        face_rows: Vec::new(),
    };
    (mesh, ids)
}

/// Counts edges, by position, with one face and with more than two; tells whether faces run along one in the
/// same direction.
fn count_edges(faces: &[[u32; 3]], position_ids: &[u32], report: &mut BuildReport) -> bool {
    let edges = Edges::named(faces, |v| position_ids[v as usize]);
    let (border, crowded, repeated) = (0..edges.points())
        .into_par_iter()
        .flat_map_iter(|point| edges.at(point))
        .map(|e| (u64::from(e.faces() == 1), u64::from(e.faces() > 2), e.forward.max(e.backward) > 1))
        .reduce(|| (0, 0, false), |a, b| (a.0 + b.0, a.1 + b.1, a.2 || b.2));
    report.border_edges = border;
    report.non_manifold_edges = crowded;
    repeated
}
