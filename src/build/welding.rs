//! Levels without texture coordinates, where their seams would be in the way: scans have thousands of small charts. The
//! groups of such levels are welded over seams before they are simplified.

use std::ops::Range;

use glam::Vec3;
use rustc_hash::FxHashMap;

use super::clusterize::ClusterMesh;
use super::content::Content;
use super::store::{LocalMesh, VertexStore};
use crate::config::BuildOptions;
use crate::mesh::hash;
use crate::model::AttributeLayout;

/// Levels are welded once they have at most one in so many triangles of the source: finer ones would need images as
/// large as its own.
const LEAST_REDUCTION: u64 = 8;
/// And where at least this part of the places of vertices lies on seams, so that these cost much; or where nothing else
/// could be made.
const SEAM_PART: f64 = 0.25;
/// Columns of the normal in a row of attributes.
const NORMAL: Range<usize> = 0..3;
/// A cluster has room for so many vertices for each triangle, as many as it may have once charts are cut.
const CORNERS: usize = 3;

/// What is asked for.
#[derive(Clone, Debug, Default)]
pub struct Rebaking {
    /// What the materials of the source become: those that can share an image have one number. Others become the first.
    pub classes: FxHashMap<i32, i32>,
    /// These numbers, which the source has none of.
    pub numbers: Range<i32>,
}

/// How levels are welded.
pub struct Welding {
    rebaking: Rebaking,
    /// Columns of texture coordinates.
    columns: Range<usize>,
    /// What counts besides the shape: neither coordinates nor normals, which images have.
    pub content: Content,
    /// How such levels are built.
    pub options: BuildOptions,
    /// Whether the level is one.
    pub is_on: bool,
}

/// Columns of the texture coordinates in a row of attributes: behind the normal and the colour.
pub fn columns(layout: AttributeLayout) -> Range<usize> {
    let first = NORMAL.end + if layout.colors.is_some() { 4 } else { 0 };
    first..first + 2 * usize::from(layout.uv_sets)
}

impl Welding {
    /// Of a mesh with such vertices.
    pub fn new(
        rebaking: Rebaking,
        layout: AttributeLayout,
        content: &Content,
        options: &BuildOptions,
    ) -> Self {
        let most = options.cluster_vertices.min(CORNERS * options.cluster_triangles) / CORNERS;
        Self {
            rebaking,
            content: content.unmeasured(&columns(layout)),
            columns: columns(layout),
            options: BuildOptions { cluster_triangles: most, ..options.clone() },
            is_on: false,
        }
    }

    /// Whether a material is that of welded clusters.
    pub fn is_welded(&self, material: u32) -> bool {
        self.rebaking.numbers.contains(&material.cast_signed())
    }

    fn class(&self, material: u32) -> u32 {
        if self.is_welded(material) {
            return material;
        }
        let class = self.rebaking.classes.get(&material.cast_signed());
        class.copied().unwrap_or(self.rebaking.numbers.start).cast_unsigned()
    }

    /// The mesh of a group without texture coordinates: vertices that differ in nothing but these and their normals become
    /// one, with the mean normal.
    pub fn weld(&self, local: &LocalMesh) -> LocalMesh {
        let stride = local.attributes.len() / local.ids.len().max(1);
        let mut attributes = local.attributes.clone();
        for row in attributes.chunks_exact_mut(stride.max(1)) {
            row[NORMAL].fill(0.0);
            row[self.columns.clone()].fill(0.0);
        }
        let materials: Vec<u32> = local.materials.iter().map(|m| self.class(*m)).collect();
        let tables = [
            (bytemuck::cast_slice(&local.positions), 3),
            (bytemuck::cast_slice(&attributes), stride),
            (&materials[..], 1),
            (&local.labels[..], usize::from(!local.labels.is_empty())),
        ];
        let tables: Vec<(&[u32], usize)> = tables.into_iter().filter(|(_, width)| *width > 0).collect();
        let first = hash::first_equal_of(&tables);
        let normal = |v: usize| Vec3::from_slice(&local.attributes[v * stride..][NORMAL]);
        let mut normals = vec![Vec3::ZERO; first.len()];
        first.iter().enumerate().for_each(|(v, first)| normals[*first as usize] += normal(v));
        let mut number = vec![0; first.len()];
        let mut out = LocalMesh::default();
        for (v, first) in first.iter().map(|f| *f as usize).enumerate() {
            if first != v {
                number[v] = number[first];
                continue;
            }
            let mean = normals[v].try_normalize().unwrap_or_else(|| normal(v));
            attributes[v * stride..][NORMAL].copy_from_slice(&mean.to_array());
            number[v] = out.ids.len() as u32;
            out.ids.push(local.ids[v]);
            out.positions.push(local.positions[v]);
            out.attributes.extend_from_slice(&attributes[v * stride..(v + 1) * stride]);
            out.labels.extend(local.labels.get(v));
            // The first vertex of a position is the first of its kind.
            out.position_ids.push(number[local.position_ids[v] as usize]);
            out.materials.push(materials[v]);
            out.locked.push(local.locked[v]);
        }
        out.indices = local.indices.iter().map(|v| number[*v as usize]).collect();
        out
    }

    /// The part of the places of some clusters' vertices at which texture coordinates differ.
    pub fn seam_part(&self, store: &VertexStore, meshes: &[&ClusterMesh]) -> f64 {
        let vertices = || meshes.iter().flat_map(|mesh| &mesh.vertices).map(|v| *v as usize);
        let places: Vec<[f32; 3]> = vertices().map(|v| store.positions[v]).collect();
        let at = |v: usize| &store.row(v as u32)[self.columns.clone()];
        let coordinates: Vec<f32> = vertices().flat_map(|v| at(v).to_vec()).collect();
        let first = hash::first_equal(bytemuck::cast_slice(&places), 3);
        let width = self.columns.len();
        let mut differs = vec![false; places.len()];
        let row = |v: usize| &coordinates[v * width..(v + 1) * width];
        for (v, f) in first.iter().map(|f| *f as usize).enumerate() {
            differs[f] |= row(v) != row(f);
        }
        let count = first.iter().enumerate().filter(|(v, f)| *v == **f as usize).count();
        differs.iter().filter(|d| **d).count() as f64 / count.max(1) as f64
    }

    /// Whether a level of so many triangles is welded, which all levels after it are, too.
    pub fn begins(&self, triangles: u64, source: u64, is_stuck: bool, seams: impl Fn() -> f64) -> bool {
        self.is_on || (is_stuck || triangles * LEAST_REDUCTION <= source) && seams() >= SEAM_PART
    }
}
