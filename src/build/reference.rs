//! What a round is measured against. Errors measured against the level below add up, and after many levels their
//! sum is several times the true distance. So every few rounds the surface as it then is becomes the reference, and
//! the rounds after it are measured against that: its own error enters once, and is small.
//!
//! From the new surface to the reference any nearest point will do. The other way the reference's triangles travel up
//! the DAG with the clusters that correspond to them, cut in pieces where they lie on several, so that each is measured
//! by the group that simplifies its part of the surface. The proof is in docs/numerics.md.

use std::sync::{Arc, OnceLock};

use glam::DVec3;

use super::clusterize::ClusterMesh;
use super::dag::BuildCluster;
use super::relax::{Sample, area_normal};
use super::store::{Numbering, RoundPositions};
use crate::math::Aabb;
use crate::math::sphere::round_up;
use crate::measure::closest::Triangle;
use crate::measure::overlay::{Bounds, NO_TRIANGLE, Overlay, Sheet};
use crate::measure::piece::{CORNERS, Piece};
use crate::measure::{BoundOptions, outwards};
use crate::mesh::hash;

/// The first reference, which is the source, serves until this part of its triangles is left: each round costs in
/// proportion to them.
const FIRST_PART: f32 = 0.3;
/// The same for each further one.
const PART: f32 = 0.08;
/// Triangles in so many parts or more stay cut.
const MANY: u8 = u8::MAX;
/// Rounds of a reference at most.
const MOST_ROUNDS: u32 = 8;
/// How far storing a part moves its corners, as a part of the size of its triangle: once a round but the last, by up to
/// √3 · 2⁻²⁴.
const PART_ROUNDING: f64 = 1.0 / (1u64 << 20) as f64;
/// So many pieces for each triangle made need no more samples than their centres.
const DENSE: usize = 4;
/// A bound may be this part above the largest distance found.
const SLACK: f64 = 0.1;
/// Distances below this part of the simplifier's estimate are not told apart: the largest is above it.
const FLOOR: f64 = 0.1;

/// Triangles of the reference, or parts of them, that a cluster corresponds to.
#[derive(Clone, Debug, Default)]
pub struct Pieces {
    /// Numbers of whole triangles.
    whole: Vec<u32>,
    /// Triangle, corners and cuts of each part.
    parts: Vec<(u32, u8, u8)>,
    /// Corners of the parts, from the first corner of their triangle.
    offsets: Vec<[f32; 3]>,
    /// Of a cluster that the next reference has: how far each of its triangles may be from what of the source it
    /// corresponds to, either way. Empty where all are at the bound of the cluster.
    radii: Vec<f32>,
}

impl Pieces {
    /// None yet, with room for about so many.
    fn with_room(count: usize) -> Self {
        Self {
            whole: Vec::with_capacity(count),
            parts: Vec::with_capacity(count),
            offsets: Vec::with_capacity(4 * count),
            radii: Vec::new(),
        }
    }

    fn push(&mut self, number: u32, triangle: Triangle, part: &Piece) {
        self.parts.push((number, part.corners().len() as u8, part.cuts()));
        let offset = |p: &[f64; 3]| std::array::from_fn(|k| (p[k] - triangle[0][k]) as f32);
        self.offsets.extend(part.corners().iter().map(offset));
    }

    /// Calls `visit` with each triangle, and the corners and cuts of the part of it, if it is not whole.
    fn each(&self, mut visit: impl FnMut(u32, Option<(&[[f32; 3]], u8)>)) {
        self.whole.iter().for_each(|t| visit(*t, None));
        let mut rest = self.offsets.as_slice();
        for (t, count, cuts) in &self.parts {
            let (offsets, after) = rest.split_at(usize::from(*count));
            rest = after;
            visit(*t, Some((offsets, *cuts)));
        }
    }

    /// Makes triangles whole again, as `becomes` says of each part by its triangle.
    fn join(&mut self, mut becomes: impl FnMut(u32) -> Joined) {
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
enum Joined {
    /// It stays as it is.
    Part,
    /// It stands for its triangle, which is whole again.
    Whole,
    /// Another part stands for it.
    Gone,
}

/// A stored part of a triangle.
fn restored(triangle: Triangle, offsets: &[[f32; 3]], cuts: u8) -> Piece {
    let mut corners = [[0.0; 3]; CORNERS];
    for (corner, offset) in corners.iter_mut().zip(offsets) {
        *corner = std::array::from_fn(|k| triangle[0][k] + f64::from(offset[k]));
    }
    Piece::restored(&corners[..offsets.len()], cuts)
}

/// The largest coordinate that an offset within a triangle can have.
fn size([a, b, c]: Triangle) -> f64 {
    (0..3).fold(0.0, |size, k| (b[k] - a[k]).abs().max((c[k] - a[k]).abs()).max(size))
}

/// The largest coordinate of some triangles.
fn largest(triangles: &[Triangle]) -> f64 {
    let mut most = [0.0; 9];
    for triangle in triangles {
        // Nine at a time: none waits for the one before.
        for (most, x) in most.iter_mut().zip(triangle.as_flattened()) {
            *most = if x.abs() > *most { x.abs() } else { *most };
        }
    }
    most.into_iter().fold(0.0, f64::max)
}

/// A cluster that is being measured.
#[derive(Debug)]
pub struct Patch<'a> {
    /// Positions of its vertices.
    pub positions: Vec<[f32; 3]>,
    /// Corners as indices into `positions`.
    pub triangles: &'a [[u8; 3]],
}

/// The surface of an earlier round.
#[derive(Debug)]
pub struct Reference {
    positions: Arc<RoundPositions>,
    /// Its clusters, and the number of the first triangle of each.
    clusters: Vec<u32>,
    starts: Vec<u32>,
    /// The boxes of its clusters, once somebody has asked for them.
    boxes: OnceLock<Vec<Aabb>>,
    /// Number of its triangles.
    count: u32,
    /// The radius of each of their triangles; empty at the source.
    radii: Vec<f32>,
    /// In how many parts each of them is in the round that was begun last, or [`MANY`]; empty where all are whole.
    shares: Vec<u8>,
    /// It has served when so many triangles are left.
    least: f32,
    rounds: u32,
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
    /// The surface of a round's clusters, with the reference before.
    pub fn new(
        before: Option<&Self>,
        positions: Arc<RoundPositions>,
        pending: &[u32],
        all: &[BuildCluster],
    ) -> Self {
        let mut starts = Vec::with_capacity(pending.len());
        let mut count = 0;
        for c in pending {
            starts.push(count);
            count += all[*c as usize].mesh.triangles.len() as u32;
        }
        let (part, radii) = match before {
            None => (FIRST_PART, Vec::new()),
            Some(_) => (PART, pending.iter().flat_map(|c| radii(&all[*c as usize])).collect()),
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
            rounds: 0,
            is_last: false,
        }
    }

    /// Whether the round that was begun last was the last one to be measured against it.
    pub fn has_served(&self) -> bool {
        self.is_last
    }

    /// Begins a round that aims at so many triangles, with what its clusters correspond to.
    pub fn begin<'a>(&mut self, target: f32, pieces: impl Iterator<Item = &'a Pieces>) {
        self.rounds += 1;
        self.is_last = target < self.least || self.rounds == MOST_ROUNDS;
        self.shares.clear();
        for (t, ..) in pieces.flat_map(|pieces| &pieces.parts) {
            if self.shares.is_empty() {
                self.shares.resize(self.count as usize, 0);
            }
            let share = &mut self.shares[*t as usize];
            *share = share.saturating_add(1);
        }
    }

    /// Makes triangles whole again all of whose parts are here: what corresponds to each part corresponds to all of it.
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
            // Mostly that of the triangle before.
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

    /// What some clusters correspond to, laid out.
    pub fn correspondence<'a>(
        &'a self,
        mut pieces: Vec<Pieces>,
        all: &'a [BuildCluster],
    ) -> Correspondence<'a> {
        self.join(&mut pieces);
        let (local, numbers) = self.local(&pieces, all);
        Correspondence { before: local.sheet(), pieces, numbers, reference: self, all }
    }

    /// All clusters of it that come within some distance of a triangle, whoever corresponds to them; none where that is none.
    fn around(&self, triangle: Triangle, reach: f64, all: &[BuildCluster]) -> Option<Sheet> {
        // Not in parallel: a thread that waits for others here could take a part of a round that waits for this.
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
    // One that waited stands for itself as a whole.
    let rest = cluster.mesh.triangles.len() - own.len();
    own.iter().copied().chain(std::iter::repeat_n(cluster.bound, rest))
}

/// The part of a reference that a group stands on.
pub struct Correspondence<'a> {
    before: Sheet,
    pieces: Vec<Pieces>,
    /// The triangle of `before` of each piece.
    numbers: Vec<u32>,
    /// All of the reference, with all clusters.
    reference: &'a Reference,
    all: &'a [BuildCluster],
}

impl Correspondence<'_> {
    /// Its surface.
    pub fn surface(&self) -> &Sheet {
        &self.before
    }

    /// Samples of the surface, enough to fit so many triangles to it: the centres of triangles and parts, or those of
    /// edges where these are too few, with which means of what is quadratic on a triangle are exact.
    pub fn samples(&self, made: usize, visit: &mut dyn FnMut(Sample)) {
        let corners = |t: u32| self.before.triangles()[t as usize].map(DVec3::from_array);
        let normal = |t: u32| area_normal(corners(t));
        let normals: Vec<DVec3> = (0..self.before.triangles().len() as u32).map(normal).collect();
        let of_edges = self.numbers.len() < DENSE * made;
        let mut whole = Vec::new();
        if of_edges {
            whole.resize(normals.len(), false);
            let mut number = self.numbers.iter();
            self.pieces.iter().for_each(|pieces| {
                pieces.each(|_, part| {
                    number.next().into_iter().for_each(|n| whole[*n as usize] = part.is_none());
                })
            });
        }
        let mut number = self.numbers.iter();
        self.pieces.iter().for_each(|pieces| {
            pieces.each(|_, part| {
                let Some(&triangle) = number.next() else { return };
                let area = normals[triangle as usize];
                let weight = 0.5 * area.length();
                if let Some((offsets, cuts)) = part {
                    let piece = restored(self.before.triangles()[triangle as usize], offsets, cuts);
                    let point = DVec3::from_array(piece.center());
                    visit(Sample { point, normal: area, weight: 0.5 * piece.double_area(), triangle });
                    return;
                }
                let [a, b, c] = corners(triangle);
                if !of_edges {
                    visit(Sample { point: (a + b + c) / 3.0, normal: area, weight, triangle });
                    return;
                }
                let sides = [(a, b), (b, c), (c, a)];
                for ((p, q), next) in sides.into_iter().zip(self.before.neighbours(triangle)) {
                    let mut sample =
                        Sample { point: (p + q) / 2.0, normal: area, weight: weight / 3.0, triangle };
                    // One for both triangles of an edge.
                    if whole.get(next as usize) == Some(&true)
                        && self.before.neighbours(next).contains(&triangle)
                    {
                        if next < triangle {
                            continue;
                        }
                        let other = normals[next as usize];
                        sample.normal += other;
                        sample.weight += other.length() / 6.0;
                    }
                    visit(sample);
                }
            })
        });
    }

    /// A bound for patches that replace the clusters: how far any of their points may be from
    /// the source, and any point of the source that those clusters correspond to from them. Also hands the pieces over,
    /// or, where no further round of this reference will ask, the radii of the triangles.
    pub fn measure(self, patches: &[Patch<'_>], estimate: f32) -> (f32, Vec<Pieces>) {
        let Self { before, pieces, numbers, reference, all } = self;
        // A further round of this reference will ask.
        let keep = !reference.is_last;
        let (after, owners) = sheet_of(patches);
        let goal =
            BoundOptions { floor: f64::from(estimate) * FLOOR, slack: SLACK, ..BoundOptions::default() };
        let mut bounds = Bounds::new(goal);
        // Room for as many as there are on average: what is too much goes back.
        let mean = if keep { numbers.len() / patches.len().max(1) } else { 0 };
        let mut handed: Vec<Pieces> = patches.iter().map(|_| Pieces::with_room(mean)).collect();
        let mut radii = vec![0.0f64; after.triangles().len()];

        let mut to_after = Overlay::new(&after);
        let mut number = numbers.iter();
        let mut starts = vec![NO_TRIANGLE; after.triangles().len()];
        // Those of a cluster go as soon as they are handed over.
        for pieces in pieces {
            pieces.each(|t, part| {
                let Some(local) = number.next() else { return };
                let triangle = before.triangles()[*local as usize];
                let radius = before.radius(*local);
                let (piece, extra) = match part {
                    Some((offsets, cuts)) => {
                        (restored(triangle, offsets, cuts), radius + PART_ROUNDING * size(triangle))
                    }
                    None => (Piece::new(triangle), radius),
                };
                let owner = to_after.lay(&mut bounds, &piece, extra, |place, bound| {
                    let radius = &mut radii[place as usize];
                    *radius = radius.max(bound);
                    starts[place as usize] = *local;
                    owners[place as usize]
                });
                if !keep {
                    return;
                }
                match (owner, part) {
                    (Some(owner), None) => handed[owner as usize].whole.push(t),
                    (Some(owner), Some(_)) => handed[owner as usize].push(t, triangle, &piece),
                    (None, _) => {
                        to_after
                            .parts
                            .iter()
                            .for_each(|(p, owner)| handed[*owner as usize].push(t, triangle, p));
                    }
                }
            });
        }
        // Copies have no more room than they need. Giving back what was reserved too much would leave gaps of all sizes
        // between what stays, which later allocations search.
        let mut handed: Vec<Pieces> = handed.iter().map(Pieces::clone).collect();
        let mut largest_around = 0.0;
        let mut to_before = Overlay::new(&before);
        let laid = after.triangles().iter().zip(&mut radii).zip(starts);
        for (number, ((t, radius), start)) in (0..).zip(laid) {
            if start != NO_TRIANGLE {
                to_before.hint = start;
            }
            let known = bounds;
            let mut own = lay_whole(&mut to_before, &mut bounds, *t);
            // Over the border of the group others correspond to the reference, which is as near to it all the same.
            if bounds.lower > known.limit()
                && after.neighbours(number).contains(&NO_TRIANGLE)
                && let Some(around) = reference.around(*t, own, all)
            {
                largest_around = largest(around.triangles()).max(largest_around);
                let mut again = known;
                let other = lay_whole(&mut Overlay::new(&around), &mut again, *t);
                if other < own {
                    (own, bounds) = (other, again);
                }
            }
            *radius = radius.max(own);
        }
        let largest = largest(before.triangles()).max(largest(after.triangles())).max(largest_around);
        let stated = |upper: f64| round_up(outwards(upper, largest));
        if !keep {
            let mut radii = radii.into_iter().map(stated);
            for (pieces, patch) in handed.iter_mut().zip(patches) {
                pieces.radii = radii.by_ref().take(patch.triangles.len()).collect();
            }
        }
        (stated(bounds.upper), handed)
    }
}

/// Lays a triangle over a surface; the largest bound of its parts.
fn lay_whole(overlay: &mut Overlay<'_>, bounds: &mut Bounds, triangle: Triangle) -> f64 {
    let mut most = 0.0f64;
    overlay.lay(bounds, &Piece::new(triangle), 0.0, |_, bound| {
        most = most.max(bound);
        0
    });
    most
}

/// The sheet of all patches, and which of them each triangle belongs to.
fn sheet_of(patches: &[Patch<'_>]) -> (Sheet, Vec<u32>) {
    let positions: Vec<[f32; 3]> = patches.iter().flat_map(|p| &p.positions).copied().collect();
    let first_equal = hash::first_equal(bytemuck::cast_slice(&positions), 3);
    let count = patches.iter().map(|p| p.triangles.len()).sum();
    let (mut triangles, mut corners) = (Vec::with_capacity(count), Vec::with_capacity(count));
    let mut owners = Vec::with_capacity(count);
    let mut first = 0;
    for (i, patch) in patches.iter().enumerate() {
        for t in patch.triangles {
            let t = t.map(|v| first + usize::from(v));
            triangles.push(t.map(|v| positions[v].map(f64::from)));
            corners.push(t.map(|v| first_equal[v]));
            owners.push(i as u32);
        }
        first += patch.positions.len();
    }
    let radii = vec![0.0; triangles.len()];
    (Sheet::new(triangles, &corners, radii), owners)
}

impl<'a> Patch<'a> {
    /// A cluster with its positions.
    pub fn new(mesh: &'a ClusterMesh, position: impl Fn(u32) -> [f32; 3]) -> Self {
        Self { positions: mesh.vertices.iter().map(|v| position(*v)).collect(), triangles: &mesh.triangles }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: Triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    /// The halves of triangles, one of each in each of two clusters.
    fn halves(triangles: &[u32]) -> [Pieces; 2] {
        let (first, second) = Piece::new(TRIANGLE).halves();
        [first, second.unwrap()].map(|half| {
            let mut pieces = Pieces::default();
            triangles.iter().for_each(|t| pieces.push(*t, TRIANGLE, &half));
            pieces
        })
    }

    fn reference(count: u32, pieces: &[Pieces]) -> Reference {
        let positions = Arc::default();
        let mut reference = Reference {
            positions,
            clusters: Vec::new(),
            starts: Vec::new(),
            boxes: OnceLock::new(),
            count,
            radii: Vec::new(),
            shares: Vec::new(),
            least: 0.0,
            rounds: 0,
            is_last: false,
        };
        reference.begin(1.0, pieces.iter());
        reference
    }

    #[test]
    fn triangles_become_whole_where_all_parts_meet() {
        let [a, b] = halves(&[3, 5, 4]);
        // Of 5 a third part is elsewhere.
        let [elsewhere, _] = halves(&[5]);
        let all = [a, b, elsewhere];
        let reference = reference(6, &all);
        let [mut a, mut b, mut elsewhere] = all;
        let kept = a.offsets[usize::from(a.parts[0].1)..][..usize::from(a.parts[1].1)].to_vec();
        let mut group = [std::mem::take(&mut a), std::mem::take(&mut b)];
        reference.join(&mut group);
        assert_eq!(group[0].whole, [3, 4]);
        assert!(group[1].whole.is_empty());
        for pieces in &group {
            assert_eq!(pieces.parts.iter().map(|(t, ..)| *t).collect::<Vec<_>>(), [5]);
            assert_eq!(pieces.offsets.len(), usize::from(pieces.parts[0].1));
        }
        assert_eq!(group[0].offsets, kept);
        reference.join(std::slice::from_mut(&mut elsewhere));
        assert!(elsewhere.whole.is_empty() && elsewhere.parts.len() == 1);
    }

    #[test]
    fn triangles_in_too_many_parts_stay_cut() {
        let [mut many, _] = halves(&vec![0; usize::from(MANY) + 1]);
        let reference = reference(1, std::slice::from_ref(&many));
        reference.join(std::slice::from_mut(&mut many));
        assert!(many.whole.is_empty() && many.parts.len() == usize::from(MANY) + 1);
    }
}
