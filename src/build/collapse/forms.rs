//! The quadratic forms of a collapse's cost: sums over the faces around its two points.
//!
//! Three sums are kept for each point and added up for an edge, minus its own faces, which count twice: the squared
//! distances to the planes (Garland and Heckbert 1997), the signed distances, whose sum is the change of volume
//! (Lindstrom and Turk, "Fast and Memory Efficient Polygonal Simplification", 1998), and the squared deviation of
//! attributes that are linear on each face (Hoppe, "New Quadric Metric for Simplifying Meshes with Appearance
//! Attributes", 1999): with c_f(x) the attribute that face f would have at x and A_f its area, the best value there
//! is the mean of c_f(x), and the remaining deviation is Σ A_f c_f(x)² − (Σ A_f c_f(x))² / Σ A_f, again a quadric.

use glam::{DVec3, DVec4};

use super::quadric::Quadric;
use super::surface::{NONE, Opening, Surface};
use super::wedges::squared_distance;
use super::{Cost, Policy};

/// Gradients of attributes are damped on faces thinner than about this, where they mean little. Triangles of CAD
/// meshes may be a thousand times longer than wide, and shading across them counts.
const THIN: f64 = 1.0e-4;

/// An attribute that counts.
#[derive(Clone, Copy, Debug)]
pub struct Channel {
    /// Column of the attribute row.
    pub column: usize,
    /// A unit of it as a length.
    pub weight: f64,
}

/// Sums over the faces at a point, or at either end of an edge.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sums {
    /// Squared distances to planes, weighted by area.
    pub geometry: Quadric,
    /// Squared deviation of attributes; for a point, before the best values are subtracted.
    pub attribute: Quadric,
    /// Signed distances to planes, weighted by area.
    pub volume: DVec4,
    /// Area.
    pub area: f64,
}

/// Faces are folded over if the mean of their normals is shorter,
const FOLDED: f64 = 0.4;
/// or of whose area more than this part faces against it.
const AGAINST: f64 = 0.03;
/// Cosine of the angle, from behind, up to which a face that closes an opening may face away from its normals.
const CLOSES: f64 = 0.5;

/// Distances around folds are measured for at most so many faces: the time grows with the square of their number.
pub const MOST_FOLDED: usize = 32;

/// A triangle with its box.
struct Boxed {
    corners: [DVec3; 3],
    low: DVec3,
    high: DVec3,
}

impl Boxed {
    fn new(corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        Self { corners, low: a.min(b).min(c), high: a.max(b).max(c) }
    }
}

/// The squared distance of a point to some triangles. `near` is the first candidate, and becomes the nearest.
fn nearest(p: DVec3, others: &[Boxed], near: &mut usize) -> f64 {
    let first = *near;
    let mut best = others.get(first).map_or(f64::INFINITY, |other| squared_distance(p, other.corners));
    for (i, other) in others.iter().enumerate() {
        if i == first || p.distance_squared(p.clamp(other.low, other.high)) >= best {
            continue;
        }
        let squared = squared_distance(p, other.corners);
        if squared < best {
            (best, *near) = (squared, i);
        }
    }
    best
}

impl Sums {
    /// Whether the normals nearly cancel.
    fn cancel(&self) -> bool {
        self.volume.truncate().length() < FOLDED * self.area
    }
}

/// What a face adds to the sums of its points. They are read together.
#[derive(Clone, Copy, Debug, Default)]
struct Share {
    /// Plane (unit normal, offset) and area; zero if it has none.
    plane: DVec4,
    area: f64,
    /// Squared distances to the plane, and squared attributes.
    distances: Quadric,
    squares: Quadric,
}

/// The sums of every point.
#[derive(Debug)]
pub struct Forms {
    policy: Policy,
    channels: Vec<Channel>,
    /// Columns of the attribute rows.
    stride: usize,
    shares: Vec<Share>,
    /// For each face and channel the weighted attribute as an affine form, times the area.
    linear: Vec<DVec4>,
    points: Vec<Sums>,
    /// Whether the faces of a point are folded over, such as at the rim of a plate.
    folded: Vec<bool>,
    fresh: Vec<bool>,
    /// The wedge of points with one wedge.
    single: Vec<u32>,
    /// For each wedge the sums over its faces: attributes by area, and area.
    wedge_linear: Vec<DVec4>,
    wedge_areas: Vec<f64>,
    wedges: Vec<u32>,
    pairs: Vec<(u32, u32)>,
    shared: Vec<usize>,
}

impl Forms {
    /// Sums for a surface with attribute `rows` of `stride` floats for each wedge.
    pub fn new(
        surface: &Surface,
        rows: &[f32],
        stride: usize,
        wedges: usize,
        channels: Vec<Channel>,
        policy: Policy,
    ) -> Self {
        let (faces, points) = (surface.faces.len(), surface.positions.len());
        let mut new = Self {
            policy,
            stride,
            shares: vec![Share::default(); faces],
            linear: vec![DVec4::ZERO; faces * channels.len()],
            points: vec![Sums::default(); points],
            folded: vec![false; points],
            fresh: vec![false; points],
            single: vec![NONE; points],
            wedge_linear: vec![DVec4::ZERO; wedges * channels.len()],
            wedge_areas: vec![0.0; wedges],
            wedges: Vec::new(),
            pairs: Vec::new(),
            shared: Vec::new(),
            channels,
        };
        for f in 0..faces {
            new.set_face(surface, rows, f);
        }
        if policy.cost == Cost::GarlandHeckbert {
            for p in 0..points as u32 {
                new.sum_planes(surface, p);
            }
        }
        new
    }

    /// Plane of a face, and its area.
    pub fn plane(&self, face: usize) -> (DVec4, f64) {
        let Share { plane, area, .. } = self.shares[face];
        (plane, area)
    }

    /// Updates the plane and sums of a face that moved.
    pub fn set_face(&mut self, surface: &Surface, rows: &[f32], f: usize) {
        let face = &surface.faces[f];
        let [p, q, r] = face.points.map(|p| surface.positions[p as usize]);
        let (u, v) = (q - p, r - p);
        let cross = u.cross(v);
        let size = cross.length();
        if size <= 0.0 {
            self.shares[f] = Share::default();
            self.linear[f * self.channels.len()..][..self.channels.len()].fill(DVec4::ZERO);
            return;
        }
        let normal = cross * size.recip();
        let area = 0.5 * size;
        let plane = normal.extend(-normal.dot(p));
        let distances = Quadric::of_square(plane, self.weight(area));
        let mut squares = Quadric::default();
        if self.channels.is_empty() {
            self.shares[f] = Share { plane, area, distances, squares };
            return;
        }
        let sides = u.length_squared() + v.length_squared();
        let damped = cross.length_squared() + (THIN * sides) * (THIN * sides);
        let scaled = cross * damped.recip();
        let (du, dv) = (v.cross(scaled), scaled.cross(u));
        let rows = face.wedges.map(|w| &rows[w as usize * self.stride..][..self.stride]);
        let linear = &mut self.linear[f * self.channels.len()..];
        for (linear, channel) in linear.iter_mut().zip(&self.channels) {
            let [a, b, c] = rows.map(|row| f64::from(row[channel.column]));
            let g = du * (b - a) + dv * (c - a);
            let form = g.extend(a - g.dot(p)) * channel.weight;
            squares.add_square(form, area);
            *linear = form * area;
        }
        self.shares[f] = Share { plane, area, distances, squares };
    }

    /// Invalidates the sums of a point.
    pub fn touch(&mut self, point: u32) {
        self.fresh[point as usize] = false;
    }

    /// Merges a point into another.
    pub fn merge(&mut self, keep: u32, other: u32) {
        if self.policy.cost == Cost::GarlandHeckbert {
            let other = self.points[other as usize];
            let keep = &mut self.points[keep as usize];
            keep.geometry += other.geometry;
            keep.area += other.area;
        }
    }

    fn weight(&self, area: f64) -> f64 {
        if self.policy.cost == Cost::LindstromTurk { area * area } else { area }
    }

    /// The plane through a border or crease that stands on a face, as it may be added to a quadric.
    #[inline]
    fn upright(&self, surface: &Surface, f: usize, side: usize) -> Option<(DVec4, f64)> {
        let face = &surface.faces[f];
        if !face.has_line(side) {
            return None;
        }
        let edge = &surface.edges[face.edges[side] as usize];
        let weight = match (edge.rim(), edge.crease) {
            (true, _) => self.policy.border_weight,
            (false, true) => self.policy.crease_weight,
            (false, false) => return None,
        };
        let p = surface.positions[face.points[side] as usize];
        let along = surface.positions[face.points[(side + 1) % 3] as usize] - p;
        let normal = along.cross(self.shares[f].plane.truncate()).try_normalize()?;
        Some((normal.extend(-normal.dot(p)), self.weight(weight * along.length_squared())))
    }

    fn sum_planes(&mut self, surface: &Surface, point: u32) {
        let mut sums = Sums::default();
        for (f, k) in surface.around(point) {
            let share = &self.shares[f];
            sums.geometry += share.distances;
            sums.volume += share.plane * share.area;
            sums.area += share.area;
            if surface.faces[f].has_lines() {
                for side in [k, (k + 2) % 3] {
                    if let Some((plane, weight)) = self.upright(surface, f, side) {
                        sums.geometry.add_square(plane, weight);
                    }
                }
            }
        }
        let whole = sums.volume.truncate();
        let against = surface.around(point).map(|(f, _)| &self.shares[f]);
        let against: f64 =
            against.filter(|share| share.plane.truncate().dot(whole) < 0.0).map(|share| share.area).sum();
        self.folded[point as usize] = sums.cancel() || against > AGAINST * sums.area;
        self.points[point as usize] = sums;
    }

    fn refresh(&mut self, surface: &Surface, point: u32) {
        if std::mem::replace(&mut self.fresh[point as usize], true) {
            return;
        }
        if self.policy.cost != Cost::GarlandHeckbert {
            self.sum_planes(surface, point);
        }
        let count = self.channels.len();
        let mut single = None;
        let mut several = false;
        for (f, k) in surface.around(point) {
            let w = surface.faces[f].wedges[k];
            several |= *single.get_or_insert(w) != w;
            self.wedge_areas[w as usize] = 0.0;
        }
        let mut attribute = Quadric::default();
        if count > 0 {
            for (f, k) in surface.around(point) {
                let w = surface.faces[f].wedges[k] as usize;
                let share = &self.shares[f];
                attribute += share.squares;
                let of_face = &self.linear[f * count..][..count];
                // Nothing is known of a wedge before the first face that has an area.
                let is_first = self.wedge_areas[w] == 0.0;
                self.wedge_areas[w] += share.area;
                for (sum, linear) in self.wedge_linear[w * count..].iter_mut().zip(of_face) {
                    *sum = if is_first { *linear } else { *sum + *linear };
                }
            }
        }
        self.points[point as usize].attribute = attribute;
        self.single[point as usize] = if several { NONE } else { single.unwrap_or(NONE) };
    }

    /// Pairs of wedges that the faces of an edge join, one at each end. False if that would join two wedges of one
    /// point, whose attributes may differ: an attribute seam ends there.
    pub fn pair_wedges(surface: &Surface, edge: u32, pairs: &mut Vec<(u32, u32)>) -> bool {
        let [a, b] = surface.edges[edge as usize].ends;
        pairs.clear();
        for f in surface.beside(edge) {
            let face = &surface.faces[f];
            let mut pair = (NONE, NONE);
            for (p, w) in face.points.iter().zip(face.wedges) {
                if *p == a {
                    pair.0 = w;
                } else if *p == b {
                    pair.1 = w;
                }
            }
            if pairs.contains(&pair) {
                continue;
            }
            if pairs.iter().any(|p| p.0 == pair.0 || p.1 == pair.1) {
                return false;
            }
            pairs.push(pair);
        }
        true
    }

    /// Whether the faces around an edge whose sums were just found are folded over. Distances to planes say little
    /// there, so distances to faces are measured.
    pub fn is_folded(&self, surface: &Surface, edge: u32, sums: &Sums) -> bool {
        let ends = surface.edges[edge as usize].ends;
        sums.cancel() || ends.into_iter().any(|p| self.folded[p as usize])
    }

    /// Finds the sums of an edge; false if its wedges do not match.
    pub fn edge(&mut self, surface: &Surface, edge: u32, sums: &mut Sums) -> bool {
        let ends = surface.edges[edge as usize].ends;
        ends.into_iter().for_each(|p| self.refresh(surface, p));
        let whole = ends.map(|p| self.single[p as usize]);
        let simple = !whole.contains(&NONE);
        if simple {
            self.pairs.clear();
            self.pairs.push((whole[0], whole[1]));
        } else if !Self::pair_wedges(surface, edge, &mut self.pairs) {
            return false;
        }
        let [at_a, at_b] = ends.map(|p| &self.points[p as usize]);
        *sums = Sums {
            geometry: at_a.geometry + at_b.geometry,
            attribute: at_a.attribute + at_b.attribute,
            volume: at_a.volume + at_b.volume,
            area: at_a.area + at_b.area,
        };
        self.shared.clear();
        self.shared.extend(surface.beside(edge));
        let count = self.channels.len();
        for f in &self.shared {
            if self.policy.cost != Cost::GarlandHeckbert {
                let share = &self.shares[*f];
                sums.geometry -= share.distances;
                sums.volume -= share.plane * share.area;
                sums.area -= share.area;
                let face = &surface.faces[*f];
                if face.has_lines()
                    && let Some(side) = face.edges.iter().position(|e| *e == edge)
                    && let Some((plane, weight)) = self.upright(surface, *f, side)
                {
                    sums.geometry.add_square(plane, -weight);
                }
            }
            sums.attribute -= self.shares[*f].squares;
        }
        if count > 0 {
            for (v, w) in &self.pairs {
                self.take_best(surface, *v, *w, &mut sums.attribute);
            }
            if !simple {
                self.take_best_of_unpaired(surface, ends, &mut sums.attribute);
            }
        }
        true
    }

    /// Subtracts the part of a quadric that the best values of a pair of wedges explain.
    fn take_best(&self, surface: &Surface, v: u32, w: u32, quadric: &mut Quadric) {
        let count = self.channels.len();
        let between = || self.shared.iter().filter(|f| surface.faces[**f].wedges.contains(&v));
        let twice: f64 = between().map(|f| self.shares[*f].area).sum();
        let area = self.wedge_areas[v as usize] + self.wedge_areas[w as usize] - twice;
        if area <= 0.0 {
            return;
        }
        for k in 0..count {
            let mut sum =
                self.wedge_linear[v as usize * count + k] + self.wedge_linear[w as usize * count + k];
            for f in between() {
                sum -= self.linear[f * count + k];
            }
            quadric.add_square(sum, -1.0 / area);
        }
    }

    /// The normal that an edge, which was just evaluated, leaves at a place for two wedges or one: the first three
    /// columns of the attributes. `None` if they do not all count, or if the normal vanishes.
    pub fn best_normal(
        &self,
        surface: &Surface,
        edge: u32,
        [v, w]: [u32; 2],
        position: DVec3,
    ) -> Option<DVec3> {
        let channels = self.channels.first_chunk::<3>()?;
        if channels.iter().zip(0..).any(|(channel, column)| channel.column != column) {
            return None;
        }
        let count = self.channels.len();
        let of_wedge = |w: u32, k: usize| self.wedge_linear[w as usize * count + k];
        let mut sums: [DVec4; 3] = std::array::from_fn(|k| of_wedge(v, k));
        if v != w {
            sums.iter_mut().zip(0..).for_each(|(sum, k)| *sum += of_wedge(w, k));
            for f in surface.beside(edge).filter(|f| surface.faces[*f].wedges.contains(&v)) {
                sums.iter_mut().zip(&self.linear[f * count..]).for_each(|(sum, linear)| *sum -= *linear);
            }
        }
        let at = |k: usize| sums[k].dot(position.extend(1.0)) / channels[k].weight;
        DVec3::new(at(0), at(1), at(2)).try_normalize()
    }

    /// The same where attributes do not count: from the rows of the faces themselves.
    pub fn mean_normal(
        &self,
        surface: &Surface,
        rows: &[f32],
        edge: u32,
        wedges: [u32; 2],
        position: DVec3,
    ) -> Option<DVec3> {
        let [a, b] = surface.edges[edge as usize].ends;
        let mut sum = DVec3::ZERO;
        let faces =
            surface.around(a).chain(surface.around(b).filter(|(f, _)| !surface.faces[*f].has_edge(edge)));
        for (f, k) in faces {
            let face = &surface.faces[f];
            // A face between the ends has a wedge at both.
            let own = wedges.contains(&face.wedges[k])
                || face.has_edge(edge) && face.wedges.iter().any(|w| wedges.contains(w));
            if !own || self.shares[f].area == 0.0 {
                continue;
            }
            let [p, q, r] = face.points.map(|p| surface.positions[p as usize]);
            let (u, v, to) = (q - p, r - p, position - p);
            let cross = u.cross(v);
            let sides = u.length_squared() + v.length_squared();
            let damped = (cross.length_squared() + (THIN * sides) * (THIN * sides)).recip();
            let (s, t) = (to.cross(v).dot(cross) * damped, u.cross(to).dot(cross) * damped);
            let normals = self.carried(rows, face.wedges);
            sum += self.shares[f].area
                * (normals[0] + s * (normals[1] - normals[0]) + t * (normals[2] - normals[0]));
        }
        sum.try_normalize()
    }

    /// The normals that the corners of a face carry: `rows` begin with them.
    fn carried(&self, rows: &[f32], wedges: [u32; 3]) -> [DVec3; 3] {
        wedges.map(|w| {
            let row = rows[w as usize * self.stride..].first_chunk::<3>();
            row.map_or(DVec3::ZERO, |n| DVec3::from_array(n.map(f64::from)))
        })
    }

    fn take_best_of_unpaired(&mut self, surface: &Surface, ends: [u32; 2], quadric: &mut Quadric) {
        let mut wedges = std::mem::take(&mut self.wedges);
        wedges.clear();
        for (f, k) in ends.into_iter().flat_map(|p| surface.around(p)) {
            let w = surface.faces[f].wedges[k];
            if !wedges.contains(&w) && !self.pairs.iter().any(|p| p.0 == w || p.1 == w) {
                wedges.push(w);
            }
        }
        let count = self.channels.len();
        for w in &wedges {
            let area = self.wedge_areas[*w as usize];
            if area > 0.0 {
                for sum in &self.wedge_linear[*w as usize * count..][..count] {
                    quadric.add_square(*sum, -1.0 / area);
                }
            }
        }
        self.wedges = wedges;
    }

    /// The faces around an edge that remain when it collapses to `position`, each with its new sides.
    #[inline]
    fn moved<'a>(
        &'a self,
        surface: &'a Surface,
        edge: u32,
        position: DVec3,
    ) -> impl Iterator<Item = (usize, usize, [DVec3; 2])> + 'a {
        let ends = surface.edges[edge as usize].ends;
        let around = ends.into_iter().flat_map(|p| surface.around(p));
        around.filter(move |(f, _)| !surface.faces[*f].has_edge(edge)).map(move |(f, k)| {
            let points = surface.faces[f].points;
            let [q, r] = [1, 2].map(|j| surface.positions[points[(k + j) % 3] as usize]);
            (f, k, [q - position, r - position])
        })
    }

    /// Whether faces would flip when an edge collapses to `position`, against their own normals or against those of
    /// their vertices, with which `rows` begin.
    pub fn folds(&self, surface: &Surface, rows: &[f32], edge: u32, position: DVec3) -> bool {
        self.moved(surface, edge, position).any(|(f, _, [u, v])| {
            // Where sheets were separated, two points may have one place.
            if u == DVec3::ZERO || v == DVec3::ZERO {
                return true;
            }
            if self.shares[f].area == 0.0 {
                return false;
            }
            let cross = u.cross(v);
            let before = self.shares[f].plane.truncate();
            if cross.dot(before) <= self.policy.turn * cross.length() {
                return true;
            }
            if self.policy.up.is_some_and(|up| cross.dot(up) <= 0.0 && before.dot(up) > 0.0) {
                return true;
            }
            if !self.policy.cuts {
                return false;
            }
            let normals = self.carried(rows, surface.faces[f].wedges);
            let carried = normals[0] + normals[1] + normals[2];
            cross.dot(carried) < 0.0 && before.dot(carried) >= 0.0
        })
    }

    /// Whether the face that closes an opening does not face away from its vertex normals, nor from `up`.
    pub fn faces_along(&self, surface: &Surface, rows: &[f32], opening: &Opening) -> bool {
        let [a, b, c] = opening.points.map(|p| surface.positions[p as usize]);
        let cross = (b - a).cross(c - a);
        let normals = self.carried(rows, opening.wedges);
        let carried = normals[0] + normals[1] + normals[2];
        // Those around the end of a tube stand on it.
        cross.dot(carried) >= -CLOSES * cross.length() * carried.length()
            && self.policy.up.is_none_or(|up| cross.dot(up) > 0.0)
    }

    /// Whether faces would become thin when an edge collapses to `position`.
    pub fn thins(&self, surface: &Surface, edge: u32, position: DVec3) -> bool {
        let thinness = |size: f64, u: DVec3, v: DVec3| {
            size / (u.length_squared() + v.length_squared() + (u - v).length_squared())
        };
        self.moved(surface, edge, position).any(|(f, k, [u, v])| {
            let now = thinness(u.cross(v).length(), u, v);
            if now >= self.policy.thin || self.shares[f].area == 0.0 {
                return false;
            }
            let face = &surface.faces[f];
            let [p, q, r] = [0, 1, 2].map(|j| surface.positions[face.points[(k + j) % 3] as usize]);
            now < 0.5 * thinness(2.0 * self.shares[f].area, q - p, r - p)
        })
    }

    /// Squared distances between the faces around an edge before and after it collapses to `position`, weighted by
    /// area: the larger of both directions. The quadrature by three corners and the centre is exact for quadratic
    /// functions. It stops above `most`.
    pub fn apart(&self, surface: &Surface, edge: u32, position: DVec3, most: f64) -> f64 {
        let ends = surface.edges[edge as usize].ends;
        let mut before: Vec<Boxed> = Vec::with_capacity(MOST_FOLDED);
        for (i, end) in ends.into_iter().enumerate() {
            for (f, _) in surface.around(end) {
                if i == 0 || !surface.faces[f].has_edge(edge) {
                    before.push(Boxed::new(surface.faces[f].points.map(|p| surface.positions[p as usize])));
                }
            }
        }
        let after: Vec<Boxed> = self
            .moved(surface, edge, position)
            .map(|(_, _, [u, v])| Boxed::new([position, position + u, position + v]))
            .collect();
        if after.is_empty() {
            return 0.0;
        }
        let ends = ends.map(|p| surface.positions[p as usize]);
        let mut near = 0;
        let to_after = ends.map(|p| nearest(p, &after, &mut near));
        let to_before = nearest(position, &before, &mut near);
        let one_way = |from: &[Boxed], others: &[Boxed], known: &dyn Fn(DVec3) -> f64| -> f64 {
            let (mut sum, mut near) = (0.0, 0);
            for Boxed { corners: t, .. } in from {
                let area = 0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length();
                let corners: f64 = t.iter().map(|p| known(*p)).sum();
                sum +=
                    area * (0.75 * nearest((t[0] + t[1] + t[2]) / 3.0, others, &mut near) + corners / 12.0);
                if sum > most {
                    break;
                }
            }
            sum
        };
        let at_end = |p: DVec3| ends.iter().position(|end| *end == p).map_or(0.0, |k| to_after[k]);
        let at_new = |p: DVec3| if p == position { to_before } else { 0.0 };
        let there = one_way(&before, &after, &at_end);
        if there > most { there } else { there.max(one_way(&after, &before, &at_new)) }
    }

    /// Room for a further point.
    pub fn add_point(&mut self) {
        self.points.push(Sums::default());
        self.folded.push(false);
        self.fresh.push(false);
        self.single.push(NONE);
    }

    /// Room for so many faces.
    pub fn add_faces(&mut self, faces: usize) {
        self.shares.resize(faces, Share::default());
        self.linear.resize(faces * self.channels.len(), DVec4::ZERO);
    }

    /// Room for a further wedge.
    pub fn add_wedge(&mut self) {
        self.wedge_areas.push(0.0);
        self.wedge_linear.resize(self.wedge_linear.len() + self.channels.len(), DVec4::ZERO);
    }

    /// Mean squared distance of a point to the planes around an edge.
    pub fn squared_distance(&self, surface: &Surface, edge: u32, position: DVec3) -> f64 {
        let ends = surface.edges[edge as usize].ends;
        let (mut sum, mut area) = (0.0, 0.0);
        for (f, _) in ends.into_iter().flat_map(|p| surface.around(p)) {
            let d = self.shares[f].plane.dot(position.extend(1.0));
            sum += self.shares[f].area * d * d;
            area += self.shares[f].area;
        }
        if area > 0.0 { sum / area } else { 0.0 }
    }

    /// The largest distance of a point to the planes around an edge, and to those that stand on borders and creases there.
    pub fn farthest(&self, surface: &Surface, edge: u32, position: DVec3) -> f64 {
        let ends = surface.edges[edge as usize].ends;
        let mut most = 0.0f64;
        for (f, k) in ends.into_iter().flat_map(|p| surface.around(p)) {
            most = most.max(self.shares[f].plane.dot(position.extend(1.0)).abs());
            if surface.faces[f].has_lines() {
                for (plane, _) in [k, (k + 2) % 3].into_iter().filter_map(|k| self.upright(surface, f, k)) {
                    most = most.max(plane.dot(position.extend(1.0)).abs());
                }
            }
        }
        most
    }
}
