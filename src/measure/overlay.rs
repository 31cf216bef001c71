//! Overlaying the triangles of one surface with a surface that is nearly the same: a simplified surface with the
//! one before.
//!
//! A piece of a triangle starts anywhere on the other surface and walks across edges towards its centre. A piece
//! that straddles an edge is cut by the plane that bisects the angle there, and each part walks on. At the end each
//! part lies over one triangle, to which its distance is largest at a corner. The walk finds good triangles fast;
//! the bound holds for any triangle. Where the walk ends too far off, `cover` bounds the part by all triangles
//! around.
//!
//! docs/numerics.md has the proof and its rounding.

use std::cell::OnceCell;

use super::bvh::Bvh;
use super::closest::{Triangle, Vec3, cross, dot, normal, squared_distance, sub};
use super::cover::Cover;
use super::hausdorff::BoundOptions;
use super::piece::{CORNERS, Corner, MOST_CUTS, Piece};
use super::tree::TriangleTree;

/// No triangle.
pub const NO_TRIANGLE: u32 = u32::MAX;
/// Triangles that a walk of a point or a piece crosses at most.
const MOST_STEPS: u32 = 48;
/// A piece that crosses an edge by less than this part of the allowed distance is not cut.
pub const BESIDE: f64 = 0.1;
/// Pieces of a triangle that are halved and walk again before `cover` takes over.
const TRIES: u32 = 16;
/// Neighbours whose normals have a cosine below this are folded over: no plane bisects their angle well.
const FOLDED: f64 = -0.9;

/// A plane through an edge of a triangle: the offset of a point outwards.
#[derive(Clone, Copy, Debug)]
struct Side {
    normal: Vec3,
    offset: f64,
}

impl Side {
    fn of(&self, p: Vec3) -> f64 {
        dot(self.normal, p) - self.offset
    }
}

/// Dot products of the two of a triangle with the way from its first corner give the shares of the other two, for points
/// that lie about over it.
type Dual = [Vec3; 2];

fn dual([a, b, c]: Triangle) -> Dual {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let (bb, bc, cc) = (dot(ab, ab), dot(ab, ac), dot(ac, ac));
    let area = bb * cc - bc * bc;
    let scale = if area > 0.0 { 1.0 / area } else { 0.0 };
    let scale = if scale.is_finite() { scale } else { 0.0 };
    let of = |u: f64, v: f64| std::array::from_fn(|k| (u * ab[k] + v * ac[k]) * scale);
    [of(cc, -bc), of(-bc, bb)]
}

/// A triangle in the form that distances need. It is read in place: values copied one by one and then loaded in
/// pairs would stall on store forwarding.
struct Plate<'a> {
    triangle: &'a Triangle,
    dual: &'a Dual,
}

impl Plate<'_> {
    /// The shares of the second and third corner in some point of the triangle, the nearest for what lies over it, and
    /// the way from there, for each of some points: whatever rounding made of the shares, they are those of a point
    /// of the triangle. Without branches, so that two points take hardly longer than one.
    fn shares<const N: usize>(&self, points: [Vec3; N]) -> [([f64; 2], Vec3); N] {
        let ([a, b, c], [to_b, to_c]) = (self.triangle, self.dual);
        let (ab, ac) = (sub(*b, *a), sub(*c, *a));
        let ways = points.map(|p| sub(p, *a));
        let positive = |x: f64| if x > 0.0 { x } else { 0.0 };
        let shares = ways.map(|d| [positive(dot(*to_b, d)), positive(dot(*to_c, d))]);
        let scale = shares.map(|[v, w]| 1.0 / if v + w > 1.0 { v + w } else { 1.0 });
        std::array::from_fn(|i| {
            let ([v, w], d) = (shares[i].map(|share| share * scale[i]), ways[i]);
            ([v, w], std::array::from_fn(|k| d[k] - v * ab[k] - w * ac[k]))
        })
    }

    /// The largest squared distance of some points to those points of the triangle, if none is above `enough`.
    fn farthest(&self, points: &[Vec3], enough: f64) -> Option<f64> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx") {
            // SAFETY: the processor has AVX.
            return unsafe { self.farthest_avx(points, enough) };
        }
        self.farthest_of_pairs(points, enough)
    }

    fn farthest_of_pairs(&self, points: &[Vec3], enough: f64) -> Option<f64> {
        let mut most = 0.0;
        for pair in points.chunks(2) {
            for d in self.shares([pair[0], *pair.last()?]).map(|(_, rest)| dot(rest, rest)) {
                if d > enough || d.is_nan() {
                    return None;
                }
                most = if d > most { d } else { most };
            }
        }
        Some(most)
    }

    /// Four at a time, by the same operations in the same order: the result has the same bits.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx")]
    fn farthest_avx(&self, points: &[Vec3], enough: f64) -> Option<f64> {
        use std::arch::x86_64::*;
        // As `if x > y { x } else { y }`, where x is no number too.
        let larger = |x, y| _mm256_max_pd(x, y);
        let dot = |a: [__m256d; 3], b: [__m256d; 3]| {
            let xy = _mm256_add_pd(_mm256_mul_pd(a[0], b[0]), _mm256_mul_pd(a[1], b[1]));
            _mm256_add_pd(xy, _mm256_mul_pd(a[2], b[2]))
        };
        let in_all = |v: &Vec3| v.each_ref().map(|x| _mm256_broadcast_sd(x));
        let [corner, b, c] = self.triangle.each_ref().map(in_all);
        let [to_b, to_c] = self.dual.each_ref().map(in_all);
        let [ab, ac]: [[__m256d; 3]; 2] =
            [b, c].map(|p| std::array::from_fn(|k| _mm256_sub_pd(p[k], corner[k])));
        let (one, allowed) = (_mm256_set1_pd(1.0), _mm256_set1_pd(enough));
        let mut most = _mm256_setzero_pd();
        for four in points.chunks(4) {
            // A lane without a point has the last one.
            let last = four.len() - 1;
            let [p, q, r, s] = [0, 1.min(last), 2.min(last), last].map(|i| four[i]);
            let way: [__m256d; 3] =
                std::array::from_fn(|k| _mm256_sub_pd(_mm256_set_pd(s[k], r[k], q[k], p[k]), corner[k]));
            let v = larger(dot(to_b, way), _mm256_setzero_pd());
            let w = larger(dot(to_c, way), _mm256_setzero_pd());
            let scale = _mm256_div_pd(one, larger(_mm256_add_pd(v, w), one));
            let (v, w) = (_mm256_mul_pd(v, scale), _mm256_mul_pd(w, scale));
            let rest: [__m256d; 3] = std::array::from_fn(|k| {
                let rest = _mm256_sub_pd(way[k], _mm256_mul_pd(v, ab[k]));
                _mm256_sub_pd(rest, _mm256_mul_pd(w, ac[k]))
            });
            let d = dot(rest, rest);
            let beyond = _mm256_cmp_pd::<_CMP_GT_OQ>(d, allowed);
            let no_number = _mm256_cmp_pd::<_CMP_UNORD_Q>(d, d);
            if _mm256_movemask_pd(_mm256_or_pd(beyond, no_number)) != 0 {
                return None;
            }
            most = larger(d, most);
        }
        let most = _mm_max_pd(_mm256_castpd256_pd128(most), _mm256_extractf128_pd::<1>(most));
        Some(_mm_cvtsd_f64(_mm_max_sd(most, _mm_unpackhi_pd(most, most))))
    }
}

/// A surface to overlay others with.
#[derive(Debug)]
pub struct Sheet {
    triangles: Vec<Triangle>,
    radii: Vec<f64>,
    /// Across the edge from corner k to the next one.
    neighbours: Vec<[u32; 3]>,
    sides: Vec<[Side; 3]>,
    duals: Vec<Dual>,
    tree: OnceCell<TriangleTree>,
    bvh: OnceCell<Bvh>,
}

impl Sheet {
    /// The sheet of triangles, each of which stands for something within its radius. Corners with the same number
    /// are the same point; numbers start at 0 and leave out few.
    pub fn new(triangles: Vec<Triangle>, corners: &[[u32; 3]], radii: Vec<f64>) -> Self {
        let neighbours = neighbours(corners);
        let normals: Vec<Vec3> = triangles.iter().map(|t| unit(normal(*t))).collect();
        let mut sides: Vec<[Side; 3]> = Vec::with_capacity(triangles.len());
        for (i, t) in triangles.iter().enumerate() {
            let side = |k: usize| {
                let (n, other) = (normals[i], neighbours[i][k] as usize);
                // Two faces that run along an edge in opposite directions share the plane there.
                if let Some(twin) = sides.get(other)
                    && let Some(j) = (0..3).find(|j| neighbours[other][*j] as usize == i)
                    && corners[other][j] == corners[i][(k + 1) % 3]
                    && corners[other][(j + 1) % 3] == corners[i][k]
                {
                    let Side { normal, offset } = twin[j];
                    return Side { normal: normal.map(|x| -x), offset: -offset };
                }
                let m = normals.get(other).filter(|m| dot(n, **m) > FOLDED);
                let n = m.map_or(n, |m| std::array::from_fn(|axis| n[axis] + m[axis]));
                let outwards = unit(cross(sub(t[(k + 1) % 3], t[k]), n));
                Side { normal: outwards, offset: dot(outwards, t[k]) }
            };
            let of_triangle = std::array::from_fn(side);
            sides.push(of_triangle);
        }
        let duals = triangles.iter().map(|t| dual(*t)).collect();
        Self { triangles, radii, neighbours, sides, duals, tree: OnceCell::new(), bvh: OnceCell::new() }
    }

    fn plate(&self, t: u32) -> Plate<'_> {
        Plate { triangle: &self.triangles[t as usize], dual: &self.duals[t as usize] }
    }

    /// Its triangles.
    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// The radius of a triangle.
    pub fn radius(&self, t: u32) -> f64 {
        self.radii[t as usize]
    }

    /// Some point of a triangle, the nearest for what lies over it: its barycentric coordinates, and the way from there
    /// to `p`.
    pub fn place(&self, p: Vec3, t: u32) -> ([f64; 3], Vec3) {
        let [([v, w], rest)] = self.plate(t).shares([p]);
        ([(1.0 - v - w).max(0.0), v, w], rest)
    }

    /// The triangle nearest to a point, but for f32 rounding.
    pub fn nearest(&self, p: Vec3, near: u32) -> u32 {
        let tree = self.tree.get_or_init(|| {
            TriangleTree::of(self.triangles.iter().map(|t| t.map(|p| p.map(|x| x as f32))).collect())
        });
        tree.nearest(p.map(|x| x as f32), near)
    }

    fn bvh(&self) -> &Bvh {
        self.bvh.get_or_init(|| Bvh::with_radii(&self.triangles, &self.radii))
    }

    /// Across each edge of a triangle, from corner k to the next one; [`NO_TRIANGLE`] where there is none.
    pub fn neighbours(&self, t: u32) -> [u32; 3] {
        self.neighbours[t as usize]
    }

    /// A triangle that a point lies about over: walks there from `start`.
    pub fn locate(&self, p: Vec3, start: u32) -> u32 {
        self.walk(p, start).unwrap_or_else(|| self.nearest(p, start))
    }

    /// Walks from a triangle towards a point; `None` where the walk fails.
    fn walk(&self, p: Vec3, start: u32) -> Option<u32> {
        let (mut at, mut from) = (start, start);
        for _ in 0..MOST_STEPS {
            let (mut most, mut next) = (0.0, at);
            for (side, neighbour) in self.sides[at as usize].iter().zip(self.neighbours[at as usize]) {
                let side = side.of(p);
                if side > most {
                    (most, next) = (side, neighbour);
                }
            }
            if next == at || next == from {
                // Two triangles that send it to each other both hold it.
                return Some(at);
            }
            if next == NO_TRIANGLE {
                return None;
            }
            (from, at) = (at, next);
        }
        None
    }
}

/// Receives the parts of a piece that is overlaid with a sheet.
pub trait Lay<C> {
    /// Its result for a part.
    type Said;

    /// Accepts a part over a triangle, if it is near enough.
    fn accept(&mut self, part: &Piece<C>, at: u32) -> Option<Self::Said>;

    /// A part that crosses an edge by no more is not cut.
    fn beside(&self) -> f64;

    /// Receives a part that ended its walk over a triangle that is not near enough.
    fn bring(&mut self, part: &Piece<C>, at: u32) -> Self::Said;

    /// Combines the results of the two parts of a cut.
    fn join(&mut self, a: (&Piece<C>, Self::Said), b: (&Piece<C>, Self::Said)) -> Self::Said;
}

impl Sheet {
    /// Walks a piece to its triangle, after `steps` steps.
    pub fn spread<C: Corner, L: Lay<C>>(
        &self,
        lay: &mut L,
        piece: &Piece<C>,
        at: u32,
        steps: u32,
    ) -> L::Said {
        match lay.accept(piece, at) {
            Some(said) => said,
            None if steps == MOST_STEPS => lay.bring(piece, at),
            None => self.part(lay, piece, at, steps, 0),
        }
    }

    /// The same for a piece that was cut at the sides before `first` of a triangle.
    fn part<C: Corner, L: Lay<C>>(
        &self,
        lay: &mut L,
        piece: &Piece<C>,
        at: u32,
        steps: u32,
        first: usize,
    ) -> L::Said {
        let beside = lay.beside();
        for k in first..3 {
            let next = self.neighbours[at as usize][k];
            if next == NO_TRIANGLE {
                continue;
            }
            let side = &self.sides[at as usize][k];
            let mut out = [0.0; CORNERS];
            let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
            for (s, p) in out.iter_mut().zip(piece.corners()) {
                *s = side.of(p.position());
                least = if *s < least { *s } else { least };
                most = if *s > most { *s } else { most };
            }
            if most <= beside {
                continue;
            }
            if least >= -beside {
                return self.spread(lay, piece, next, steps + 1);
            }
            if piece.cuts >= MOST_CUTS {
                continue;
            }
            let (mut inside, mut outside) = (piece.child(), piece.child());
            if piece.cut(&out, &mut inside, &mut outside).is_some() {
                let said = match lay.accept(&inside, at) {
                    Some(said) => said,
                    None => self.part(lay, &inside, at, steps, k + 1),
                };
                let other = self.spread(lay, &outside, next, steps + 1);
                return lay.join((&inside, said), (&outside, other));
            }
        }
        lay.bring(piece, at)
    }
}

/// The bounds of what was overlaid so far.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    goal: BoundOptions,
    /// A lower bound of the largest distance.
    pub lower: f64,
    /// An upper bound of the largest distance.
    pub upper: f64,
    /// The goal was met everywhere.
    pub complete: bool,
}

impl Bounds {
    /// Nothing overlaid yet.
    pub fn new(goal: BoundOptions) -> Self {
        Self { goal, lower: 0.0, upper: 0.0, complete: true }
    }

    /// The distance that the next part may have.
    pub fn limit(&self) -> f64 {
        self.goal.floor.max(self.lower * (1.0 + self.goal.slack))
    }
}

/// Overlays pieces with a surface.
pub struct Overlay<'a> {
    sheet: &'a Sheet,
    /// The triangle of the last piece: a good start for one nearby.
    pub hint: u32,
    /// The parts of the last piece with their labels, where these differ.
    pub parts: Vec<(Piece, u32)>,
}

impl<'a> Overlay<'a> {
    /// For a sheet that has triangles.
    pub fn new(sheet: &'a Sheet) -> Self {
        Self { sheet, hint: 0, parts: Vec::new() }
    }

    /// Bounds the distance of a piece, which stands for a surface within `extra` of it. `label` is called with each
    /// triangle that bounds a part and with the bound. Returns the label if all parts have the same; otherwise
    /// `parts` has them, as few as the cuts allow.
    pub fn lay(
        &mut self,
        bounds: &mut Bounds,
        piece: &Piece,
        extra: f64,
        label: impl FnMut(u32, f64) -> u32,
    ) -> Option<u32> {
        bounds.lower = bounds.lower.max(extra);
        self.parts.clear();
        let sheet = self.sheet;
        self.hint = sheet.locate(piece.center(), self.hint);
        sheet.spread(
            &mut Laying { sheet, parts: &mut self.parts, bounds, extra, tries: TRIES, label },
            piece,
            self.hint,
            0,
        )
    }
}

/// What all parts of a piece share while it is overlaid.
struct Laying<'a, 'b, L> {
    sheet: &'a Sheet,
    parts: &'b mut Vec<(Piece, u32)>,
    bounds: &'b mut Bounds,
    extra: f64,
    tries: u32,
    label: L,
}

impl<L: FnMut(u32, f64) -> u32> Laying<'_, '_, L> {
    fn allowed(&self) -> f64 {
        self.bounds.limit() - self.extra
    }

    /// Accepts a part with its bound.
    fn take(&mut self, bound: f64, at: u32) -> Option<u32> {
        let bound = bound + self.extra;
        self.bounds.upper = self.bounds.upper.max(bound);
        Some((self.label)(at, bound))
    }

    /// The largest distance of a piece to a triangle, with the triangle's radius, if it is not more than allowed.
    fn within(&self, piece: &Piece, at: u32) -> Option<f64> {
        let radius = self.sheet.radius(at);
        let reach = self.allowed() - radius;
        if reach < 0.0 {
            return None;
        }
        let most = self.sheet.plate(at).farthest(piece.corners(), reach * reach)?;
        Some(most.sqrt() + radius)
    }

    /// The largest distance of a piece to a triangle, with the triangle's radius.
    fn distance(&self, piece: &Piece, at: u32) -> f64 {
        let t = self.sheet.triangles[at as usize];
        let most = piece.corners().iter().fold(0.0f64, |most, p| most.max(squared_distance(*p, t)));
        most.sqrt() + self.sheet.radius(at)
    }
}

impl<L: FnMut(u32, f64) -> u32> Lay<Vec3> for Laying<'_, '_, L> {
    /// The label, if it is that of the whole part.
    type Said = Option<u32>;

    fn accept(&mut self, part: &Piece, at: u32) -> Option<Option<u32>> {
        self.within(part, at).map(|bound| self.take(bound, at))
    }

    fn beside(&self) -> f64 {
        self.allowed() * BESIDE
    }

    /// The surface may be this far, or the walk may have failed.
    fn bring(&mut self, piece: &Piece, mut at: u32) -> Option<u32> {
        let sheet = self.sheet;
        let to = |p: Vec3, t: u32| squared_distance(p, sheet.triangles[t as usize]).sqrt() + sheet.radius(t);
        let mut best = self.distance(piece, at);
        // The farthest corner.
        let worst = piece
            .corners()
            .iter()
            .fold(piece.corners[0], |worst, p| if to(*p, at) > to(worst, at) { *p } else { worst });
        let near = sheet.nearest(worst, at);
        let found = to(worst, near).min(to(worst, at)) + self.extra;
        self.bounds.lower = self.bounds.lower.max(found);
        if best > self.allowed() && near != at {
            let other = self.distance(piece, near);
            if other < best {
                (best, at) = (other, near);
            }
        }
        if best <= self.allowed() {
            return self.take(best, at);
        }
        if self.tries > 0 && piece.cuts < MOST_CUTS {
            // Each half starts near itself.
            self.tries -= 1;
            let (first, second) = piece.halves();
            let label = sheet.spread(self, &first, sheet.nearest(first.center(), at), 0);
            let Some(second) = second else { return label };
            let other = sheet.spread(self, &second, sheet.nearest(second.center(), at), 0);
            return self.join((&first, label), (&second, other));
        }
        let bvh = sheet.bvh();
        let always = || true;
        let mut cover = Cover::new(bvh, self.bounds.goal, self.bounds.lower, &always);
        let known = self.parts.len();
        cover.piece(*piece, self.extra, &mut |part, place| {
            self.parts.push((*part, bvh.id(place) as u32));
        });
        for (_, at) in &mut self.parts[known..] {
            *at = (self.label)(*at, cover.upper);
        }
        self.bounds.lower = cover.lower;
        self.bounds.upper = self.bounds.upper.max(cover.upper);
        self.bounds.complete &= cover.complete;
        let (_, label) = *self.parts.get(known)?;
        if self.parts[known..].iter().any(|(_, other)| *other != label) {
            return None;
        }
        self.parts.truncate(known);
        Some(label)
    }

    /// The label of two parts, if they have one and the same; otherwise they are parts for good.
    fn join(&mut self, a: (&Piece, Option<u32>), b: (&Piece, Option<u32>)) -> Option<u32> {
        if a.1 == b.1 {
            return a.1;
        }
        self.parts.extend([a, b].into_iter().filter_map(|(piece, label)| Some((*piece, label?))));
        None
    }
}

fn unit(v: Vec3) -> Vec3 {
    let length = dot(v, v).sqrt();
    let scale = if length > 0.0 { 1.0 / length } else { 0.0 };
    if scale.is_finite() { v.map(|x| x * scale) } else { [0.0; 3] }
}

/// For each triangle and edge another triangle that runs along it the other way, or else the same way; [`NO_TRIANGLE`] where
/// there is none. Two of several: any.
fn neighbours(corners: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let points = corners.iter().flatten().max().map_or(0, |v| *v as usize + 1);
    // Half-edges by their smaller end, counted two places ahead, so that filling leaves the starts where they belong.
    let ends = |f: &[u32; 3], k: usize| (f[k], f[(k + 1) % 3]);
    let mut starts = vec![0u32; points + 2];
    for f in corners {
        (0..3).for_each(|k| starts[f[k].min(f[(k + 1) % 3]) as usize + 2] += 1);
    }
    for i in 2..starts.len() {
        starts[i] += starts[i - 1];
    }
    // The larger end above the triangle and its corner: numbers compare faster than pairs.
    let mut halves = vec![0u64; 3 * corners.len()];
    for (i, f) in corners.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = ends(f, k);
            let at = &mut starts[a.min(b) as usize + 1];
            halves[*at as usize] = u64::from(a.max(b)) << 32 | (4 * i + k) as u64;
            *at += 1;
        }
    }
    let mut out = vec![[NO_TRIANGLE; 3]; corners.len()];
    let of = |half: u64| (half as u32 as usize / 4, half as usize % 4);
    let mut join = |same: &[u64]| {
        if let [a, b] = *same {
            let ((t, k), (u, j)) = (of(a), of(b));
            if t != u {
                (out[t][k], out[u][j]) = (u as u32, t as u32);
            }
            return;
        }
        for (i, half) in same.iter().enumerate() {
            let (t, k) = of(*half);
            let start = corners[t][k];
            let others = (1..same.len()).map(|j| of(same[(i + j) % same.len()]));
            let opposite = others.clone().find(|(u, j)| *u != t && corners[*u][*j] != start);
            let other = opposite.or_else(|| others.clone().find(|(u, _)| *u != t));
            out[t][k] = other.map_or(NO_TRIANGLE, |(u, _)| u as u32);
        }
    };
    for bucket in 0..points {
        let uses = &mut halves[starts[bucket] as usize..starts[bucket + 1] as usize];
        uses.sort_unstable();
        uses.chunk_by(|x, y| x >> 32 == y >> 32).for_each(&mut join);
    }
    out
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;

    #[test]
    fn four_at_a_time_give_the_same_bits() {
        if !std::arch::is_x86_feature_detected!("avx") {
            eprintln!("skipped: the processor has no AVX");
            return;
        }
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let (mut within, mut beyond) = (0, 0);
        for round in 0..20_000 {
            let mut point = || -> Vec3 { std::array::from_fn(|_| random()) };
            let [a, b, mut c] = std::array::from_fn(|_| point());
            let mut points: Vec<Vec3> = (0..3 + round % 6).map(|_| point()).collect();
            match round % 16 {
                0 => c = b,
                1 => points[round % 3][1] = f64::NAN,
                2 => points[2] = a,
                3 => points[round % 3][0] *= 1.0e200,
                _ => {}
            }
            let triangle = [a, b, c];
            let plate = Plate { triangle: &triangle, dual: &dual(triangle) };
            let enough = if round % 3 == 0 { f64::INFINITY } else { 0.5 * random() + 0.5 };
            let pairs = plate.farthest_of_pairs(&points, enough);
            // SAFETY: the processor has AVX, see above.
            let fours = unsafe { plate.farthest_avx(&points, enough) };
            assert_eq!(pairs.map(f64::to_bits), fours.map(f64::to_bits), "{points:?} over {a:?} {b:?} {c:?}");
            *(if pairs.is_some() { &mut within } else { &mut beyond }) += 1;
        }
        assert!(within > 5_000 && beyond > 5_000, "{within} {beyond}");
    }
}
