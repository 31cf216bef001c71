//! Relaxing a simplified mesh: its vertices move to where their triangles fit the reference best, by least squares.
//! A sequence of collapses cannot do that, since each of them sees the faces around its edge alone.
//!
//! Points of the reference are each sent to the triangle they lie over, and their distances from its plane made as
//! small as they can be (point to plane, as in Chen and Medioni 1992; a fit of the whole surface as in Hoppe et al.,
//! "Mesh Optimization", 1993). A triangle needs no list of its points: what they want of its corners is a matrix and a
//! vector. The equations are solved vertex by vertex (Gauss–Seidel).

use glam::{DMat3, DVec3};

use super::store::LocalMesh;
use crate::math::{Aabb, morton};
use crate::measure::closest::Triangle;
use crate::measure::overlay::{NO_TRIANGLE, Sheet};
use crate::mesh::{Stars, hash};

/// A reference with so many times the triangles needs one sample for each of its triangles.
const FINE: usize = 4;
/// Passes over all vertices.
const SWEEPS: usize = 4;
/// Weight of the vertex's own place, against that of the samples around: decides where they do not.
const HOLD: f64 = 0.01;
/// No vertex moves farther than so many root mean square distances of the points around it.
const REACH: f64 = 4.0;
/// Distances below this part of the size of the triangles around a vertex are rounding.
const EVEN: f64 = 1.0e-6;
/// Cosine of the angle between a point's normal and a triangle's below which they belong to different sheets.
const OTHER_SHEET: f64 = 0.3;
/// Squared distance from a triangle, against twice its area, from which on a point is looked up anew.
const FAR: f64 = 0.25;
/// Squared distance from the reference, against that of the farthest sample, up to which a vertex may go: what fits
/// best has its vertices about half as far outside as its faces are inside.
const OUTSIDE: f64 = 0.5;
/// Cosine of the largest turn of a face.
const TURN: f64 = 0.7;
/// Times that vertices of faces that turned farther are put back before all are.
const RETRIES: usize = 3;

/// A point of the surface to fit.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Where it is.
    pub point: DVec3,
    /// The normal there, of any length.
    pub normal: DVec3,
    /// The area it stands for.
    pub weight: f64,
    /// The triangle of the surface that it is on.
    pub triangle: u32,
}

/// What the points over a triangle want of its corners: moves δ along its normal n leave Σ w (r − Σ share · n·δ)².
#[derive(Clone, Copy, Debug, Default)]
struct Fit {
    normal: DVec3,
    /// Twice its area.
    area: f64,
    /// Σ w · share · share, of corners 00, 11, 22, 01, 12, 20.
    gram: [f64; 6],
    /// Σ w · share · r.
    pull: [f64; 3],
    /// Σ w · share · r².
    spread: [f64; 3],
    /// Σ w · share.
    weight: [f64; 3],
}

impl Fit {
    fn new(area_normal: DVec3) -> Self {
        Self { normal: area_normal.normalize_or_zero(), area: area_normal.length(), ..Self::default() }
    }

    fn add(&mut self, shares: [f64; 3], rest: f64, weight: f64) {
        let [a, b, c] = shares;
        let products = [a * a, b * b, c * c, a * b, b * c, c * a];
        self.gram.iter_mut().zip(products).for_each(|(sum, x)| *sum += weight * x);
        for (k, share) in shares.into_iter().enumerate() {
            self.weight[k] += weight * share;
            self.pull[k] += weight * share * rest;
            self.spread[k] += weight * share * rest * rest;
        }
    }

    /// What is left of the pull at a corner after moves of all along the normal.
    fn left(&self, k: usize, moves: [f64; 3]) -> f64 {
        let (next, last) = ((k + 1) % 3, (k + 2) % 3);
        let gram = [self.gram[k], self.gram[3 + k], self.gram[3 + last]];
        self.pull[k] - gram[0] * moves[k] - gram[1] * moves[next] - gram[2] * moves[last]
    }
}

/// A vertex that may move.
struct Free {
    vertex: usize,
    /// Of what moving it costs.
    inverse: DMat3,
    hold: f64,
    reach: f64,
}

impl Free {
    /// `None` where all points lie on the surface as it is.
    fn new(vertex: usize, fits: &[Fit], stars: &Stars) -> Option<Self> {
        let (mut matrix, mut stiffness, mut spread, mut weight) = (DMat3::ZERO, 0.0, 0.0, 0.0);
        for (t, k) in stars.of(vertex) {
            let Fit { normal: n, gram, .. } = fits[t];
            matrix += DMat3::from_cols(n * n.x, n * n.y, n * n.z) * gram[k];
            stiffness += gram[k];
            spread += fits[t].spread[k];
            weight += fits[t].weight[k];
        }
        let hold = HOLD * stiffness;
        let inverse = (matrix + DMat3::from_diagonal(DVec3::splat(hold))).inverse();
        let moves = spread > EVEN * EVEN * weight * weight && inverse.is_finite();
        moves.then(|| Self { vertex, inverse, hold, reach: REACH * (spread / weight).sqrt() })
    }
}

/// Normal of a triangle, as long as twice its area.
pub(super) fn area_normal(corners: [DVec3; 3]) -> DVec3 {
    let [a, b, c] = corners;
    (b - a).cross(c - a)
}

/// Moves the vertices of `mesh` that are not locked towards `samples` of `reference`, the surface it stands for. These come in an order
/// in which neighbours are near each other. Attributes stay as they are, and so does what fits already. No vertex ends about as
/// far off as the farthest sample was, unless it was so before. Points that were apart stay apart. Samples farther than
/// `reach` are of what is there no more, or of another sheet. Faces go on facing `up` where they do.
pub fn relax(
    mesh: &mut LocalMesh,
    reference: &Sheet,
    reach: f64,
    up: Option<DVec3>,
    samples: impl FnOnce(&mut dyn FnMut(Sample)),
) {
    let first = hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3);
    let corners: Vec<u32> = mesh.indices.iter().map(|v| first[*v as usize]).collect();
    let triangles: &[[u32; 3]] = bytemuck::cast_slice(&corners);
    let start: Vec<DVec3> = mesh.positions.iter().map(|p| DVec3::from_array(p.map(f64::from))).collect();
    let place = |t: [u32; 3], points: &[DVec3]| t.map(|v| points[v as usize]);
    let sheet = Sheet::new(
        triangles.iter().map(|t| place(*t, &start).map(|p| p.to_array())).collect(),
        triangles,
        vec![0.0; triangles.len()],
    );
    let mut fits: Vec<Fit> = triangles.iter().map(|t| Fit::new(area_normal(place(*t, &start)))).collect();

    // Some triangle of the reference that lies over each.
    let mut under = vec![NO_TRIANGLE; triangles.len()];
    let mut farthest = 0.0f64;
    let mut hint = 0;
    samples(&mut |Sample { point, normal, weight, triangle }| {
        let mut take = |t: u32, far: f64| {
            let fit = &mut fits[t as usize];
            let (shares, rest) = sheet.place(point.to_array(), t);
            let rest = DVec3::from_array(rest);
            let squared = rest.length_squared();
            let over = fit.normal.dot(normal) > OTHER_SHEET * normal.length() && squared <= far * fit.area;
            if over && squared <= reach * reach {
                farthest = farthest.max(squared);
                fit.add(shares, fit.normal.dot(rest), weight);
                under[t as usize] = triangle;
            }
            over
        };
        hint = sheet.locate(point.to_array(), hint);
        if !take(hint, FAR) {
            // It went astray, or there is nothing near.
            hint = sheet.nearest(point.to_array(), hint);
            take(hint, f64::INFINITY);
        }
    });

    let mut free = vec![false; start.len()];
    corners.iter().for_each(|v| free[*v as usize] = true);
    let locked = mesh.locked.iter().zip(&first).filter(|(locked, _)| **locked);
    locked.for_each(|(_, v)| free[*v as usize] = false);
    let stars = Stars::new(start.len(), &corners);
    let free: Vec<Free> =
        (0..start.len()).filter(|v| free[*v]).filter_map(|v| Free::new(v, &fits, &stars)).collect();
    let mut moves = vec![DVec3::ZERO; start.len()];
    for _ in 0..SWEEPS {
        for Free { vertex, inverse, hold, reach } in &free {
            let mut pull = -moves[*vertex] * *hold;
            for (t, k) in stars.of(*vertex) {
                let fit = &fits[t];
                pull += fit.normal * fit.left(k, place(triangles[t], &moves).map(|m| fit.normal.dot(m)));
            }
            moves[*vertex] = (moves[*vertex] + *inverse * pull).clamp_length_max(*reach);
        }
    }
    let mut points: Vec<DVec3> = start.iter().zip(&moves).map(|(p, m)| *p + *m).collect();

    // What made something worse goes back.
    let most = OUTSIDE * farthest;
    let near = |v: usize| stars.of(v).map(|(t, _)| under[t]).find(|t| *t != NO_TRIANGLE).unwrap_or(0);
    let off = |p: DVec3, near: u32| {
        let t = reference.locate(p.to_array(), near);
        let squared = |t| DVec3::from_array(reference.place(p.to_array(), t).1).length_squared();
        let d = squared(t);
        if d <= most { d } else { squared(reference.nearest(p.to_array(), t)) }
    };
    for Free { vertex, .. } in &free {
        let (vertex, near) = (*vertex, near(*vertex));
        let d = off(points[vertex], near);
        if d > most && d > off(start[vertex], near) {
            points[vertex] = start[vertex];
        }
    }
    for retry in 0..=RETRIES {
        let turned = |(t, fit): (&[u32; 3], &Fit)| {
            let normal = area_normal(place(*t, &points));
            let faces = |n: DVec3| up.is_none_or(|up| n.dot(up) > 0.0);
            let holds =
                normal.dot(fit.normal) >= TURN * normal.length() && (faces(normal) || !faces(fit.normal));
            (!holds).then_some(*t)
        };
        let back: Vec<[u32; 3]> = triangles.iter().zip(&fits).filter_map(turned).collect();
        if back.is_empty() {
            break;
        }
        if retry == RETRIES {
            return;
        }
        back.iter().flatten().for_each(|v| points[*v as usize] = start[*v as usize]);
    }
    let placed = |(position, v): (&[f32; 3], &u32)| {
        let v = *v as usize;
        if points[v] == start[v] { *position } else { points[v].to_array().map(|x| x as f32) }
    };
    let positions: Vec<[f32; 3]> = mesh.positions.iter().zip(&first).map(placed).collect();
    // Where features are as small as the rounding of places, points may meet.
    if hash::first_equal(bytemuck::cast_slice(&positions), 3) == first {
        mesh.positions = positions;
    }
}

/// Moves what is not locked of a mesh to where it fits the surface of another one best: see [`relax`].
pub fn fit(mesh: &mut LocalMesh, reference: &LocalMesh, reach: f64, up: Option<DVec3>) {
    let reference = sheet(reference, Vec::new());
    // Neighbours one after the other, whatever the order of the triangles is.
    let bounds = Aabb::of_points(&mesh.positions);
    let code = |t: &Triangle| morton::code(t[0].map(|x| x as f32), &bounds);
    let mut order: Vec<(u64, u32)> = reference.triangles().iter().map(code).zip(0..).collect();
    order.sort_unstable();
    let is_fine = reference.triangles().len() >= FINE * mesh.indices.len() / 3;
    relax(mesh, &reference, reach, up, |visit| {
        for (_, triangle) in order {
            let [a, b, c] = reference.triangles()[triangle as usize].map(DVec3::from_array);
            let normal = (b - a).cross(c - a);
            let weight = 0.5 * normal.length();
            if is_fine {
                visit(Sample { point: (a + b + c) / 3.0, normal, weight, triangle });
                continue;
            }
            for point in [a + b, b + c, c + a].map(|sum| 0.5 * sum) {
                visit(Sample { point, normal, weight: weight / 3.0, triangle });
            }
        }
    });
}

/// The triangles of a mesh, each of which stands for something within its radius; without radii, for itself.
pub fn sheet(mesh: &LocalMesh, radii: Vec<f64>) -> Sheet {
    let points = hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3);
    let faces: &[[u32; 3]] = bytemuck::cast_slice(&mesh.indices);
    let place = |v: u32| mesh.positions[v as usize].map(f64::from);
    let triangles = faces.iter().map(|t| t.map(place)).collect();
    let numbers: Vec<[u32; 3]> = faces.iter().map(|t| t.map(|v| points[v as usize])).collect();
    let radii = if radii.is_empty() { vec![0.0; faces.len()] } else { radii };
    Sheet::new(triangles, &numbers, radii)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of `n` × `n` squares over the unit square at the heights of `z`, each cut along a diagonal.
    fn grid(n: usize, z: impl Fn(f64, f64) -> f64) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let at = |i: usize| i as f64 / n as f64;
        let row = |j: usize| (0..=n).map(move |i| (at(i), at(j)));
        let points = (0..=n).flat_map(row).map(|(x, y)| [x, y, z(x, y)].map(|c| c as f32)).collect();
        let square = |k: usize| {
            let a = (k / n * (n + 1) + k % n) as u32;
            let b = a + n as u32 + 1;
            [[a, a + 1, b + 1], [a, b + 1, b]]
        };
        (points, (0..n * n).flat_map(square).collect())
    }

    fn local(points: Vec<[f32; 3]>, faces: &[[u32; 3]]) -> LocalMesh {
        LocalMesh {
            locked: vec![false; points.len()],
            positions: points,
            indices: faces.as_flattened().to_vec(),
            ..LocalMesh::default()
        }
    }

    /// Relaxes a mesh against a surface, sampled at the centres of its triangles.
    fn relax_to(mesh: &mut LocalMesh, points: &[[f32; 3]], faces: &[[u32; 3]]) {
        let corners = |t: &[u32; 3]| t.map(|v| points[v as usize].map(f64::from));
        let sheet = Sheet::new(faces.iter().map(corners).collect(), faces, vec![0.0; faces.len()]);
        relax(mesh, &sheet, f64::INFINITY, None, |visit| {
            for (t, triangle) in faces.iter().zip(0..) {
                let [a, b, c] = corners(t).map(DVec3::from_array);
                let normal = area_normal([a, b, c]);
                visit(Sample { point: (a + b + c) / 3.0, normal, weight: 0.5 * normal.length(), triangle });
            }
        });
    }

    fn bowl(x: f64, y: f64) -> f64 {
        (x - 0.5).powi(2) + 0.5 * (y - 0.5).powi(2)
    }

    /// Mean squared height of the bowl over a mesh.
    fn misfit(mesh: &LocalMesh) -> f64 {
        let mut squares = Vec::new();
        for t in mesh.indices.chunks_exact(3) {
            let p = [0, 1, 2].map(|k| DVec3::from_array(mesh.positions[t[k] as usize].map(f64::from)));
            for [u, v] in [[0.2, 0.2], [0.6, 0.2], [0.2, 0.6], [0.33, 0.33]] {
                let q = p[0] * (1.0 - u - v) + p[1] * u + p[2] * v;
                squares.push((q.z - bowl(q.x, q.y)).powi(2));
            }
        }
        squares.iter().sum::<f64>() / squares.len() as f64
    }

    #[test]
    fn a_coarse_surface_comes_nearer_to_a_curved_one() {
        let (fine, faces) = grid(40, bowl);
        let (coarse, triangles) = grid(8, bowl);
        let mut mesh = local(coarse, &triangles);
        let before = misfit(&mesh);
        relax_to(&mut mesh, &fine, &faces);
        // Corners on a paraboloid leave six times the mean square that the best fit does.
        let after = misfit(&mesh);
        assert!(after < 0.4 * before, "{after} of {before}");
    }

    #[test]
    fn what_is_locked_stays_and_seams_stay_closed() {
        let (fine, faces) = grid(40, bowl);
        let (coarse, triangles) = grid(8, bowl);
        let mut mesh = local(coarse.clone(), &triangles);
        // A second vertex at the place of one, used by some of its triangles.
        let (seam, twin) = (30, mesh.positions.len() as u32);
        mesh.positions.push(coarse[seam as usize]);
        mesh.locked.push(false);
        let mut uses: Vec<_> = mesh.indices.iter_mut().filter(|v| **v == seam).collect();
        uses.iter_mut().step_by(2).for_each(|v| **v = twin);
        mesh.locked[68] = true;
        relax_to(&mut mesh, &fine, &faces);
        assert_eq!(mesh.positions[68], coarse[68]);
        assert_eq!(mesh.positions[seam as usize], mesh.positions[twin as usize]);
        assert_ne!(mesh.positions[seam as usize], coarse[seam as usize]);
    }

    #[test]
    fn what_fits_keeps_its_bits() {
        let (fine, faces) = grid(40, |x, y| 0.3 * x - 0.7 * y);
        let (coarse, triangles) = grid(8, |x, y| 0.3 * x - 0.7 * y);
        let mut mesh = local(coarse.clone(), &triangles);
        relax_to(&mut mesh, &fine, &faces);
        assert_eq!(mesh.positions, coarse);
    }

    #[test]
    fn another_sheet_and_nonsense_change_nothing() {
        let (coarse, triangles) = grid(4, |_, _| 0.0);
        // The same surface seen from behind, a little below.
        let (below, faces) = grid(16, |_, _| -0.01);
        let behind: Vec<[u32; 3]> = faces.iter().map(|t| [t[0], t[2], t[1]]).collect();
        let mut mesh = local(coarse.clone(), &triangles);
        relax_to(&mut mesh, &below, &behind);
        assert_eq!(mesh.positions, coarse);
        // Triangles without area.
        let flat = vec![[0.5f32, 0.5, 0.0]; coarse.len()];
        let mut mesh = local(flat.clone(), &triangles);
        relax_to(&mut mesh, &below, &faces);
        assert_eq!(mesh.positions, flat);
    }
}
