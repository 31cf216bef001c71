//! What a tile has: the clusters that reach into its box, clipped.

use rustc_hash::{FxHashMap, FxHashSet};

use super::clip::{Key, Plane, Point, Polygon, triangulate};
use super::plan::{Crossing, Plan};
use crate::error::Result;
use crate::lod::CutArrays;
use crate::math::{Aabb, octahedral};
use crate::model::{ClusterGeometry, Dag, InterruptCheck};

/// The surface in a box.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Piece {
    /// The surface. The identity of a point that was made is that of the vertex that weighs most.
    pub arrays: CutArrays,
    /// For each triangle its material.
    pub materials: Vec<i32>,
    /// For each vertex the identities that it is made of,
    pub sources: Vec<[u32; 3]>,
    /// and what these weigh; 1, 0, 0 for a vertex of the mesh.
    pub weights: Vec<[f32; 3]>,
    /// Edges in planes that other tiles are behind, each as its triangle has it, and that triangle.
    pub borders: Vec<[u32; 3]>,
}

/// Cuts out what a tile has. Pages that are not in memory are read and do not stay.
pub fn extract(dag: &Dag, plan: &Plan, number: usize, proceed: InterruptCheck<'_>) -> Result<Piece> {
    let tile = &plan.tiles[number];
    let mut pages: Vec<usize> = tile.clusters.iter().map(|at| at.page()).collect();
    pages.dedup();
    let window = dag.pages.window(pages.into_iter(), proceed)?;
    let mut cutting = Cutting::new(dag, plan, tile.bounds);
    for at in &tile.clusters {
        let record = window.record(*at);
        cutting.cluster(&window.geometry(*at), record.material);
    }
    Ok(cutting.finish())
}

/// A side of the box that has a neighbour.
struct Side {
    plane: Plane,
    axis: usize,
    value: f32,
    crossings: Vec<Crossing>,
}

struct Cutting<'a> {
    dag: &'a Dag,
    bounds: Aabb,
    sides: Vec<Side>,
    out: Piece,
    rows: FxHashMap<Key, u32>,
    triangles: u32,
}

impl<'a> Cutting<'a> {
    fn new(dag: &'a Dag, plan: &Plan, bounds: Aabb) -> Self {
        let mut sides = Vec::new();
        for axis in 0..3 {
            for upper in [false, true] {
                if plan.is_inner(&bounds, axis, upper) {
                    let value = if upper { bounds.max[axis] } else { bounds.min[axis] };
                    let mut flat = bounds;
                    (flat.min[axis], flat.max[axis]) = (value, value);
                    let crossings = plan.crossings(&flat, axis);
                    sides.push(Side { plane: Plane::new(axis, value), axis, value, crossings });
                }
            }
        }
        let mut out = Piece::default();
        out.arrays.uvs = vec![Vec::new(); usize::from(dag.layout().uv_sets)];
        Self { dag, bounds, sides, out, rows: FxHashMap::default(), triangles: 0 }
    }

    fn cluster(&mut self, geometry: &ClusterGeometry<'_>, material: i32) {
        let ids: Vec<u32> = geometry.ids.iter().collect();
        for corners in geometry.triangles.iter() {
            let corners = corners.map(usize::from);
            let positions = corners.map(|v| geometry.positions.get(v));
            let whole = |p: &[f32; 3]| (0..3).all(|k| self.bounds.min[k] < p[k] && p[k] < self.bounds.max[k]);
            if positions.iter().all(whole) {
                let face = corners.map(|v| self.vertex(geometry, ids[v], v));
                self.face(face, material);
            } else {
                self.clipped(geometry, corners, corners.map(|v| ids[v]), positions, material);
            }
        }
    }

    fn clipped(
        &mut self,
        geometry: &ClusterGeometry<'_>,
        corners: [usize; 3],
        ids: [u32; 3],
        positions: [[f32; 3]; 3],
        material: i32,
    ) {
        self.triangles += 1;
        let mut polygon = Polygon::new(self.triangles, ids, positions);
        polygon.clip(&self.bounds);
        for side in &self.sides {
            polygon.insert(side.plane, &side.crossings);
        }
        let points: Vec<Point> = polygon.points().copied().collect();
        let rows: Vec<u32> = points
            .iter()
            .map(|point| match point.key {
                Key::Vertex(id) => {
                    let corner = ids.iter().position(|own| *own == id).map_or(0, |k| corners[k]);
                    self.vertex(geometry, id, corner)
                }
                _ => self.made(geometry, corners, ids, point),
            })
            .collect();
        let at: Vec<[f32; 3]> = points.iter().map(|point| point.position).collect();
        for triangle in triangulate(&at) {
            self.face(triangle.map(|k| rows[k]), material);
        }
    }

    fn face(&mut self, face: [u32; 3], material: i32) {
        self.out.arrays.faces.push(face);
        self.out.materials.push(material);
    }

    /// The row of a vertex of the mesh.
    fn vertex(&mut self, geometry: &ClusterGeometry<'_>, id: u32, v: usize) -> u32 {
        let key = Key::Vertex(id);
        if let Some(row) = self.rows.get(&key) {
            return *row;
        }
        let arrays = &mut self.out.arrays;
        let row = arrays.positions.len() as u32;
        arrays.positions.push(geometry.positions.get(v));
        arrays.normals.push(octahedral::decode(geometry.normals[v]));
        arrays.ids.push(id);
        let words = self.dag.layout().colors.words();
        arrays.colors.extend_from_slice(&geometry.colors[words * v..][..words]);
        for (set, uvs) in arrays.uvs.iter_mut().enumerate() {
            uvs.push(geometry.uvs[set * geometry.positions.len() + v]);
        }
        self.out.sources.push([id; 3]);
        self.out.weights.push([1.0, 0.0, 0.0]);
        self.rows.insert(key, row);
        row
    }

    /// The row of a point on a plane.
    fn made(
        &mut self,
        geometry: &ClusterGeometry<'_>,
        corners: [usize; 3],
        ids: [u32; 3],
        point: &Point,
    ) -> u32 {
        if let Some(row) = self.rows.get(&point.key) {
            return *row;
        }
        let weights = point.weights.map(|w| w as f32);
        let mixed = |values: [f32; 3]| (0..3).map(|k| weights[k] * values[k]).sum::<f32>();
        let normals = corners.map(|v| octahedral::decode(geometry.normals[v]));
        let mut row: Vec<f32> = (0..3).map(|k| mixed(normals.map(|n| n[k]))).collect();
        let format = self.dag.layout().colors;
        if format.is_some() {
            let words = format.words();
            let colors = corners.map(|v| format.unpack(&geometry.colors[words * v..][..words]));
            row.extend((0..4).map(|k| mixed(colors.map(|c| c[k]))));
        }
        let count = geometry.positions.len();
        for set in 0..usize::from(self.dag.layout().uv_sets) {
            let uvs = corners.map(|v| geometry.uvs[set * count + v]);
            row.extend((0..2).map(|k| mixed(uvs.map(|uv| uv[k]))));
        }
        let heaviest = (0..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best });
        let number = self.out.arrays.push(self.dag.layout(), point.position, ids[heaviest], &row, false) - 1;
        self.out.sources.push(ids);
        self.out.weights.push(weights);
        self.rows.insert(point.key, number);
        number
    }

    fn finish(mut self) -> Piece {
        self.out.borders = self.borders();
        self.out
    }

    /// Edges in planes with neighbours that no other triangle here has.
    fn borders(&self) -> Vec<[u32; 3]> {
        let positions = &self.out.arrays.positions;
        let bits = |v: u32| positions[v as usize].map(|x| (x + 0.0).to_bits());
        let lies = |v: u32, side: &Side| positions[v as usize][side.axis] == side.value;
        let mut found = Vec::new();
        for (row, face) in self.out.arrays.faces.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (face[k], face[(k + 1) % 3]);
                if self.sides.iter().any(|side| lies(a, side) && lies(b, side)) {
                    found.push([a, b, row as u32]);
                }
            }
        }
        let directed: FxHashSet<[[u32; 3]; 2]> = found.iter().map(|[a, b, _]| [bits(*a), bits(*b)]).collect();
        found.retain(|[a, b, _]| bits(*a) != bits(*b) && !directed.contains(&[bits(*b), bits(*a)]));
        found
    }
}
