//! The distance between two meshes, sampled or bounded, and nearest points of a mesh: the core of
//! `nanite_rs.measure`.
//!
//! Everything is f64. Coordinates are first multiplied by a power of two, so that the largest of both meshes is about 1:
//! that is exact, and keeps products of four lengths in range.

use rayon::prelude::*;

use super::bvh::{Bvh, MAX_TRIANGLES, Nearest};
use super::closest::{Triangle, Vec3, along, cross, dot, normal, sub};
use super::hausdorff::{OneSidedBound, POSITION_ROUNDING, one_sided};
use crate::error::{Error, Result};

/// A mesh as the caller has it.
#[derive(Clone, Copy, Debug)]
pub struct MeshView<'a> {
    /// What errors call the vertices.
    pub name: &'static str,
    /// Positions.
    pub vertices: &'a [Vec3],
    /// Triangles.
    pub faces: &'a [[u32; 3]],
}

/// Called from time to time with the work done and the total; `false` stops the work with [`Error::Cancelled`].
pub type Proceed<'a> = &'a (dyn Fn(u64, u64) -> bool + Sync);

/// What to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistanceOptions {
    /// Points per direction.
    pub samples: usize,
    /// Other seeds give other points.
    pub seed: u64,
    /// Bound the distance as well: how far the bounds may be apart, as a part of the upper one, and how many pieces of
    /// triangles may be looked at one by one per direction, about.
    pub bounded: Option<(f64, u64)>,
}

/// Mean, root of the mean square, and maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Mean; NaN of nothing.
    pub mean: f64,
    /// Root of the mean square; NaN of nothing.
    pub rms: f64,
    /// Maximum; NaN of nothing.
    pub max: f64,
}

/// Distances from one surface to another.
#[derive(Clone, Debug)]
pub struct OneSided {
    /// Of the samples; the maximum is also that of the vertices which faces refer to.
    pub distance: Summary,
    /// Angles in degrees between the normal of a sample's face and that of the nearest face.
    pub normals: Summary,
    /// Distance of each vertex.
    pub per_vertex: Vec<f64>,
    /// Area of the surface measured from.
    pub area: f64,
    /// Bounds of the largest distance.
    pub bound: Option<OneSidedBound>,
}

/// Distances in both directions.
#[derive(Clone, Debug)]
pub struct SurfaceDistance {
    /// From the first surface to the second, and from the second to the first.
    pub directions: [OneSided; 2],
    /// How far apart bounds are by rounding alone, at most.
    pub rounding: f64,
}

/// Largest exponent of a coordinate: beyond, results would not be finite.
const LARGEST_EXPONENT: i32 = 1000;

/// Points in a piece of work.
const WORK: usize = 1024;

fn check(mesh: MeshView<'_>) -> Result<f64> {
    let MeshView { name, vertices, faces } = mesh;
    if faces.is_empty() {
        return Err(Error::EmptyMesh(format!("{name}: there are no faces")));
    }
    if faces.len() > MAX_TRIANGLES {
        return Err(Error::TooLarge(format!(
            "{name}: {} faces; at most {MAX_TRIANGLES} are supported",
            faces.len()
        )));
    }
    let bad = faces.par_iter().position_first(|f| f.iter().any(|v| *v as usize >= vertices.len()));
    if let Some(face) = bad {
        let index = faces[face].iter().find(|v| **v as usize >= vertices.len()).copied().unwrap_or_default();
        return Err(Error::IndexOutOfRange { face, index: i64::from(index), vertices: vertices.len() });
    }
    check_points(name, vertices)
}

/// Refuses what is not finite or huge; returns the largest coordinate.
fn check_points(name: &'static str, points: &[Vec3]) -> Result<f64> {
    if let Some(index) = points.par_iter().position_first(|p| p.iter().any(|x| !x.is_finite())) {
        return Err(Error::NonFinite { argument: name.into(), index, value: points[index].to_vec() });
    }
    let huge = 2.0f64.powi(LARGEST_EXPONENT);
    if let Some(index) = points.par_iter().position_first(|p| p.iter().any(|x| x.abs() > huge)) {
        let message =
            format!("coordinates must not exceed {huge:.0e}, but row {index} is {:?}", points[index]);
        return Err(Error::argument(name, message));
    }
    Ok(points.par_iter().map(|p| p.iter().fold(0.0f64, |m, x| m.max(x.abs()))).reduce(|| 0.0, f64::max))
}

/// A power of two that brings coordinates up to `largest` near 1.
fn scale_for(largest: f64) -> f64 {
    if largest > 0.0 {
        2.0f64.powi(-(largest.log2() as i32).clamp(-LARGEST_EXPONENT, LARGEST_EXPONENT))
    } else {
        1.0
    }
}

/// A mesh, scaled, with its tree.
struct Prepared<'a> {
    vertices: Vec<Vec3>,
    faces: &'a [[u32; 3]],
    tree: Bvh,
}

impl<'a> Prepared<'a> {
    fn new(mesh: MeshView<'a>, scale: f64) -> Self {
        let vertices: Vec<Vec3> = mesh.vertices.par_iter().map(|p| p.map(|x| x * scale)).collect();
        let triangles: Vec<Triangle> =
            mesh.faces.par_iter().map(|f| f.map(|v| vertices[v as usize])).collect();
        Self { vertices, faces: mesh.faces, tree: Bvh::new(&triangles) }
    }

    fn triangle(&self, face: usize) -> Triangle {
        self.faces[face].map(|v| self.vertices[v as usize])
    }
}

/// Sums over samples.
#[derive(Clone, Copy, Default)]
struct Sums {
    count: usize,
    sum: f64,
    squares: f64,
    max: f64,
}

impl Sums {
    fn add(&mut self, x: f64) {
        self.count += 1;
        self.sum += x;
        self.squares += x * x;
        self.max = self.max.max(x);
    }

    fn join(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            sum: self.sum + other.sum,
            squares: self.squares + other.squares,
            max: self.max.max(other.max),
        }
    }

    fn summary(&self, scale: f64) -> Summary {
        let n = self.count as f64;
        if self.count == 0 {
            return Summary { mean: f64::NAN, rms: f64::NAN, max: f64::NAN };
        }
        Summary { mean: self.sum / n * scale, rms: (self.squares / n).sqrt() * scale, max: self.max * scale }
    }
}

/// Numbers between 0 and 1 from a seed (SplitMix64: Steele, Lea and Flood, 2014).
fn offsets(seed: u64) -> [f64; 3] {
    [1, 2, 3].map(|k: u64| {
        let mut x = seed.wrapping_add(k.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ x >> 31) >> 11) as f64 / (1u64 << 53) as f64
    })
}

/// Points spread evenly over the area of a mesh: equal steps along the summed areas choose the faces, and a
/// low-discrepancy sequence the place in each (R2, Roberts 2018).
struct Samples<'a> {
    mesh: &'a Prepared<'a>,
    /// Sum of the areas up to and with each face; by number of faces where there is no area.
    sums: Vec<f64>,
    area: f64,
    count: usize,
    offsets: [f64; 3],
}

impl<'a> Samples<'a> {
    fn new(mesh: &'a Prepared<'a>, count: usize, seed: u64) -> Self {
        let mut sums: Vec<f64> = (0..mesh.faces.len())
            .into_par_iter()
            .map(|face| {
                let n = normal(mesh.triangle(face));
                0.5 * dot(n, n).sqrt()
            })
            .collect();
        let mut area = 0.0;
        for x in &mut sums {
            area += *x;
            *x = area;
        }
        if area <= 0.0 {
            sums.iter_mut().enumerate().for_each(|(i, x)| *x = (i + 1) as f64);
        }
        Self { mesh, sums, area, count, offsets: offsets(seed) }
    }

    /// Calls `each` with the faces and points of a range of samples.
    fn visit(&self, range: std::ops::Range<usize>, mut each: impl FnMut(usize, Vec3)) {
        let total = self.sums.last().copied().unwrap_or_default();
        let at = |i: usize| (i as f64 + self.offsets[0]) / self.count as f64 * total;
        let mut face = self.sums.partition_point(|sum| *sum <= at(range.start));
        for i in range {
            while face + 1 < self.sums.len() && self.sums[face] <= at(i) {
                face += 1;
            }
            face = face.min(self.sums.len() - 1);
            // Powers of the inverse of the plastic number.
            let mut u = (i as f64 * 0.754_877_666_246_692_8 + self.offsets[1]).fract();
            let mut v = (i as f64 * 0.569_840_290_998_053_3 + self.offsets[2]).fract();
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let [a, b, c] = self.mesh.triangle(face);
            each(face, along(along(a, sub(b, a), u), sub(c, a), v));
        }
    }
}

/// Angle between two normals in degrees; `None` if one has no direction.
fn angle(m: Vec3, n: Vec3) -> Option<f64> {
    let unit = |n: Vec3| {
        let length = dot(n, n).sqrt();
        (length > f64::MIN_POSITIVE).then(|| n.map(|x| x / length))
    };
    let (m, n) = (unit(m)?, unit(n)?);
    let sine = cross(m, n);
    Some(dot(sine, sine).sqrt().atan2(dot(m, n)).to_degrees())
}

/// The farther of two distances and where it is.
fn farther(a: (f64, Vec3), b: (f64, Vec3)) -> (f64, Vec3) {
    if b.0 > a.0 { b } else { a }
}

fn ranges(count: usize) -> Vec<std::ops::Range<usize>> {
    (0..count).step_by(WORK).map(|start| start..count.min(start + WORK)).collect()
}

/// The nearest points of a tree that is not empty.
fn nearest(tree: &Bvh, p: Vec3, hint: &mut usize) -> Nearest {
    let found = tree.nearest(p, f64::INFINITY, -1.0, *hint);
    let found = found.unwrap_or(Nearest { distance: f64::INFINITY, place: 0, point: p });
    *hint = found.place;
    found
}

fn direction(
    from: &Prepared<'_>,
    to: &Prepared<'_>,
    options: &DistanceOptions,
    scale: f64,
    proceed: Proceed<'_>,
) -> Result<OneSided> {
    let mut used = vec![false; from.vertices.len()];
    from.faces.iter().flatten().for_each(|v| used[*v as usize] = true);
    let mut per_vertex = vec![0.0; from.vertices.len()];
    let none = (-1.0, [0.0; 3]);
    let farthest = per_vertex
        .par_chunks_mut(WORK)
        .zip(ranges(from.vertices.len()))
        .map(|(out, range)| {
            if !proceed(0, 0) {
                return Err(Error::Cancelled);
            }
            let (mut hint, mut most) = (usize::MAX, none);
            for (out, i) in out.iter_mut().zip(range) {
                let p = from.vertices[i];
                *out = nearest(&to.tree, p, &mut hint).distance;
                if used[i] {
                    most = farther(most, (*out, p));
                }
            }
            Ok(most)
        })
        .collect::<Result<Vec<_>>>()?;
    let mut farthest = farthest.into_iter().fold(none, farther);

    let samples = Samples::new(from, options.samples, options.seed);
    let parts = ranges(options.samples)
        .into_par_iter()
        .map(|range| {
            if !proceed(0, 0) {
                return Err(Error::Cancelled);
            }
            let (mut hint, mut most) = (usize::MAX, none);
            let (mut distances, mut angles) = (Sums::default(), Sums::default());
            samples.visit(range, |face, p| {
                let found = nearest(&to.tree, p, &mut hint);
                distances.add(found.distance);
                most = farther(most, (found.distance, p));
                if let Some(angle) = angle(normal(from.triangle(face)), normal(to.tree.triangle(found.place)))
                {
                    angles.add(angle);
                }
            });
            Ok((distances, angles, most))
        })
        .collect::<Result<Vec<_>>>()?;
    let (mut distances, mut angles) = (Sums::default(), Sums::default());
    for (d, a, most) in parts {
        distances = distances.join(d);
        angles = angles.join(a);
        farthest = farther(farthest, most);
    }
    distances.max = distances.max.max(farthest.0);

    let bound = match options.bounded {
        Some((tolerance, budget)) => {
            let bound = one_sided(&from.tree, &to.tree, farthest, tolerance, budget, LARGEST, proceed)?;
            Some(OneSidedBound { lower: bound.lower / scale, upper: bound.upper / scale, ..bound })
        }
        None => None,
    };
    per_vertex.par_iter_mut().for_each(|d| *d /= scale);
    Ok(OneSided {
        distance: distances.summary(1.0 / scale),
        normals: angles.summary(1.0),
        per_vertex,
        area: samples.area / scale / scale,
        bound,
    })
}

/// Coordinates are below this once they are scaled.
const LARGEST: f64 = 4.0;

/// Distances between two meshes, in both directions. The result does not depend on the number of threads.
pub fn surface_distance(
    a: MeshView<'_>,
    b: MeshView<'_>,
    options: &DistanceOptions,
    proceed: Proceed<'_>,
) -> Result<SurfaceDistance> {
    if options.samples == 0 {
        return Err(Error::argument("samples", "must be 1 or more"));
    }
    if let Some((tolerance, _)) = options.bounded
        && !(tolerance > 0.0 && tolerance < 1.0)
    {
        return Err(Error::argument("tolerance", format!("must be between 0 and 1, not {tolerance}")));
    }
    let scale = scale_for(check(a)?.max(check(b)?));
    let (a, b) = (Prepared::new(a, scale), Prepared::new(b, scale));
    let directions =
        [direction(&a, &b, options, scale, proceed)?, direction(&b, &a, options, scale, proceed)?];
    Ok(SurfaceDistance { directions, rounding: 4.0 * LARGEST * POSITION_ROUNDING / scale })
}

/// For each point the distance to a mesh, the face nearest to it, and the nearest point.
pub fn closest_points(
    points: (&'static str, &[Vec3]),
    mesh: MeshView<'_>,
    proceed: Proceed<'_>,
) -> Result<Vec<(f64, u32, Vec3)>> {
    let scale = scale_for(check(mesh)?.max(check_points(points.0, points.1)?));
    let mesh = Prepared::new(mesh, scale);
    let parts = points
        .1
        .par_chunks(WORK)
        .map(|part| {
            if !proceed(0, 0) {
                return Err(Error::Cancelled);
            }
            let mut hint = usize::MAX;
            let mut one = |p: &Vec3| {
                let found = nearest(&mesh.tree, p.map(|x| x * scale), &mut hint);
                (found.distance / scale, mesh.tree.id(found.place) as u32, found.point.map(|x| x / scale))
            };
            Ok(part.iter().map(&mut one).collect())
        })
        .collect::<Result<Vec<Vec<_>>>>()?;
    Ok(parts.concat())
}
