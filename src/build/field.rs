//! The attributes of a group's surface at any of its points, for columns that do not steer the simplifier.

use glam::DVec3;

use super::collapse::wedges::nearest;
use super::content::Content;
use super::source_labels::label_at;
use super::store::LocalMesh;
use crate::measure::TriangleTree;
use crate::mesh::{Stars, hash};

/// A place with the vertex's own label may be farther than others by this part of the mean edge length.
const LABEL_TIE: f32 = 1.0e-3;

/// A place on a surface.
#[derive(Clone, Copy, Debug, Default)]
pub struct Place {
    /// Vertices of its triangle.
    pub corners: [u32; 3],
    /// Its barycentric coordinates.
    pub at: [f32; 3],
    /// Its distance to the point it was looked up for.
    pub distance: f32,
}

/// A surface with what its vertices carry.
#[derive(Debug)]
pub struct Field<'a> {
    mesh: &'a LocalMesh,
    stride: usize,
    tree: TriangleTree,
    /// The first vertex at the position of each.
    positions: Vec<u32>,
    /// Triangles around those.
    stars: Stars,
}

impl<'a> Field<'a> {
    /// The surface of a mesh.
    pub fn new(mesh: &'a LocalMesh, content: &Content) -> Self {
        let point = |v: u32| mesh.positions[v as usize];
        let triangles = mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]].map(point)).collect();
        // By the present positions: a simplifier may have joined vertices that were apart.
        let positions = hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3);
        let by_position: Vec<u32> = mesh.indices.iter().map(|v| positions[*v as usize]).collect();
        Self {
            mesh,
            stride: content.stride(),
            tree: TriangleTree::of(triangles),
            stars: Stars::new(mesh.positions.len(), &by_position),
            positions,
        }
    }

    fn place(&self, p: [f32; 3], triangle: u32) -> Place {
        let corners = &self.mesh.indices[3 * triangle as usize..][..3];
        let p = DVec3::from_array(p.map(f64::from));
        let point = |v: u32| DVec3::from_array(self.mesh.positions[v as usize].map(f64::from));
        let points = [corners[0], corners[1], corners[2]].map(point);
        let at = nearest(p, points);
        let distance = (points[0] * at[0] + points[1] * at[1] + points[2] * at[2]).distance(p);
        Place {
            corners: [corners[0], corners[1], corners[2]],
            at: at.map(|x| x as f32),
            distance: distance as f32,
        }
    }

    /// The attribute rows at the corners of a place.
    pub fn rows(&self, place: &Place) -> [&'a [f32]; 3] {
        place.corners.map(|v| &self.mesh.attributes[v as usize * self.stride..][..self.stride])
    }

    /// The label at a place: that of the corner that is nearest by its barycentric coordinates, equal ones added.
    pub fn label(&self, place: &Place) -> u32 {
        label_at(place.corners.map(|v| self.mesh.labels[v as usize]), place.at)
    }

    /// The material at a place.
    pub fn material(&self, place: &Place) -> u32 {
        self.mesh.materials[place.corners[0] as usize]
    }

    /// Of the place nearest to `p` and those on the triangles around it, the one with the least `cost`, which takes
    /// a place and how much farther it is than the nearest one. Stops at the first with a cost of `enough` or less.
    /// `near` is a triangle to start from, and becomes the nearest one.
    pub fn best_place(
        &self,
        p: [f32; 3],
        near: &mut u32,
        enough: f32,
        cost: impl Fn(&Place, f32) -> f32,
    ) -> (Place, f32) {
        *near = self.tree.nearest(p, *near);
        let mut place = self.place(p, *near);
        let distance = place.distance;
        let mut least = cost(&place, 0.0);
        let around = place.corners.map(|v| self.positions[v as usize]);
        for (t, _) in around.iter().flat_map(|position| self.stars.of(*position as usize)) {
            if least <= enough {
                break;
            }
            let other = self.place(p, t as u32);
            let cost = cost(&other, (other.distance - distance).max(0.0));
            if cost < least {
                (place, least) = (other, cost);
            }
        }
        (place, least)
    }

    /// Gives the vertices of `after` that moved its columns from `first` on, and the labels of the source where these are
    /// known, otherwise those of this surface.
    pub fn read_off(&self, after: &mut LocalMesh, content: &Content, first: usize, edge: f32) {
        let mut used = vec![false; after.positions.len()];
        after.indices.iter().for_each(|v| used[*v as usize] = true);
        let (mut near, mut source_near) = (0, 0);
        for v in (0..used.len()).filter(|v| used[*v]) {
            if after.positions[v] == self.mesh.positions[after.origin(v)] {
                continue;
            }
            let row = v * self.stride..(v + 1) * self.stride;
            let known = &after.attributes[row.clone()][..first];
            let label = after.labels.get(v);
            let material = after.materials.get(v);
            let cost = |place: &Place, farther: f32| {
                if material.is_some_and(|material| self.material(place) != *material) {
                    return f32::INFINITY;
                }
                let other = label.is_some_and(|label| self.label(place) != *label);
                let deviation = edge * content.deviation(known, self.rows(place), place.at);
                farther.max(deviation) + if other { LABEL_TIE * edge } else { 0.0 }
            };
            let (place, _) = self.best_place(after.positions[v], &mut near, 0.0, cost);
            let rows = self.rows(&place);
            for (k, x) in after.attributes[row].iter_mut().enumerate().skip(first) {
                *x = (0..3).map(|c| place.at[c] * rows[c][k]).sum();
            }
            if !after.labels.is_empty() {
                let normal = &after.attributes[v * self.stride..][..3];
                let material = after.materials.get(v).copied();
                let source = content.source_labels.as_ref();
                let found =
                    source.and_then(|s| s.label(after.positions[v], normal, material, &mut source_near));
                after.labels[v] = found.unwrap_or_else(|| self.label(&place));
            }
        }
    }
}
