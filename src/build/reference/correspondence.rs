//! What a group's clusters correspond to in the reference, and how far simplified patches are from it.

use glam::DVec3;

use super::Reference;
use super::pieces::{Pieces, restored};
use crate::build::clusterize::ClusterMesh;
use crate::build::dag::BuildCluster;
use crate::build::relax::{Sample, area_normal};
use crate::math::sphere::round_up;
use crate::measure::closest::Triangle;
use crate::measure::overlay::{Bounds, NO_TRIANGLE, Overlay, Sheet};
use crate::measure::piece::Piece;
use crate::measure::{BoundOptions, outwards};
use crate::mesh::hash;

/// How far storing a part moves its corners, as a part of the size of its triangle: once a level but the last, by
/// up to √3 · 2⁻²⁴.
const PART_ROUNDING: f64 = 1.0 / (1u64 << 20) as f64;
/// With so many pieces for each new triangle, the centres of pieces are samples enough.
const DENSE: usize = 4;
/// A bound may be this part above the largest distance found.
const SLACK: f64 = 0.1;
/// Distances below this part of the simplifier's estimate are not distinguished: the largest is above it.
const FLOOR: f64 = 0.1;

/// A cluster that is being measured.
#[derive(Debug)]
pub struct Patch<'a> {
    /// Positions of its vertices.
    pub positions: Vec<[f32; 3]>,
    /// Corners as indices into `positions`.
    pub triangles: &'a [[u8; 3]],
}

impl<'a> Patch<'a> {
    /// A cluster with its positions.
    pub fn new(mesh: &'a ClusterMesh, position: impl Fn(u32) -> [f32; 3]) -> Self {
        Self { positions: mesh.vertices.iter().map(|v| position(*v)).collect(), triangles: &mesh.triangles }
    }
}

/// The reference patch of a group.
pub struct Correspondence<'a> {
    before: Sheet,
    pieces: Vec<Pieces>,
    /// The triangle of `before` of each piece.
    numbers: Vec<u32>,
    /// All of the reference, with all clusters.
    reference: &'a Reference,
    all: &'a [BuildCluster],
}

impl Reference {
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
}

impl Correspondence<'_> {
    /// Its surface.
    pub fn surface(&self) -> &Sheet {
        &self.before
    }

    /// Samples of the surface, enough to fit `made` triangles to it: the centres of triangles and parts, or the
    /// midpoints of edges where centres are too few. Midpoints integrate quadratic functions on a triangle exactly.
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

    /// A bound for patches that replace the clusters: the two-sided distance of the patches and the part of the
    /// source that the clusters correspond to. Also returns the pieces of each patch, or the radii of its triangles
    /// where this level is the reference's last.
    pub fn measure(self, patches: &[Patch<'_>], estimate: f32) -> (f32, Vec<Pieces>) {
        let Self { before, pieces, numbers, reference, all } = self;
        // A further level of this reference needs the pieces.
        let keep = !reference.is_last;
        let (after, owners) = sheet_of(patches);
        let goal =
            BoundOptions { floor: f64::from(estimate) * FLOOR, slack: SLACK, ..BoundOptions::default() };
        let mut bounds = Bounds::new(goal);
        // Room for the average number; copies below drop the excess.
        let mean = if keep { numbers.len() / patches.len().max(1) } else { 0 };
        let mut handed: Vec<Pieces> = patches.iter().map(|_| Pieces::with_room(mean)).collect();
        let mut radii = vec![0.0f64; after.triangles().len()];

        let mut to_after = Overlay::new(&after);
        let mut number = numbers.iter();
        let mut starts = vec![NO_TRIANGLE; after.triangles().len()];
        // Frees the pieces of a cluster as soon as they are handed over.
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
        // Copies have no excess room. Shrinking in place would leave gaps of all sizes in the heap, which later
        // allocations search.
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
            // Beyond the border of the group other clusters correspond to the reference: it is as near all the
            // same.
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
