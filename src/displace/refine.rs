//! Adaptive refinement by bisection of longest edges (Rivara 1984).
//!
//! A triangle that is too far from the surface has its longest edge halved, and so has, in turn, every triangle that an edge
//! of is halved: its longest edge is, too. Which edge of two is longer, and where an edge is halved, depends on the edge alone,
//! which is one record for all triangles at it. So no crack can open, and angles stay above half of those of the source.

use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::source::{Face, Place, Source, edge_key};
use crate::error::{Error, Result};

/// Bisections of a source triangle; places are then multiples of 2⁻⁴⁴, exact in double precision.
const MOST_BISECTIONS: u8 = 44;
/// This part of the triangles that are allowed may stay unused.
const ROOM_LEFT: usize = 100;
/// Which vertices and edges there are none of.
const NONE: u32 = u32::MAX;

/// A triangle of the result.
#[derive(Clone, Copy)]
pub(super) struct Piece {
    pub vertices: [u32; 3],
    /// Those across the vertices.
    edges: [u32; 3],
    /// The source face, and where in it the vertices are.
    pub face: u32,
    pub places: [Place; 3],
    depth: u8,
    /// How far it is from the surface, at most; NaN where nobody has looked.
    pub off: f64,
}

/// An edge, halved or not.
struct Edge {
    ends: [u32; 2],
    /// Squared length on the source.
    length: f64,
    middle: u32,
    halves: [u32; 2],
}

/// Whether to go on.
pub(super) type Check<'a> = &'a (dyn Fn() -> bool + Sync);

pub(super) struct Refined {
    pub pieces: Vec<Piece>,
    /// Vertices of the exact surface.
    pub vertices: Vec<DVec3>,
}

struct Mesh<'a> {
    source: &'a Source<'a>,
    pieces: Vec<Piece>,
    edges: Vec<Edge>,
    vertices: Vec<DVec3>,
    /// On the source.
    bases: Vec<DVec3>,
}

/// The corners of a source face.
const CORNERS: [Place; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl<'a> Mesh<'a> {
    fn new(source: &'a Source<'a>) -> Self {
        let mut mesh = Self {
            source,
            pieces: Vec::with_capacity(source.faces.len()),
            edges: Vec::new(),
            vertices: vec![DVec3::ZERO; source.points.len()],
            bases: source.points.clone(),
        };
        let mut known: FxHashMap<[u32; 2], u32> = FxHashMap::default();
        for (number, face) in source.faces.iter().enumerate() {
            let edges = [0, 1, 2].map(|k| {
                let key = edge_key(face.points[(k + 1) % 3], face.points[(k + 2) % 3]);
                *known.entry(key).or_insert_with(|| mesh.add_edge(key))
            });
            for k in 0..3 {
                mesh.vertices[face.points[k] as usize] = source.point(face, CORNERS[k]);
            }
            mesh.pieces.push(Piece {
                vertices: face.points,
                edges,
                face: number as u32,
                places: CORNERS,
                depth: 0,
                off: f64::NAN,
            });
        }
        mesh
    }

    fn add_edge(&mut self, ends: [u32; 2]) -> u32 {
        let [a, b] = ends.map(|v| self.bases[v as usize]);
        self.edges.push(Edge { ends, length: a.distance_squared(b), middle: NONE, halves: [NONE; 2] });
        (self.edges.len() - 1) as u32
    }

    fn face(&self, piece: &Piece) -> &'a Face {
        &self.source.faces[piece.face as usize]
    }

    /// Which edge of a piece is longest; of those as long the one of the lower number.
    fn longest(&self, piece: &Piece) -> usize {
        let longer = |a: u32, b: u32| {
            let (x, y) = (self.edges[a as usize].length, self.edges[b as usize].length);
            x > y || (x == y && a < b)
        };
        (1..3).fold(0, |best, k| if longer(piece.edges[k], piece.edges[best]) { k } else { best })
    }

    /// Finds how far pieces are off that nobody has looked at; exactly, or whether it is more than `enough`.
    fn look(&mut self, enough: f64, check: Check<'_>) -> Result<()> {
        let source = self.source;
        self.pieces.par_iter_mut().with_min_len(16).try_for_each(|piece| {
            if piece.off.is_nan() {
                if !check() {
                    return Err(Error::Cancelled);
                }
                let face = &source.faces[piece.face as usize];
                piece.off = source.bend(face, &piece.places, enough);
            }
            Ok(())
        })
    }

    /// Marks the longest edges of these pieces, and what follows; how many triangles that adds.
    fn mark(&self, chosen: &[u32]) -> (Vec<bool>, usize) {
        let mut marked = vec![false; self.edges.len()];
        for k in chosen {
            let piece = &self.pieces[*k as usize];
            marked[piece.edges[self.longest(piece)] as usize] = true;
        }
        loop {
            let more: Vec<u32> = self
                .pieces
                .par_iter()
                .filter_map(|piece| {
                    let touched = piece.edges.iter().any(|e| marked[*e as usize]);
                    let longest = piece.edges[self.longest(piece)];
                    (touched && !marked[longest as usize]).then_some(longest)
                })
                .collect();
            if more.is_empty() {
                break;
            }
            more.into_iter().for_each(|e| marked[e as usize] = true);
        }
        let halved = |p: &Piece| p.edges.iter().filter(|e| marked[**e as usize]).count();
        let added = self.pieces.par_iter().map(halved).sum();
        (marked, added)
    }

    /// Halves what is marked.
    fn split(&mut self, marked: &[bool]) -> Result<()> {
        let mut stack = Vec::new();
        let old = std::mem::take(&mut self.pieces);
        for piece in old {
            if !piece.edges.iter().any(|e| marked[*e as usize]) {
                self.pieces.push(piece);
                continue;
            }
            let [a, b] = self.halves(&piece, self.longest(&piece))?;
            stack.extend([b, a]);
            while let Some(part) = stack.pop() {
                match (0..3).find(|k| marked.get(part.edges[*k] as usize).is_some_and(|m| *m)) {
                    Some(k) => {
                        let [a, b] = self.halves(&part, k)?;
                        stack.extend([b, a]);
                    }
                    None => self.pieces.push(part),
                }
            }
        }
        Ok(())
    }

    /// The halves of a piece on both sides of the middle of edge k.
    fn halves(&mut self, piece: &Piece, k: usize) -> Result<[Piece; 2]> {
        let (a, b) = ((k + 1) % 3, (k + 2) % 3);
        let number = piece.edges[k] as usize;
        let middle_place = [0, 1, 2].map(|x| 0.5 * (piece.places[a][x] + piece.places[b][x]));
        if self.edges[number].middle == NONE {
            if self.vertices.len() + 1 >= NONE as usize || self.edges.len() + 3 >= NONE as usize {
                return Err(Error::TooLarge("displacement makes more vertices than 32 bits count".into()));
            }
            let face = self.face(piece);
            self.edges[number].middle = self.vertices.len() as u32;
            self.vertices.push(self.source.point(face, middle_place));
            self.bases.push(self.source.base(face, middle_place));
            let (ends, middle) = (self.edges[number].ends, self.edges[number].middle);
            self.edges[number].halves = ends.map(|end| self.add_edge([end, middle]));
        }
        let Edge { ends, middle, halves, .. } = self.edges[number];
        let across = self.add_edge(edge_key(piece.vertices[k], middle));
        let half = |kept: usize, lost: usize| {
            let mut half = *piece;
            half.vertices[lost] = middle;
            half.places[lost] = middle_place;
            half.edges[k] = halves[usize::from(ends[1] == piece.vertices[kept])];
            half.edges[kept] = across;
            half.depth += 1;
            half.off = f64::NAN;
            half
        };
        Ok([half(a, b), half(b, a)])
    }
}

/// Refines until every triangle is within `tolerance`, there are `most` triangles, or bisections are spent.
pub(super) fn refine(source: &Source<'_>, tolerance: f64, most: usize, check: Check<'_>) -> Result<Refined> {
    let mut mesh = Mesh::new(source);
    loop {
        if !check() {
            return Err(Error::Cancelled);
        }
        mesh.look(tolerance, check)?;
        let mut chosen: Vec<u32> = (0..mesh.pieces.len() as u32)
            .filter(|k| {
                let piece = &mesh.pieces[*k as usize];
                piece.off > tolerance && piece.depth < MOST_BISECTIONS
            })
            .collect();
        // What a few more would help is not worth finding them.
        if chosen.is_empty() || mesh.pieces.len() >= most - most / ROOM_LEFT {
            break;
        }
        let (mut marked, mut added) = mesh.mark(&chosen);
        if mesh.pieces.len() + added > most {
            // The worst first, as many as there is room for. What is known to be too far is known to be so far at least.
            chosen.sort_by(|a, b| mesh.pieces[*b as usize].off.total_cmp(&mesh.pieces[*a as usize].off));
            while mesh.pieces.len() + added > most && !chosen.is_empty() {
                chosen.truncate(chosen.len() / 2);
                (marked, added) = mesh.mark(&chosen);
            }
            if chosen.is_empty() {
                break;
            }
        }
        mesh.split(&marked)?;
    }
    // What stayed too far was looked at until that was known.
    mesh.pieces.iter_mut().filter(|p| p.off > tolerance).for_each(|p| p.off = f64::NAN);
    mesh.look(f64::INFINITY, check)?;
    Ok(Refined { pieces: mesh.pieces, vertices: mesh.vertices })
}
