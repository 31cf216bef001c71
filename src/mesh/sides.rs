//! Faces that occur in both windings: the two sides of such a sheet get vertices of their own, so that each side
//! has normals that point away from it. At a shared vertex the normals would cancel out, and the remainder would
//! have any sign.

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::hash;

/// Meshes of more faces are looked at only where more than two faces meet at an edge, as they do inside of such sheets.
const FEW: usize = 1000;

/// Faces with a vertex for each side.
#[derive(Clone, Debug)]
pub struct BySide {
    /// The faces over the vertices given and, after them, the copies.
    pub faces: Vec<[u32; 3]>,
    /// The vertex that each copy is one of.
    pub copies: Vec<u32>,
}

/// Copies the vertices of faces that are there in both windings; `crowded` is the number of edges with more than two
/// faces. None where there are no such faces.
pub fn split(
    faces: &[[u32; 3]],
    positions: &[[f32; 3]],
    position_ids: &[u32],
    crowded: u64,
) -> Option<BySide> {
    if crowded == 0 && faces.len() > FEW {
        return None;
    }
    let sorted = |face: &[u32; 3]| {
        let mut points = face.map(|v| position_ids[v as usize]);
        points.sort_unstable();
        points
    };
    let keys: Vec<[u32; 3]> = faces.iter().map(sorted).collect();
    let first = hash::first_equal(bytemuck::cast_slice(&keys), 3);
    let mut doubled = vec![false; faces.len()];
    for (f, first) in first.iter().enumerate() {
        if *first as usize != f {
            (doubled[f], doubled[*first as usize]) = (true, true);
        }
    }
    let normal = |f: usize| {
        let [a, b, c] = faces[f].map(|v| DVec3::from_array(positions[v as usize].map(f64::from)));
        (b - a).cross(c - a).normalize_or_zero()
    };
    // At each position the front of the first such face.
    let mut fronts: FxHashMap<u32, DVec3> = FxHashMap::default();
    for f in (0..faces.len()).filter(|f| doubled[*f]) {
        let front = normal(f);
        keys[f].iter().for_each(|p| {
            fronts.entry(*p).or_insert(front);
        });
    }
    if fronts.is_empty() {
        return None;
    }
    let mut out = BySide { faces: faces.to_vec(), copies: Vec::new() };
    let mut known: FxHashMap<u32, u32> = FxHashMap::default();
    for f in 0..faces.len() {
        for k in 0..3 {
            let v = faces[f][k];
            let Some(front) = fronts.get(&position_ids[v as usize]) else { continue };
            if normal(f).dot(*front) >= 0.0 {
                continue;
            }
            out.faces[f][k] = *known.entry(v).or_insert_with(|| {
                out.copies.push(v);
                (positions.len() + out.copies.len()) as u32 - 1
            });
        }
    }
    (!out.copies.is_empty()).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

    #[test]
    fn each_side_has_vertices_of_its_own() {
        let faces = [[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]];
        let split = split(&faces, &SQUARE, &[0, 1, 2, 3], 1).unwrap();
        assert_eq!(split.copies.len(), 4);
        assert_eq!(split.faces[..2], faces[..2]);
        assert!(split.faces[2..].iter().flatten().all(|v| *v >= 4));
    }

    #[test]
    fn what_is_there_once_stays() {
        let faces = [[0, 1, 2], [0, 2, 3]];
        assert!(split(&faces, &SQUARE, &[0, 1, 2, 3], 0).is_none());
    }
}
