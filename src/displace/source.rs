//! The exact surface: what it is, points of it, and how far it is from linear.
//!
//! At the place b of a source triangle it is p(b) + a(uv(b)) n(b)/|n(b)|, with a the scaled height, or p(b) + a(uv(b)) of
//! vector maps. Where faces at one place have different texture coordinates or normals, that is torn. Then the surface has
//! at a vertex the mean height along the normalised mean normal of its different corners, and along an edge that of its
//! different sides, which is moved linearly so that it meets the vertices. The difference D is blended over the triangle:
//! Σ bᵢ Dᵢ of its vertices, and of each edge what is left of its difference, R, as (1 − b_k) R(t), with t the place on the edge
//! that the line from the vertex k across points to. Both agree on the sides, which is why no crack is left.
//!
//! Under a map that repeats, sides that are whole maps apart are not different.
//!
//! (1 − b_k) R(t) is linear along lines through k, and the perspective image of R: where R is within ρ of linear, it is
//! within (1 − b_k) ρ.

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::bend::{direction_bend, direction_bend_near, product_bend, unit};
use super::map::{Corner, HeightMap};

/// Barycentric coordinates.
pub(super) type Place = [f64; 3];

/// A corner of a source triangle beside its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wedge {
    pub uv: [f64; 2],
    pub normal: DVec3,
}

impl Wedge {
    /// The bits by which wedges are the same.
    pub(super) fn key(&self) -> [u64; 5] {
        let [x, y, z] = self.normal.to_array();
        // Adding 0 makes −0 and 0 the same.
        [self.uv[0], self.uv[1], x, y, z].map(|v| (v + 0.0).to_bits())
    }

    /// The same at other texture coordinates.
    fn moved(&self, by: [f64; 2]) -> Self {
        Self { uv: [self.uv[0] - by[0], self.uv[1] - by[1]], normal: self.normal }
    }

    fn between(a: &Self, b: &Self, t: f64) -> Self {
        Self {
            uv: [0, 1].map(|k| a.uv[k] * (1.0 - t) + b.uv[k] * t),
            normal: a.normal * (1.0 - t) + b.normal * t,
        }
    }
}

/// A source triangle.
#[derive(Clone, Debug)]
pub(super) struct Face {
    /// Numbers of positions.
    pub points: [u32; 3],
    pub wedges: [Wedge; 3],
    /// Row of the caller's faces.
    pub row: u32,
}

/// The different sides of a torn edge, from the position of the lower number to the other.
type Seam = Vec<[Wedge; 2]>;

/// The source mesh and the map over it.
pub(super) struct Source<'a> {
    pub map: HeightMap<'a>,
    pub scale: f64,
    pub midlevel: f64,
    pub points: Vec<DVec3>,
    pub faces: Vec<Face>,
    /// What torn points are moved to.
    torn: FxHashMap<u32, DVec3>,
    seams: FxHashMap<[u32; 2], Seam>,
    vectors: bool,
}

/// A pair of positions by which an edge is known.
pub(super) fn edge_key(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

impl<'a> Source<'a> {
    pub(super) fn new(
        map: HeightMap<'a>,
        [scale, midlevel]: [f64; 2],
        points: Vec<DVec3>,
        faces: Vec<Face>,
    ) -> Self {
        let vectors = map.channels() == 3;
        let mut source = Self {
            map,
            scale,
            midlevel,
            points,
            faces,
            torn: FxHashMap::default(),
            seams: FxHashMap::default(),
            vectors,
        };
        source.find_tears();
        source
    }

    fn find_tears(&mut self) {
        let mut corners: Vec<Vec<Wedge>> = vec![Vec::new(); self.points.len()];
        let mut edges: FxHashMap<[u32; 2], Seam> = FxHashMap::default();
        let mut raw: FxHashMap<u32, [u64; 5]> = FxHashMap::default();
        let mut several = vec![false; self.points.len()];
        for face in &self.faces {
            for k in 0..3 {
                let (point, wedge) = (face.points[k], face.wedges[k]);
                several[point as usize] |= *raw.entry(point).or_insert(wedge.key()) != wedge.key();
                let key = |w: &Wedge| w.moved(self.map.whole(w.uv)).key();
                let at = &mut corners[point as usize];
                if !at.iter().any(|w| key(w) == key(&wedge)) {
                    at.push(wedge);
                }
            }
        }
        for face in &self.faces {
            for k in 0..3 {
                let (a, b) = ((k + 1) % 3, (k + 2) % 3);
                if !several[face.points[a] as usize] && !several[face.points[b] as usize] {
                    continue;
                }
                let (a, b) = if face.points[a] < face.points[b] { (a, b) } else { (b, a) };
                let side = [face.wedges[a], face.wedges[b]];
                // Sides that are whole maps apart are the same.
                let key = |s: &[Wedge; 2]| s.map(|w| w.moved(self.map.whole(s[0].uv)).key());
                let seam = edges.entry([face.points[a], face.points[b]]).or_default();
                if !seam.iter().any(|s| key(s) == key(&side)) {
                    seam.push(side);
                }
            }
        }
        edges.retain(|_, sides| sides.len() > 1);
        let ends = edges.keys().flatten().copied();
        let torn = (0..self.points.len() as u32).filter(|p| corners[*p as usize].len() > 1);
        self.torn = torn.chain(ends).map(|p| (p, self.mean(&corners[p as usize]))).collect();
        self.seams = edges;
    }

    /// The scaled height; a vector of vector maps.
    fn height(&self, wedge: &Wedge) -> DVec3 {
        let mid = if self.vectors { DVec3::splat(self.midlevel) } else { DVec3::X * self.midlevel };
        (self.map.value(self.map.place(wedge.uv)) - mid) * self.scale
    }

    /// What a point with this wedge is moved by.
    fn moved(&self, wedge: &Wedge) -> DVec3 {
        let height = self.height(wedge);
        if self.vectors { height } else { unit(wedge.normal) * height.x }
    }

    /// What a point with all these wedges is moved by: the mean height along the mean normal.
    fn mean(&self, wedges: &[Wedge]) -> DVec3 {
        let height = wedges.iter().map(|w| self.height(w)).sum::<DVec3>() / wedges.len() as f64;
        if self.vectors {
            return height;
        }
        unit(wedges.iter().map(|w| unit(w.normal)).sum()) * height.x
    }

    /// What the surface differs by from what the face alone says, at torn vertices.
    fn vertex_tears(&self, face: &Face) -> [DVec3; 3] {
        [0, 1, 2].map(|k| match self.torn.get(&face.points[k]) {
            Some(mean) => *mean - self.moved(&face.wedges[k]),
            None => DVec3::ZERO,
        })
    }

    /// Of the edge across corner k: its sides, and its ends as corners, from the lower position.
    fn seam(&self, face: &Face, k: usize) -> Option<(&Seam, [usize; 2])> {
        let (a, b) = ((k + 1) % 3, (k + 2) % 3);
        let (a, b) = if face.points[a] < face.points[b] { (a, b) } else { (b, a) };
        Some((self.seams.get(&[face.points[a], face.points[b]])?, [a, b]))
    }

    /// What the surface differs by from the face alone at this place.
    pub(super) fn tear(&self, face: &Face, place: Place) -> DVec3 {
        if !self.is_torn(face) {
            return DVec3::ZERO;
        }
        let mut out: DVec3 = self.vertex_tears(face).iter().zip(place).map(|(d, b)| *d * b).sum();
        for k in 0..3 {
            let Some((sides, [a, b])) = self.seam(face, k) else { continue };
            let weight = place[a] + place[b];
            if weight > 0.0 {
                let off = |t: f64| {
                    let all: Vec<Wedge> = sides.iter().map(|s| Wedge::between(&s[0], &s[1], t)).collect();
                    self.mean(&all) - self.moved(&Wedge::between(&face.wedges[a], &face.wedges[b], t))
                };
                let t = place[b] / weight;
                out += (off(t) - off(0.0) * (1.0 - t) - off(1.0) * t) * weight;
            }
        }
        out
    }

    pub(super) fn is_torn(&self, face: &Face) -> bool {
        !self.torn.is_empty() && face.points.iter().any(|p| self.torn.contains_key(p))
    }

    pub(super) fn wedge(&self, face: &Face, place: Place) -> Wedge {
        let [a, b, c] = &face.wedges;
        let blend = |k: usize| a.uv[k] * place[0] + b.uv[k] * place[1] + c.uv[k] * place[2];
        Wedge {
            uv: [blend(0), blend(1)],
            normal: a.normal * place[0] + b.normal * place[1] + c.normal * place[2],
        }
    }

    /// The point of the source.
    pub(super) fn base(&self, face: &Face, place: Place) -> DVec3 {
        let [a, b, c] = face.points.map(|p| self.points[p as usize]);
        a * place[0] + b * place[1] + c * place[2]
    }

    /// The point of the exact surface.
    pub(super) fn point(&self, face: &Face, place: Place) -> DVec3 {
        self.base(face, place) + self.moved(&self.wedge(face, place)) + self.tear(face, place)
    }

    /// How far the map over these wedges is from linear, scaled.
    fn height_bend(&self, wedges: &[Wedge], enough: f64) -> f64 {
        let mut corners = [Corner::default(); 3];
        for (corner, wedge) in corners.iter_mut().zip(wedges) {
            let place = self.map.place(wedge.uv);
            *corner = Corner { place, line: self.map.value(place) };
        }
        let scale = self.scale.abs();
        if scale == 0.0 {
            return 0.0;
        }
        scale * self.map.deviation(&corners[..wedges.len()], enough / scale)
    }

    /// How far what wedges move by is from linear, along a segment or over a triangle.
    fn own_bend(&self, wedges: &[Wedge], enough: f64) -> f64 {
        if self.vectors {
            return self.height_bend(wedges, enough);
        }
        let n = wedges.len();
        let (mut heights, mut normals, mut units) = ([0.0; 3], [DVec3::ZERO; 3], [DVec3::ZERO; 3]);
        for (k, wedge) in wedges.iter().enumerate() {
            (heights[k], normals[k], units[k]) = (self.height(wedge).x, wedge.normal, unit(wedge.normal));
        }
        let rest = product_bend(&heights[..n], &units[..n], 0.0, direction_bend(&normals[..n]));
        if rest > enough {
            return rest;
        }
        rest + self.height_bend(wedges, enough - rest)
    }

    /// The same of the mean of the sides of a torn edge between two places on it.
    fn mean_bend(&self, sides: &Seam, [t0, t1]: [f64; 2]) -> f64 {
        let count = sides.len() as f64;
        let (mut heights, mut sums, mut off, mut bend) = ([0.0; 2], [DVec3::ZERO; 2], 0.0, 0.0);
        for side in sides {
            let ends = [t0, t1].map(|t| Wedge::between(&side[0], &side[1], t));
            off += self.height_bend(&ends, f64::INFINITY) / count;
            if !self.vectors {
                bend += direction_bend(&ends.map(|w| w.normal)) / count;
                for (k, end) in ends.iter().enumerate() {
                    heights[k] += self.height(end).x / count;
                    sums[k] += unit(end.normal) / count;
                }
            }
        }
        if self.vectors {
            return off;
        }
        product_bend(&heights, &sums.map(unit), off, direction_bend_near(&sums, bend))
    }

    /// How far the mean of the sides of a torn edge is from what the face says there, from linear, between two places.
    ///
    /// Where all sides have the same normals, only heights differ, and their difference goes along the normal.
    fn difference_bend(&self, sides: &Seam, own: [Wedge; 2], [t0, t1]: [f64; 2]) -> f64 {
        let ends = [t0, t1].map(|t| Wedge::between(&own[0], &own[1], t));
        let same = sides.iter().all(|s| s[0].normal == own[0].normal && s[1].normal == own[1].normal);
        if self.vectors || !same {
            return self.own_bend(&ends, f64::INFINITY) + self.mean_bend(sides, [t0, t1]);
        }
        let count = sides.len() as f64;
        let mut off = self.height_bend(&ends, f64::INFINITY);
        let mut heights = ends.map(|end| -self.height(&end).x);
        for side in sides {
            let ends = [t0, t1].map(|t| Wedge::between(&side[0], &side[1], t));
            off += self.height_bend(&ends, f64::INFINITY) / count;
            (0..2).for_each(|k| heights[k] += self.height(&ends[k]).x / count);
        }
        let normals = ends.map(|end| end.normal);
        product_bend(&heights, &normals.map(unit), off, direction_bend(&normals))
    }

    /// How far what is blended from torn edges is from linear over a part of a face.
    pub(super) fn tear_bend(&self, face: &Face, places: &[Place; 3]) -> f64 {
        let mut out = 0.0;
        if !self.is_torn(face) {
            return out;
        }
        for k in 0..3 {
            let Some((sides, [a, b])) = self.seam(face, k) else { continue };
            let (mut t0, mut t1, mut weight) = (1.0_f64, 0.0_f64, 0.0_f64);
            for place in places {
                let w = place[a] + place[b];
                if w > 0.0 {
                    let t = place[b] / w;
                    (t0, t1, weight) = (t0.min(t), t1.max(t), weight.max(w));
                }
            }
            if t0 < t1 {
                let off = self.difference_bend(sides, [face.wedges[a], face.wedges[b]], [t0, t1]);
                // Of three corners each may be off by it, and what lies between.
                out += 2.0 * weight * off;
            }
        }
        out
    }

    /// How far the surface is from the triangle through its points at these places of a face, at most. What exceeds `enough`
    /// may be too small, but does so, too.
    pub(super) fn bend(&self, face: &Face, places: &[Place; 3], enough: f64) -> f64 {
        let torn = self.tear_bend(face, places);
        if torn > enough {
            return torn;
        }
        let wedges = places.map(|p| self.wedge(face, p));
        torn + self.own_bend(&wedges, enough - torn)
    }

    /// What rounding adds to any distance between points and bounds: a few hundred roundings of each of the largest numbers.
    pub(super) fn rounding(&self) -> f64 {
        let reach = self.points.iter().fold(0.0_f64, |most, p| most.max(p.abs().max_element()));
        let [lo, hi] = self.map.range.map(DVec3::from_array);
        let mid = DVec3::splat(self.midlevel);
        let tall = self.scale.abs() * (lo - mid).abs().max((hi - mid).abs()).length();
        let steep = self.scale.abs() * (hi - lo).length();
        let mut far = 1.0_f64;
        for face in &self.faces {
            for wedge in &face.wedges {
                let [x, y] = self.map.place(wedge.uv);
                far = far.max(x.abs()).max(y.abs());
            }
        }
        (reach + tall + steep * far) * 256.0 * f64::EPSILON
    }
}
