//! Pieces: the triangles of a reference, or parts of them, that a cluster corresponds to. They travel up the DAG
//! with the clusters.

use crate::measure::closest::Triangle;
use crate::measure::piece::{CORNERS, Piece};

/// Triangles of the reference, or parts of them, that a cluster corresponds to.
#[derive(Clone, Debug, Default)]
pub struct Pieces {
    /// Numbers of whole triangles.
    pub(super) whole: Vec<u32>,
    /// Triangle, corners and cuts of each part.
    pub(super) parts: Vec<(u32, u8, u8)>,
    /// Corners of the parts, from the first corner of their triangle.
    pub(super) offsets: Vec<[f32; 3]>,
    /// Of a cluster that the next reference has: how far each of its triangles may be from what of the source it
    /// corresponds to, either way. Empty where all are at the bound of the cluster.
    pub(super) radii: Vec<f32>,
}

impl Pieces {
    /// Those of a cluster that the next reference has, whose triangles have these radii.
    pub fn of_radii(radii: Vec<f32>) -> Self {
        Self { radii, ..Self::default() }
    }

    /// See [`Pieces::of_radii`].
    pub fn radii(&self) -> &[f32] {
        &self.radii
    }

    /// No pieces, with room for about so many.
    pub(super) fn with_room(count: usize) -> Self {
        Self {
            whole: Vec::with_capacity(count),
            parts: Vec::with_capacity(count),
            offsets: Vec::with_capacity(4 * count),
            radii: Vec::new(),
        }
    }

    pub(super) fn push(&mut self, number: u32, triangle: Triangle, part: &Piece) {
        self.parts.push((number, part.corners().len() as u8, part.cuts()));
        let offset = |p: &[f64; 3]| std::array::from_fn(|k| (p[k] - triangle[0][k]) as f32);
        self.offsets.extend(part.corners().iter().map(offset));
    }

    /// Calls `visit` with each triangle, and with the corners and cuts of its part where it is not whole.
    pub(super) fn each(&self, mut visit: impl FnMut(u32, Option<(&[[f32; 3]], u8)>)) {
        self.whole.iter().for_each(|t| visit(*t, None));
        let mut rest = self.offsets.as_slice();
        for (t, count, cuts) in &self.parts {
            let (offsets, after) = rest.split_at(usize::from(*count));
            rest = after;
            visit(*t, Some((offsets, *cuts)));
        }
    }

    /// Joins parts to whole triangles, as `becomes` says of each part by its triangle.
    pub(super) fn join(&mut self, mut becomes: impl FnMut(u32) -> Joined) {
        let (whole, offsets) = (&mut self.whole, &mut self.offsets);
        let (mut from, mut to) = (0, 0);
        self.parts.retain(|(t, count, _)| {
            let corners = from..from + usize::from(*count);
            from = corners.end;
            match becomes(*t) {
                Joined::Part => {
                    offsets.copy_within(corners, to);
                    to += usize::from(*count);
                    return true;
                }
                Joined::Whole => whole.push(*t),
                Joined::Gone => {}
            }
            false
        });
        offsets.truncate(to);
    }
}

/// What becomes of a part.
pub(super) enum Joined {
    /// It stays as it is.
    Part,
    /// It stands for its triangle, which is whole again.
    Whole,
    /// Another part stands for it.
    Gone,
}

/// A stored part of a triangle.
pub(super) fn restored(triangle: Triangle, offsets: &[[f32; 3]], cuts: u8) -> Piece {
    let mut corners = [[0.0; 3]; CORNERS];
    for (corner, offset) in corners.iter_mut().zip(offsets) {
        *corner = std::array::from_fn(|k| triangle[0][k] + f64::from(offset[k]));
    }
    Piece::restored(&corners[..offsets.len()], cuts)
}
