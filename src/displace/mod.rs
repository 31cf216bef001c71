//! Displacement with a proven bound: triangles within a tolerance of a surface that a height map is put on.
//!
//! Heights are interpolated bilinearly, normals linearly; `source.rs` defines the surface, also where it is torn. `refine.rs`
//! halves triangles until each is within the tolerance, by `map.rs` of heights and `bend.rs` of normals. Each point of the
//! result stands for the one of the surface with the same barycentric coordinates, so that the bound is one of both
//! directions.

mod bend;
pub mod heightfield;
pub mod map;
mod refine;
mod source;

use glam::DVec3;
use rustc_hash::FxHashMap;

use crate::error::{Error, Result};
pub use map::{HeightMap, Texels};
use refine::{Piece, Refined};
use source::{Face, Source, Wedge};

/// A mesh to displace.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    /// Positions.
    pub vertices: &'a [[f64; 3]],
    /// Corners of triangles.
    pub faces: &'a [[u32; 3]],
    /// Texture coordinates, v up.
    pub uvs: &'a [[f64; 2]],
    /// Normals of any length; computed, weighted by angle, over all faces at a position, without.
    pub normals: Option<&'a [[f64; 3]]>,
}

/// How to displace.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Times the heights.
    pub scale: f64,
    /// The height that stays where it is.
    pub midlevel: f64,
    /// How far the result may be from the exact surface.
    pub tolerance: f64,
    /// Triangles at most.
    pub max_triangles: usize,
}

/// A displaced mesh.
#[derive(Clone, Debug, Default)]
pub struct Displaced {
    /// Points of the exact surface.
    pub vertices: Vec<[f64; 3]>,
    /// Corners of triangles.
    pub faces: Vec<[u32; 3]>,
    /// Texture coordinates of vertices.
    pub uvs: Vec<[f64; 2]>,
    /// Unit normals of the result, weighted by angle over the faces whose source normals agree.
    pub normals: Vec<[f64; 3]>,
    /// The row of the source face of each face.
    pub face_ids: Vec<u32>,
    /// A bound of the distance between the result and the exact surface, both ways.
    pub error: f64,
    /// A bound of how far the surface is from what faces alone say, where it is torn.
    pub tear: f64,
    /// Faces of the source without an edge between two of their corners, left out.
    pub dropped: usize,
}

/// Displaces a mesh; `check` says whether to go on.
pub fn displace(
    input: Input<'_>,
    map: HeightMap<'_>,
    options: &Options,
    check: &(dyn Fn() -> bool + Sync),
) -> Result<Displaced> {
    check_numbers(&input, &map)?;
    let (points, faces) = welded(&input);
    let dropped = input.faces.len() - faces.len();
    if faces.is_empty() {
        return Err(Error::EmptyMesh("no face has three different corners".into()));
    }
    let source = Source::new(map, [options.scale, options.midlevel], points, faces);
    let rounding = source.rounding();
    if !(rounding * rounding).is_finite() {
        return Err(Error::argument(
            "scale",
            "positions, heights and the scale are too large to be multiplied",
        ));
    }
    // So that what is stated meets the tolerance where that can be.
    let aim = (options.tolerance - rounding) * (1.0 - RELATIVE_ROUNDING);
    let refined = refine::refine(&source, aim.max(0.0), options.max_triangles, check)?;
    let most = refined.pieces.iter().map(|p| p.off).fold(0.0, f64::max);
    let mut out = assemble(&source, &refined);
    out.error = most * (1.0 + RELATIVE_ROUNDING) + rounding;
    out.tear = tear(&source, &refined.pieces);
    if out.tear > 0.0 {
        out.tear = out.tear * (1.0 + RELATIVE_ROUNDING) + rounding;
    }
    out.dropped = dropped;
    Ok(out)
}

/// Texels from the origin of a map, at most: there, places still have eleven bits below a texel.
const MOST_TEXELS: f64 = (1_u64 << 42) as f64;

fn check_numbers(input: &Input<'_>, map: &HeightMap<'_>) -> Result<()> {
    for (index, vertex) in input.vertices.iter().enumerate() {
        if !vertex.iter().all(|x| x.is_finite()) {
            return Err(Error::NonFinite { argument: "vertices".into(), index, value: vertex.to_vec() });
        }
    }
    for (index, uv) in input.uvs.iter().enumerate() {
        if !map.place(*uv).iter().all(|x| x.abs() < MOST_TEXELS) {
            let message = format!("row {index}, {uv:?}, is too many texels away from the map");
            return Err(Error::argument("uvs", message));
        }
    }
    Ok(())
}

/// What sums and products of bounds are rounded by, far less than this.
const RELATIVE_ROUNDING: f64 = 1e-12;

/// Positions, each once, and faces of three different ones.
fn welded(input: &Input<'_>) -> (Vec<DVec3>, Vec<Face>) {
    let mut known: FxHashMap<[u64; 3], u32> = FxHashMap::default();
    let mut points = Vec::new();
    let numbers: Vec<u32> = input
        .vertices
        .iter()
        .map(|v| {
            // Adding 0 makes −0 and 0 the same.
            *known.entry(v.map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                points.push(DVec3::from_array(*v));
                (points.len() - 1) as u32
            })
        })
        .collect();
    let corners = |face: &[u32; 3]| face.map(|v| numbers[v as usize]);
    let whole = |p: [u32; 3]| p[0] != p[1] && p[1] != p[2] && p[2] != p[0];
    let computed = match input.normals {
        Some(_) => Vec::new(),
        None => {
            let all = input.faces.iter().map(corners).filter(|p| whole(*p));
            let mut sums = vec![DVec3::ZERO; points.len()];
            add_normals(&points, all.map(|p| (p, p)), &mut sums);
            sums.into_iter().map(bend::unit).collect()
        }
    };
    let wedge = |v: u32| Wedge {
        uv: input.uvs[v as usize],
        normal: match input.normals {
            Some(normals) => DVec3::from_array(normals[v as usize]),
            None => computed[numbers[v as usize] as usize],
        },
    };
    let faces = (0_u32..)
        .zip(input.faces)
        .filter(|(_, face)| whole(corners(face)))
        .map(|(row, face)| Face { points: corners(face), wedges: face.map(wedge), row })
        .collect();
    (points, faces)
}

/// Adds the normals of triangles, weighted by their angles, to their rows of sums.
fn add_normals(points: &[DVec3], triangles: impl Iterator<Item = ([u32; 3], [u32; 3])>, sums: &mut [DVec3]) {
    for (corners, rows) in triangles {
        let p = corners.map(|v| points[v as usize]);
        let normal = bend::unit((p[1] - p[0]).cross(p[2] - p[0]));
        for k in 0..3 {
            let (a, b) = (bend::unit(p[(k + 1) % 3] - p[k]), bend::unit(p[(k + 2) % 3] - p[k]));
            sums[rows[k] as usize] += normal * a.dot(b).clamp(-1.0, 1.0).acos();
        }
    }
}

/// Vertices with one place, texture coordinate and normal, in the order of the faces.
fn assemble(source: &Source<'_>, refined: &Refined) -> Displaced {
    let mut out = Displaced::default();
    // Rows of sums of normals: a vertex has one for each normal that its source has there.
    let mut smooth: FxHashMap<(u32, [u64; 3]), u32> = FxHashMap::default();
    let mut known: FxHashMap<(u32, [u64; 5]), u32> = FxHashMap::default();
    let mut rows = Vec::new();
    let mut triangles = Vec::with_capacity(refined.pieces.len());
    for piece in &refined.pieces {
        let face = &source.faces[piece.face as usize];
        let corners: [(u32, u32); 3] = [0, 1, 2].map(|k| {
            let vertex = piece.vertices[k];
            let wedge = source.wedge(face, piece.places[k]);
            let key = wedge.key();
            let count = smooth.len() as u32;
            let row = *smooth.entry((vertex, [key[2], key[3], key[4]])).or_insert(count);
            let number = *known.entry((vertex, key)).or_insert_with(|| {
                out.vertices.push(refined.vertices[vertex as usize].to_array());
                out.uvs.push(wedge.uv);
                rows.push(row);
                (rows.len() - 1) as u32
            });
            (number, row)
        });
        out.faces.push(corners.map(|c| c.0));
        out.face_ids.push(face.row);
        triangles.push((piece.vertices, corners.map(|c| c.1)));
    }
    let mut sums = vec![DVec3::ZERO; smooth.len()];
    add_normals(&refined.vertices, triangles.into_iter(), &mut sums);
    out.normals = rows.iter().map(|row| bend::unit(sums[*row as usize]).to_array()).collect();
    out
}

/// A bound of how far the surface is from what faces alone say.
fn tear(source: &Source<'_>, pieces: &[Piece]) -> f64 {
    let of_piece = |piece: &Piece| {
        let face = &source.faces[piece.face as usize];
        if !source.is_torn(face) {
            return 0.0;
        }
        let corners = piece.places.iter().map(|p| source.tear(face, *p).length());
        corners.fold(0.0, f64::max) + source.tear_bend(face, &piece.places)
    };
    pieces.iter().map(of_piece).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::texture::Wrap;

    fn map(texels: &[f64], width: usize) -> HeightMap<'_> {
        let rows = [[1.0, 0.0, 0.0], [0.0, -1.0, 1.0]];
        HeightMap::new(Texels::F64(texels), [texels.len() / width, width], [Wrap::Clamp; 2], rows).unwrap()
    }

    const SQUARE: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    const UVS: [[f64; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];

    fn square(texels: &[f64], width: usize, tolerance: f64) -> Displaced {
        let input = Input { vertices: &SQUARE, faces: &[[0, 1, 2], [0, 2, 3]], uvs: &UVS, normals: None };
        let options = Options { scale: 1.0, midlevel: 0.0, tolerance, max_triangles: 1 << 20 };
        displace(input, map(texels, width), &options, &|| true).unwrap()
    }

    #[test]
    fn what_is_flat_stays() {
        let out = square(&[0.25; 64], 8, 1e-6);
        assert_eq!(out.faces.len(), 2);
        assert!(out.error < 1e-10 && out.tear == 0.0);
        assert!(out.vertices.iter().all(|v| v[2] == 0.25));
    }

    #[test]
    fn a_peak_is_met_where_it_is() {
        let mut texels = [0.0; 64];
        texels[27] = 1.0;
        let out = square(&texels, 8, 0.01);
        assert!(out.error <= 0.01 && out.faces.len() > 8);
        let top = out.vertices.iter().map(|v| v[2]).fold(0.0, f64::max);
        assert!((0.98..=1.0).contains(&top), "{top}");
    }
}
