//! The surface that errors are measured against. Errors measured against the level below add up: after many levels
//! their sum is several times the true distance. So the surface of every few levels becomes the reference, and the
//! following levels are measured against it. The reference's own error enters once, and is small.
//!
//! From the new surface to the reference any nearest point will do. For the other direction, the reference's
//! triangles travel up the DAG with the clusters that correspond to them. A triangle that lies on several clusters
//! is cut into pieces, so that each piece is measured by the group that simplifies its part of the surface. The
//! proof is in docs/numerics.md.

mod correspondence;
mod pieces;

use std::sync::{Arc, OnceLock};

use super::dag::BuildCluster;
use super::store::{LevelPositions, Numbering};
use crate::math::Aabb;
use crate::measure::closest::Triangle;
use crate::measure::overlay::Sheet;

pub use self::correspondence::{Correspondence, Patch};
use self::pieces::Joined;
pub use self::pieces::Pieces;

/// The first reference, the source, serves until this part of its triangles is left: a level costs in proportion to
/// the reference's triangles.
const FIRST_PART: f32 = 0.3;
/// The same for each further one.
const PART: f32 = 0.08;
/// Triangles in so many parts or more stay cut.
const MANY: u8 = u8::MAX;
/// Levels of a reference at most.
const MOST_LEVELS: u32 = 8;

/// The surface of an earlier level.
#[derive(Debug)]
pub struct Reference {
    positions: Arc<LevelPositions>,
    /// Its clusters, and the number of the first triangle of each.
    clusters: Vec<u32>,
    starts: Vec<u32>,
    /// The boxes of its clusters, computed when first needed.
    boxes: OnceLock<Vec<Aabb>>,
    /// Number of its triangles.
    count: u32,
    /// The radius of each of their triangles; empty at the source.
    radii: Vec<f32>,
    /// In how many parts each of them is in the current level, or [`MANY`]; empty where all are whole.
    shares: Vec<u8>,
    /// It is replaced when so many triangles are left.
    least: f32,
    levels: u32,
    is_last: bool,
}

/// A part of a reference: triangles numbered from 0 in order of first use.
struct Local {
    triangles: Vec<Triangle>,
    corners: Vec<[u32; 3]>,
    radii: Vec<f64>,
    of_points: Numbering,
}

impl Reference {
    /// The surface of a level's clusters, which is that of the source or not.
    pub fn new(
        is_source: bool,
        positions: Arc<LevelPositions>,
        pending: &[u32],
        all: &[BuildCluster],
    ) -> Self {
        let mut starts = Vec::with_capacity(pending.len());
        let mut count = 0;
        for c in pending {
            starts.push(count);
            count += all[*c as usize].mesh.triangles.len() as u32;
        }
        let (part, radii) = match is_source {
            true => (FIRST_PART, Vec::new()),
            false => (PART, pending.iter().flat_map(|c| radii(&all[*c as usize])).collect()),
        };
        let least = count as f32 * part;
        let clusters = pending.to_vec();
        Self {
            positions,
            clusters,
            starts,
            boxes: OnceLock::new(),
            count,
            radii,
            shares: Vec::new(),
            least,
            levels: 0,
            is_last: false,
        }
    }

    /// Whether the current level is the last one that is measured against it.
    pub fn has_served(&self) -> bool {
        self.is_last
    }

    /// Begins a level with `target` triangles, with the pieces of its clusters; no other follows that `ends` the growth.
    pub fn begin<'a>(&mut self, target: f32, ends: bool, pieces: impl Iterator<Item = &'a Pieces>) {
        self.levels += 1;
        self.is_last = ends || target < self.least || self.levels == MOST_LEVELS;
        self.shares.clear();
        for (t, ..) in pieces.flat_map(|pieces| &pieces.parts) {
            if self.shares.is_empty() {
                self.shares.resize(self.count as usize, 0);
            }
            let share = &mut self.shares[*t as usize];
            *share = share.saturating_add(1);
        }
    }

    /// Joins the parts of triangles that are all here: what corresponds to each part corresponds to the triangle.
    fn join(&self, pieces: &mut [Pieces]) {
        let mut numbering = Numbering::with_room(pieces.iter().map(|p| p.parts.len()).sum());
        let mut missing = Vec::new();
        for (t, ..) in pieces.iter().flat_map(|pieces| &pieces.parts) {
            let (number, new) = numbering.number(*t);
            if new {
                missing.push(self.shares[*t as usize]);
            }
            let missing = &mut missing[number as usize];
            *missing -= u8::from(*missing != MANY);
        }
        let mut joined = vec![false; missing.len()];
        for pieces in pieces {
            pieces.join(|t| {
                let number = numbering.number(t).0 as usize;
                match (missing[number], std::mem::replace(&mut joined[number], true)) {
                    (0, false) => Joined::Whole,
                    (0, true) => Joined::Gone,
                    _ => Joined::Part,
                }
            });
        }
    }

    /// What each of its clusters corresponds to: itself.
    pub fn pieces<'a>(&'a self, all: &'a [BuildCluster]) -> impl Iterator<Item = Pieces> + 'a {
        self.clusters.iter().zip(&self.starts).map(|(c, start)| {
            let count = all[*c as usize].mesh.triangles.len() as u32;
            Pieces { whole: (*start..start + count).collect(), ..Pieces::default() }
        })
    }

    /// The triangles that some clusters correspond to, and the number of each in the order of [`Pieces::each`].
    fn local(&self, pieces: &[Pieces], all: &[BuildCluster]) -> (Local, Vec<u32>) {
        let count = pieces.iter().map(|p| p.whole.len() + p.parts.len()).sum();
        let mut of_triangles = Numbering::with_room(count);
        let mut out = Local::with_room(count);
        let mut numbers = Vec::with_capacity(count);
        let mut slot = 0;
        let mut add = |t: u32| {
            let (number, new) = of_triangles.number(t);
            numbers.push(number);
            if !new {
                return;
            }
            // Mostly the slot of the triangle before.
            let holds = |slot: usize| {
                self.starts[slot] <= t && self.starts.get(slot + 1).is_none_or(|next| t < *next)
            };
            if !holds(slot) {
                slot = self.starts.partition_point(|start| *start <= t) - 1;
            }
            self.add(&mut out, slot, t, all);
        };
        for pieces in pieces {
            pieces.whole.iter().for_each(|t| add(*t));
            pieces.parts.iter().for_each(|part| add(part.0));
        }
        (out, numbers)
    }

    /// Adds a triangle of the cluster in a slot.
    fn add(&self, out: &mut Local, slot: usize, t: u32, all: &[BuildCluster]) {
        let cluster = &all[self.clusters[slot] as usize];
        let positions = self.positions.of(slot);
        let corners =
            cluster.mesh.triangles[(t - self.starts[slot]) as usize].map(|v| positions[usize::from(v)]);
        out.triangles.push(corners.map(|p| self.positions.positions[p as usize].map(f64::from)));
        out.corners.push(corners.map(|p| out.of_points.number(p).0));
        out.radii.push(self.radii.get(t as usize).copied().map_or(0.0, f64::from));
    }

    /// All clusters of the reference within `reach` of a triangle, whatever corresponds to them; `None` where there
    /// are none.
    fn around(&self, triangle: Triangle, reach: f64, all: &[BuildCluster]) -> Option<Sheet> {
        // Not in parallel: a thread that waits here could steal a task of this level, which waits for the boxes.
        let boxes = self.boxes.get_or_init(|| {
            let place = |p: &u32| &self.positions.positions[*p as usize];
            (0..self.clusters.len())
                .map(|slot| Aabb::of_points(self.positions.of(slot).iter().map(place)))
                .collect()
        });
        let side = |k: usize| triangle.map(|corner| corner[k]);
        let [low, high]: [[f64; 3]; 2] = [
            std::array::from_fn(|k| side(k).into_iter().fold(f64::INFINITY, f64::min) - reach),
            std::array::from_fn(|k| side(k).into_iter().fold(f64::NEG_INFINITY, f64::max) + reach),
        ];
        let mut out = Local::with_room(0);
        for (slot, of) in boxes.iter().enumerate() {
            if (0..3).all(|k| f64::from(of.min[k]) <= high[k] && f64::from(of.max[k]) >= low[k]) {
                let count = all[self.clusters[slot] as usize].mesh.triangles.len() as u32;
                let start = self.starts[slot];
                (start..start + count).for_each(|t| self.add(&mut out, slot, t, all));
            }
        }
        (!out.triangles.is_empty()).then(|| out.sheet())
    }
}

impl Local {
    fn with_room(count: usize) -> Self {
        Self {
            triangles: Vec::with_capacity(count),
            corners: Vec::with_capacity(count),
            radii: Vec::with_capacity(count),
            of_points: Numbering::with_room(count),
        }
    }

    fn sheet(self) -> Sheet {
        Sheet::new(self.triangles, &self.corners, self.radii)
    }
}

/// Of the triangles of a cluster.
fn radii(cluster: &BuildCluster) -> impl Iterator<Item = f32> {
    let own = &cluster.pieces.radii;
    // The whole cluster has one bound where it was stuck.
    let rest = cluster.mesh.triangles.len() - own.len();
    own.iter().copied().chain(std::iter::repeat_n(cluster.bound, rest))
}

#[cfg(test)]
mod tests;
