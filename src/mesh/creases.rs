//! Creases: where faces meet at more than an angle, each side gets vertices of its own, so that computed normals are
//! smooth up to the crease and not over it. To all that follows such lines are seams, as those of UVs are.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

/// Positions that a thread takes at a time.
const RUN: usize = 1 << 12;
/// What rounding does to the cosine between faces that are parallel.
const ROUNDING: f32 = 1.0e-6;

/// Faces with a vertex for each side of a crease.
#[derive(Clone, Debug)]
pub struct Creased {
    /// The faces over the vertices given and, after them, the copies.
    pub faces: Vec<[u32; 3]>,
    /// The vertex that each copy is one of.
    pub copies: Vec<u32>,
    /// For each copy, the first vertex of its side: normals are added up by these.
    pub sides: Vec<u32>,
}

/// Copies vertices at which faces meet at more than `degrees`. Faces belong to one side of a position where a way
/// around it leads from one to the other over edges that are flatter; those without area are sides of their own.
/// None where there are no creases.
pub fn split(
    faces: &[[u32; 3]],
    positions: &[[f32; 3]],
    position_ids: &[u32],
    degrees: f32,
) -> Option<Creased> {
    let least = degrees.to_radians().cos() - ROUNDING;
    let place = |v: u32| DVec3::from_array(positions[v as usize].map(f64::from));
    let normal = |face: &[u32; 3]| {
        let [a, b, c] = face.map(place);
        (b - a).cross(c - a).normalize_or_zero().as_vec3()
    };
    let normals: Vec<Vec3> = faces.par_iter().map(normal).collect();
    let corners = Corners::new(faces, position_ids);
    let of_points = |first: usize| {
        let last = (first + RUN).min(corners.points());
        let mut sides = Vec::new();
        (first..last).for_each(|point| corners.sides(point, &normals, least, &mut sides));
        sides
    };
    let runs: Vec<usize> = (0..corners.points()).step_by(RUN).collect();
    let sides: Vec<Vec<u32>> = runs.into_par_iter().map(of_points).collect();

    let mut out = Creased { faces: Vec::new(), copies: Vec::new(), sides: Vec::new() };
    let mut known: FxHashMap<(u32, u32), u32> = FxHashMap::default();
    let mut firsts: FxHashMap<u32, u32> = FxHashMap::default();
    for (side, corner) in sides.iter().flatten().zip(&corners.list) {
        if *side == u32::MAX {
            continue; // keeps its vertex
        }
        if out.faces.is_empty() {
            out.faces = faces.to_vec();
        }
        let corner = *corner as usize;
        let v = faces[corner / 3][corner % 3];
        out.faces[corner / 3][corner % 3] = *known.entry((v, *side)).or_insert_with(|| {
            let copy = (positions.len() + out.copies.len()) as u32;
            out.copies.push(v);
            out.sides.push(*firsts.entry(*side).or_insert(copy));
            copy
        });
    }
    (!out.copies.is_empty()).then_some(out)
}

/// Corners of faces, sorted by where they are.
struct Corners<'a> {
    faces: &'a [[u32; 3]],
    position_ids: &'a [u32],
    /// Where each position's start in `list`; one more entry than positions.
    starts: Vec<u32>,
    /// Three times the face, and which of its corners.
    list: Vec<u32>,
}

impl<'a> Corners<'a> {
    fn new(faces: &'a [[u32; 3]], position_ids: &'a [u32]) -> Self {
        let mut starts = vec![0u32; position_ids.len() + 1];
        let point = |v: &u32| position_ids[*v as usize] as usize;
        faces.iter().flatten().for_each(|v| starts[point(v) + 1] += 1);
        (1..starts.len()).for_each(|k| starts[k] += starts[k - 1]);
        let mut next = starts.clone();
        let mut list = vec![0; 3 * faces.len()];
        for (corner, v) in faces.iter().flatten().enumerate() {
            let at = &mut next[point(v)];
            list[*at as usize] = corner as u32;
            *at += 1;
        }
        Self { faces, position_ids, starts, list }
    }

    fn points(&self) -> usize {
        self.starts.len() - 1
    }

    /// Appends for each corner at a position the first corner of its side; of those of the first side, that keep their
    /// vertices, `u32::MAX`.
    fn sides(&self, point: usize, normals: &[Vec3], least: f32, out: &mut Vec<u32>) {
        let list = &self.list[self.starts[point] as usize..self.starts[point + 1] as usize];
        // The ends of edges at this position, each with the place of a corner in the list.
        let mut ends: Vec<(u32, u32)> = Vec::with_capacity(2 * list.len());
        for (at, corner) in list.iter().enumerate() {
            let face = self.faces[*corner as usize / 3];
            for k in [1, 2] {
                let other = face[(*corner as usize + k) % 3];
                ends.push((self.position_ids[other as usize], at as u32));
            }
        }
        ends.sort_unstable();
        let mut parents: Vec<u32> = (0..list.len() as u32).collect();
        let of = |at: u32| normals[list[at as usize] as usize / 3];
        for edge in ends.chunk_by(|a, b| a.0 == b.0) {
            for (i, (_, a)) in edge.iter().enumerate() {
                for (_, b) in &edge[i + 1..] {
                    if of(*a).dot(of(*b)) >= least {
                        let (a, b) = (root(&mut parents, *a), root(&mut parents, *b));
                        parents[a.max(b) as usize] = a.min(b);
                    }
                }
            }
        }
        for at in 0..list.len() as u32 {
            let first = root(&mut parents, at);
            out.push(if first == 0 { u32::MAX } else { list[first as usize] });
        }
    }
}

/// The first of a set.
fn root(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        parents[at as usize] = parents[parents[at as usize] as usize];
        at = parents[at as usize];
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A roof of two squares along an edge, the second turned up by an angle.
    fn roof(degrees: f32) -> ([[f32; 3]; 6], [[u32; 3]; 4]) {
        let (s, c) = degrees.to_radians().sin_cos();
        let positions =
            [[-1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [c, 0.0, s], [c, 1.0, s]];
        (positions, [[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]])
    }

    #[test]
    fn vertices_of_a_sharp_edge_are_split_and_no_others() {
        let ids = [0, 1, 2, 3, 4, 5];
        let (positions, faces) = roof(40.0);
        let split = split(&faces, &positions, &ids, 30.0).unwrap();
        assert_eq!(split.copies, [2, 3]);
        assert_eq!(split.sides, [6, 7]);
        assert_eq!(split.faces, [[0, 2, 3], [0, 3, 1], [6, 4, 5], [6, 5, 7]]);
    }

    #[test]
    fn flat_edges_stay_whole() {
        let ids = [0, 1, 2, 3, 4, 5];
        for (turn, angle) in [(20.0, 30.0), (0.0, 0.0), (90.0, 180.0)] {
            let (positions, faces) = roof(turn);
            assert!(split(&faces, &positions, &ids, angle).is_none(), "{turn} {angle}");
        }
    }
}
