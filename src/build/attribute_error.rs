//! How far what a surface carries changes in a step of simplification, as a length: a bound for every point of both
//! surfaces.
//!
//! An attribute that deviates by one unit counts as its weight times an edge length, since what is wrong at a point is
//! wrong over about an edge: the mean one of the group's input, or that of the triangle compared with, if that is
//! longer. No attribute counts more than one unit; another material is one. Two points are compared if they are no
//! farther apart than the shape is off, and what they are farther apart counts as deviation: so a seam, or a line
//! between colours, is off by how far it moved and not by how much it divides. Along the DAG steps add up.
//!
//! As distances are, deviations are bounded over pieces of a triangle that lie over a single triangle of the other
//! surface. The proof stands in docs/numerics.md.

use super::collapse::wedges::nearest;
use super::content::Content;
use super::simplify::mean_edge;
use super::store::LocalMesh;
use crate::math::sphere::round_up;
use crate::math::triangle::{area, edge_of_area};
use crate::measure::BoundOptions;
use crate::measure::closest::Vec3;
use crate::measure::overlay::{BESIDE, Bounds, Lay, NO_TRIANGLE, Sheet};
use crate::measure::piece::{CORNERS, Corner, MOST_CUTS, Piece};
use crate::mesh::{Stars, hash};

/// A bound may be this part above the largest deviation found.
const SLACK: f64 = 0.1;
/// Deviations below this part of an edge are not told apart.
const FLOOR: f64 = 1.0e-4;
/// Parts of a triangle that are halved at most.
const TRIES: u32 = 32;
/// Rounding, many times over, of shares of corners and of what they weigh, relative to the largest: docs/numerics.md.
const ROUNDING: f64 = 1.0 / (1u64 << 40) as f64;

/// Barycentric coordinates.
type Shares = [f64; 3];

/// A bound of the deviation of `after`, made from `before`, in the unit of the positions: each point of either has one
/// of the other, no farther off than `free` and the bound together, at which no attribute deviates more.
pub fn step_deviation(before: &LocalMesh, after: &LocalMesh, content: &Content, free: f32) -> f32 {
    deviation_above(before, after, content, free, 0.0)
}

/// The same where deviations up to `enough` need not be told apart.
pub fn deviation_above(
    before: &LocalMesh,
    after: &LocalMesh,
    content: &Content,
    free: f32,
    enough: f32,
) -> f32 {
    let edge = f64::from(mean_edge(before));
    let sides = [before, after].map(|mesh| Side::new(mesh, content, |area| edge.max(edge_of_area(area))));
    deviation_between(before, sides, content, free, (FLOOR * edge).max(enough.into()))
}

/// The same where a deviation of one unit counts `unit` everywhere, whatever the size of triangles.
pub fn deviation_in(before: &LocalMesh, after: &LocalMesh, content: &Content, free: f32, unit: f64) -> f32 {
    let sides = [before, after].map(|mesh| Side::new(mesh, content, |_| unit));
    deviation_between(before, sides, content, free, FLOOR * unit)
}

fn deviation_between(
    before: &LocalMesh,
    sides: [Side<'_>; 2],
    content: &Content,
    free: f32,
    floor: f64,
) -> f32 {
    let differ = |values: &[u32]| values.windows(2).any(|pair| pair[0] != pair[1]);
    let labels = differ(&before.labels) && content.label_weight > 0.0;
    let materials = differ(&before.materials);
    if !(content.is_measured() || labels || materials) {
        return 0.0;
    }
    let goal = BoundOptions { floor, slack: SLACK, ..BoundOptions::default() };
    let mut found = Bounds::new(goal);
    let mut starts = vec![NO_TRIANGLE; sides[1].corners.len()];
    for (from, onto) in [(&sides[0], &sides[1]), (&sides[1], &sides[0])] {
        let mut laid_on = vec![NO_TRIANGLE; onto.corners.len()];
        let mut hint = 0;
        for (t, corners) in from.corners.iter().enumerate() {
            let mut laying = Laying {
                onto,
                content,
                free: free.into(),
                found,
                rows: from.rows(t as u32),
                label: None,
                material: materials.then(|| from.mesh.materials[corners[0] as usize]),
                tries: TRIES,
                last: hint,
            };
            if std::ptr::eq(onto, &sides[0]) && starts[t] != NO_TRIANGLE {
                laying.last = starts[t];
            }
            let mut lay = |label: Option<u32>, region: &[Shares]| {
                laying.label = label;
                let triangle = from.sheet.triangles()[t];
                let corners = region.iter().map(|at| Spot { position: mix(*at, triangle), at: *at });
                let mut spots = [Spot::default(); CORNERS];
                spots.iter_mut().zip(corners).for_each(|(spot, corner)| *spot = corner);
                let piece = Piece::restored(&spots[..region.len()], 0);
                let start = onto.sheet.locate(piece.center(), laying.last);
                onto.sheet.spread(&mut laying, &piece, start, 0);
            };
            if labels {
                let labels = corners.map(|v| from.mesh.labels[v as usize]);
                for (k, label) in labels.iter().enumerate() {
                    if !labels[..k].contains(label) {
                        let (region, count) = region_of(*label, labels);
                        lay(Some(*label), &region[..count]);
                    }
                }
            } else {
                lay(None, &CORNER);
            }
            found = laying.found;
            hint = laying.last;
            laid_on[hint as usize] = t as u32;
        }
        starts = laid_on;
    }
    let largest = sides.iter().flat_map(|side| side.sheet.triangles()).flatten().flatten();
    let largest = largest.fold(0.0f64, |most, x| most.max(x.abs()));
    let longest = sides.iter().flat_map(|side| &side.edges).fold(0.0f64, |most, x| most.max(*x));
    let values = sides.iter().map(|side| content.largest(&side.mesh.attributes)).fold(0.0, f64::max);
    round_up(found.upper * (1.0 + ROUNDING) + ROUNDING * (largest + longest * values))
}

/// The corners of a triangle.
const CORNER: [Shares; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// A mean.
fn mix(at: Shares, [a, b, c]: [Vec3; 3]) -> Vec3 {
    std::array::from_fn(|k| at[0] * a[k] + at[1] * b[k] + at[2] * c[k])
}

/// The convex part of a triangle that has a label, and its number of corners: what is nearest to the corners that have it by barycentric
/// coordinates, those of equal labels added.
fn region_of(label: u32, labels: [u32; 3]) -> ([Shares; 4], usize) {
    let middle =
        |i: usize, j: usize| -> Shares { std::array::from_fn(|k| (CORNER[i][k] + CORNER[j][k]) / 2.0) };
    let has = labels.map(|other| other == label);
    let mut out = [[0.0; 3]; 4];
    let mut count = 0;
    let mut push = |at: Shares| {
        out[count] = at;
        count += 1;
    };
    for i in 0..3 {
        let next = (i + 1) % 3;
        if has[i] {
            push(CORNER[i]);
        }
        if has[i] != has[next] {
            push(middle(i, next));
        } else if !has[i] && labels[i] != labels[next] {
            push([1.0 / 3.0; 3]);
        }
    }
    (out, count)
}

/// A corner of a piece, as a place on the triangle that it is of.
#[derive(Clone, Copy, Debug, Default)]
struct Spot {
    position: Vec3,
    at: Shares,
}

impl Corner for Spot {
    fn position(&self) -> Vec3 {
        self.position
    }

    fn towards(&self, other: &Self, t: f64) -> Self {
        Self { position: self.position.towards(&other.position, t), at: self.at.towards(&other.at, t) }
    }
}

/// One of the two surfaces.
struct Side<'a> {
    mesh: &'a LocalMesh,
    stride: usize,
    corners: Vec<[u32; 3]>,
    sheet: Sheet,
    /// What a deviation of one unit from a triangle counts.
    edges: Vec<f64>,
    /// The first vertex at the position of each, and the triangles around those.
    positions: Vec<u32>,
    stars: Stars,
}

impl<'a> Side<'a> {
    /// `unit` says what a deviation of one unit from a triangle of an area counts.
    fn new(mesh: &'a LocalMesh, content: &Content, unit: impl Fn(f64) -> f64) -> Self {
        let corners: Vec<[u32; 3]> = mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        // By where vertices are now: a simplifier may have brought together what lay apart.
        let positions = hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3);
        let points: Vec<[u32; 3]> = corners.iter().map(|t| t.map(|v| positions[v as usize])).collect();
        let places = |t: &[u32; 3]| t.map(|v| mesh.positions[v as usize]);
        let triangles = corners.iter().map(|t| places(t).map(|p| p.map(f64::from))).collect();
        Self {
            mesh,
            stride: content.stride(),
            sheet: Sheet::new(triangles, &points, vec![0.0; corners.len()]),
            edges: corners.iter().map(|t| unit(area(places(t)))).collect(),
            stars: Stars::new(mesh.positions.len(), points.as_flattened()),
            positions,
            corners,
        }
    }

    fn rows(&self, t: u32) -> [&'a [f32]; 3] {
        self.corners[t as usize].map(|v| &self.mesh.attributes[v as usize * self.stride..][..self.stride])
    }

    /// The triangles around the corners of one.
    fn around(&self, t: u32) -> impl Iterator<Item = u32> {
        let stars = self.corners[t as usize].map(|v| self.stars.of(self.positions[v as usize] as usize));
        stars.into_iter().flatten().map(|(t, _)| t as u32)
    }
}

/// A triangle that is being laid.
struct Laying<'a> {
    onto: &'a Side<'a>,
    content: &'a Content,
    /// Distance that does not count.
    free: f64,
    /// Of the deviations.
    found: Bounds,
    /// What its corners carry.
    rows: [&'a [f32]; 3],
    /// The label of the part that is being laid, where labels differ.
    label: Option<u32>,
    material: Option<u32>,
    tries: u32,
    /// The triangle that took the last part.
    last: u32,
}

impl Laying<'_> {
    fn take(&mut self, bound: f64, at: u32) {
        self.found.upper = self.found.upper.max(bound);
        self.last = at;
    }

    /// A bound of the deviation of a part from a triangle; infinite if it is above `enough`. Each corner is compared
    /// with the point `place` gives, what lies between with what lies between those.
    fn bound(&self, part: &[Spot], t: u32, enough: f64, place: impl Fn(Vec3) -> (Shares, f64)) -> f64 {
        let mut pairs = [([0.0; 3], [0.0; 3]); CORNERS];
        let mut most = 0.0f64;
        for (pair, spot) in pairs.iter_mut().zip(part) {
            let (at, squared) = place(spot.position);
            if squared.is_nan() {
                return f64::INFINITY;
            }
            most = most.max(squared);
            *pair = (spot.at, at);
        }
        let beyond = most.sqrt() - self.free;
        if beyond > enough {
            return f64::INFINITY;
        }
        let scale = self.onto.edges[t as usize];
        let deviation = self.content.deviation_bound(self.rows, self.onto.rows(t), &pairs[..part.len()]);
        beyond.max(scale * deviation)
    }

    /// A bound of the deviation of a part from a triangle, with what is not linear: its material and its label.
    /// `roughly`: compared with points that are the nearest only for what lies over the triangle.
    fn deviation(&self, part: &[Spot], t: u32, enough: f64, roughly: bool) -> f64 {
        let onto = self.onto;
        let corners = onto.corners[t as usize];
        let scale = onto.edges[t as usize];
        let other = |material: u32| onto.mesh.materials[corners[0] as usize] != material;
        let of_material = if self.material.is_some_and(other) { scale } else { 0.0 };
        let near = |p: Vec3| {
            if roughly {
                let (at, rest) = onto.sheet.place(p, t);
                (at, rest.iter().map(|x| x * x).sum())
            } else {
                place_in(p, onto.sheet.triangles()[t as usize], &CORNER)
            }
        };
        let Some(label) = self.label else {
            return self.bound(part, t, enough, near).max(of_material);
        };
        let labels = corners.map(|v| onto.mesh.labels[v as usize]);
        if labels == [label; 3] {
            return self.bound(part, t, enough, near).max(of_material);
        }
        let wrong = scale * f64::from(self.content.label_weight);
        let mut least = self.bound(part, t, enough, near).max(wrong);
        if labels.contains(&label) {
            let (region, count) = region_of(label, labels);
            let triangle = onto.sheet.triangles()[t as usize];
            let right = |p: Vec3| place_in(p, triangle, &region[..count]);
            least = least.min(self.bound(part, t, enough.min(least), right));
        }
        least.max(of_material)
    }
}

/// The point nearest to `p` of a convex part of a triangle, up to rounding: its barycentric coordinates, and the squared distance to it.
fn place_in(p: Vec3, triangle: [Vec3; 3], part: &[Shares]) -> (Shares, f64) {
    let mut best = (part[0], f64::INFINITY);
    for k in 2..part.len() {
        let fan = [part[0], part[k - 1], part[k]];
        let points = fan.map(|at| mix(at, triangle));
        let shares = nearest(p.into(), points.map(Into::into));
        let at = mix(shares, fan);
        let q = mix(at, triangle);
        let squared = (0..3).map(|axis| (p[axis] - q[axis]).powi(2)).sum();
        if squared < best.1 {
            best = (at, squared);
        }
    }
    if best.1.is_infinite() {
        let q = mix(part[0], triangle);
        best.1 = (0..3).map(|axis| (p[axis] - q[axis]).powi(2)).sum();
    }
    best
}

impl Lay<Spot> for Laying<'_> {
    type Said = ();

    fn accept(&mut self, part: &Piece<Spot>, at: u32) -> Option<()> {
        let limit = self.found.limit();
        let bound = self.deviation(part.corners(), at, limit, true);
        (bound <= limit).then(|| self.take(bound, at))
    }

    fn beside(&self) -> f64 {
        (self.found.limit() + self.free) * BESIDE
    }

    /// Perhaps another triangle nearby fits better, perhaps that is what it deviates.
    fn bring(&mut self, part: &Piece<Spot>, at: u32) {
        let onto = self.onto;
        let point = |spot: &Spot, t: u32| self.deviation(&[*spot], t, f64::INFINITY, false);
        let corners = part.corners();
        let (worst, _) = corners.iter().fold((corners[0], -1.0), |worst, spot| {
            let deviation = point(spot, at);
            if deviation > worst.1 { (*spot, deviation) } else { worst }
        });
        let near = onto.sheet.nearest(worst.position, at);
        let mut best = (f64::INFINITY, at);
        let mut of_point = f64::INFINITY;
        for t in [at, near].into_iter().chain(onto.around(at)).chain(onto.around(near)) {
            of_point = of_point.min(self.deviation(&[worst], t, of_point, false));
            let bound = self.deviation(corners, t, best.0, false);
            if bound < best.0 {
                best = (bound, t);
            }
            if best.0 <= self.found.limit() {
                return self.take(best.0, best.1);
            }
        }
        self.found.lower = self.found.lower.max(of_point);
        if best.0 <= self.found.limit() || self.tries == 0 || part.cuts() >= MOST_CUTS {
            return self.take(best.0, best.1);
        }
        self.tries -= 1;
        let (first, second) = part.halves();
        for half in [Some(first), second].into_iter().flatten() {
            onto.sheet.spread(self, &half, onto.sheet.nearest(half.center(), best.1), 0);
        }
    }

    fn join(&mut self, _: (&Piece<Spot>, ()), _: (&Piece<Spot>, ())) {}
}

#[cfg(test)]
mod tests;
