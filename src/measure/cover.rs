//! How far a whole triangle is from a surface: an upper bound, and points that come near it.
//!
//! The distance to *one* triangle t is a convex function, so that over a convex piece of the plane it is largest at a
//! corner. A triangle is therefore overlaid with the surface: what lies over t (inside the prism on it, or a little
//! beside it) is cut off and bounded by t, and the rest goes on to the next triangle of the surface. What nobody
//! takes is measured at its corners and its centre, which raises the lower bound, and cut in two (branch and bound:
//! Guthe, Borodin and Klein, "Fast and accurate Hausdorff distance calculation between meshes", 2005; Tang, Lee and
//! Kim, "Interactive Hausdorff distance computation for general polygonal models", 2009).
//!
//! The proof and its rounding stand in docs/numerics.md.

use super::bvh::Bvh;
use super::closest::{Triangle, Vec3, along, cross, dot, normal, squared, squared_distance, sub};

/// Corners of a piece at most; a piece that would have more is halved instead.
const CORNERS: usize = 8;
/// Cuts that led to a piece at most. docs/numerics.md: each moves the surface by rounding.
const MOST_CUTS: u8 = 100;
/// Triangles to overlay a piece with; a piece that is near to more is halved first.
const NEARBY: usize = 40;
/// Pieces of one triangle during an overlay.
const PIECES: usize = 48;
/// Pieces to look at before asking whether to go on.
const STEPS_BETWEEN_ASKING: u64 = 1_000;
/// How far beside its prism a triangle takes, in parts of the distance allowed. Each is tried where the one before
/// takes corners too far out, at sharp angles.
const BESIDE: [f64; 3] = [0.6, 0.2, 0.002];

/// A convex polygon.
#[derive(Clone, Copy, Debug)]
struct Piece {
    corners: [Vec3; CORNERS],
    count: u8,
    cuts: u8,
    /// Overlaid already, without success.
    left_over: bool,
}

impl Piece {
    fn new(t: Triangle) -> Self {
        let mut corners = [[0.0; 3]; CORNERS];
        corners[..3].copy_from_slice(&t);
        Self { corners, count: 3, cuts: 0, left_over: false }
    }

    fn corners(&self) -> &[Vec3] {
        &self.corners[..usize::from(self.count)]
    }

    fn center(&self) -> Vec3 {
        let share = 1.0 / f64::from(self.count);
        self.corners().iter().fold([0.0; 3], |sum, p| along(sum, *p, share))
    }

    /// Greatest squared distance of a corner from a point.
    fn squared_radius(&self, p: Vec3) -> f64 {
        self.corners().iter().fold(0.0, |most, c| most.max(squared(p, *c)))
    }

    fn push(&mut self, p: Vec3) -> Option<()> {
        *self.corners.get_mut(usize::from(self.count))? = p;
        self.count += 1;
        Some(())
    }

    /// No corners yet, after one more cut.
    fn child(&self) -> Self {
        let cuts = self.cuts.saturating_add(1);
        Self { corners: [[0.0; 3]; CORNERS], count: 0, cuts, left_over: false }
    }

    /// Adds to `inside` the part where `sides`, one value per corner and linear between them, is up to 0, and to
    /// `outside` that where it is above. `None` where a part would have too many corners.
    fn cut(&self, sides: &[f64; CORNERS], inside: &mut Self, outside: &mut Self) -> Option<()> {
        let count = usize::from(self.count);
        for i in 0..count {
            let j = if i + 1 == count { 0 } else { i + 1 };
            let (a, b) = (sides[i], sides[j]);
            if a <= 0.0 {
                inside.push(self.corners[i])?
            } else {
                outside.push(self.corners[i])?
            }
            if (a <= 0.0) != (b <= 0.0) {
                let t = (a / (a - b)).clamp(0.0, 1.0);
                let p = along(self.corners[i], sub(self.corners[j], self.corners[i]), t);
                inside.push(p)?;
                outside.push(p)?;
            }
        }
        Some(())
    }

    /// Two halves, across the longest diagonal. A piece too small to be cut gives itself and nothing.
    fn halves(&self) -> (Self, Option<Self>) {
        let corners = self.corners();
        let (mut far, mut ends) = (0.0, (0, 0));
        for i in 0..corners.len() {
            for j in i + 1..corners.len() {
                let d = squared(corners[i], corners[j]);
                if d > far {
                    (far, ends) = (d, (i, j));
                }
            }
        }
        let (a, b) = (corners[ends.0], corners[ends.1]);
        let (axis, middle) = (sub(b, a), along(a, sub(b, a), 0.5));
        let mut sides = [0.0; CORNERS];
        sides.iter_mut().zip(corners).for_each(|(s, p)| *s = dot(axis, sub(*p, middle)));
        let (mut first, mut second) = (self.child(), self.child());
        if self.cut(&sides, &mut first, &mut second).is_none() {
            // Too many corners for a cut: the fan from the first corner, in two.
            (first, second) = (self.child(), self.child());
            let half = corners.len() / 2;
            corners[..=half].iter().for_each(|p| first.push(*p).unwrap_or(()));
            corners[half..].iter().chain(&corners[..1]).for_each(|p| second.push(*p).unwrap_or(()));
        }
        if first.count == 0 || second.count == 0 {
            return (Self { cuts: MOST_CUTS, ..*self }, None);
        }
        (first, Some(second))
    }
}

/// How near a bound should come.
#[derive(Clone, Copy, Debug)]
pub(super) struct Goal {
    /// Upper bounds up to this are as good as zero.
    pub floor: f64,
    /// Upper bounds up to (1 + slack) times the lower bound are good enough.
    pub slack: f64,
    /// Pieces of a triangle to look at more closely, at most.
    pub budget: u64,
}

/// The bounds of what was covered so far, and what is used over and over on the way.
pub(super) struct Cover<'a> {
    surface: &'a Bvh,
    goal: Goal,
    /// Asked now and then; after `false` nothing is worth having.
    go_on: &'a dyn Fn() -> bool,
    /// The largest distance at a point.
    pub lower: f64,
    /// That point.
    pub witness: Option<Vec3>,
    /// No point of what was covered is farther from the surface.
    pub upper: f64,
    /// Pieces that were looked at more closely.
    pub steps: u64,
    /// The goal was met everywhere.
    pub complete: bool,
    hint: usize,
    stack: Vec<Piece>,
    nearby: Vec<u32>,
    now: Vec<Piece>,
    rest: Vec<Piece>,
}

impl<'a> Cover<'a> {
    /// Nothing covered. `lower` is a distance known to occur.
    pub(super) fn new(surface: &'a Bvh, goal: Goal, lower: f64, go_on: &'a dyn Fn() -> bool) -> Self {
        Self {
            surface,
            goal,
            go_on,
            lower,
            witness: None,
            upper: 0.0,
            steps: 0,
            complete: true,
            hint: 0,
            stack: Vec::new(),
            nearby: Vec::new(),
            now: Vec::new(),
            rest: Vec::new(),
        }
    }

    /// What is good enough.
    fn limit(&self) -> f64 {
        self.goal.floor.max(self.lower * (1.0 + self.goal.slack))
    }

    /// Measures at a point of what stands `extra` farther off; raises the lower bound if that is larger.
    pub(super) fn probe(&mut self, p: Vec3, extra: f64) -> f64 {
        let enough = self.limit() / (1.0 + self.goal.slack) - extra;
        self.measure(p, extra, enough).0
    }

    /// The distance at a point, or anything up to `enough`, with `extra`; and the place it was measured to.
    fn measure(&mut self, p: Vec3, extra: f64, enough: f64) -> (f64, usize) {
        let Some(nearest) = self.surface.nearest(p, f64::INFINITY, enough, self.hint) else {
            return (f64::INFINITY, usize::MAX);
        };
        self.hint = nearest.place;
        let distance = nearest.distance + extra;
        if distance > self.lower && nearest.distance > enough {
            self.lower = distance;
            self.witness = Some(p);
        }
        (distance, nearest.place)
    }

    /// Covers a triangle that stands for something within `extra` of it.
    pub(super) fn triangle(&mut self, triangle: Triangle, extra: f64) {
        let mut budget = self.goal.budget;
        self.stack.push(Piece::new(triangle));
        while let Some(piece) = self.stack.pop() {
            let reach = self.limit() - extra;
            if !piece.left_over && reach > 0.0 && self.overlay(&piece, reach, extra) {
                continue;
            }
            self.steps += 1;
            if self.steps.is_multiple_of(STEPS_BETWEEN_ASKING) && !(self.go_on)() {
                self.stack.clear();
                self.complete = false;
                self.upper = f64::INFINITY;
                return;
            }
            let bound = self.bound(&piece, extra);
            if bound <= self.limit() {
                self.upper = self.upper.max(bound);
                continue;
            }
            if budget == 0 || piece.cuts >= MOST_CUTS {
                self.upper = self.upper.max(bound);
                self.complete = false;
                continue;
            }
            budget -= 1;
            let (first, second) = piece.halves();
            self.stack.extend(second);
            self.stack.push(first);
        }
    }

    /// A bound of a piece from the triangles nearest to its centre and, if that is not enough, to its corners.
    fn bound(&mut self, piece: &Piece, extra: f64) -> f64 {
        let center = piece.center();
        let (distance, place) = self.measure(center, extra, -1.0);
        let mut bound = distance + piece.squared_radius(center).sqrt();
        bound = bound.min(self.to_triangle(piece, place) + extra);
        if bound <= self.limit() {
            return bound;
        }
        for corner in piece.corners() {
            let (_, place) = self.measure(*corner, extra, -1.0);
            bound = bound.min(self.to_triangle(piece, place) + extra);
        }
        bound
    }

    /// The largest distance of a piece to one triangle.
    fn to_triangle(&self, piece: &Piece, place: usize) -> f64 {
        if place == usize::MAX {
            return f64::INFINITY;
        }
        let t = self.surface.triangle(place);
        let most = piece.corners().iter().fold(0.0f64, |most, p| most.max(squared_distance(*p, t)));
        most.sqrt() + self.surface.radius(place)
    }

    /// Overlays a piece with the triangles around it; what they leave goes onto the stack. False, and nothing done,
    /// where there are too many of them.
    fn overlay(&mut self, piece: &Piece, reach: f64, extra: f64) -> bool {
        if !self.surface.around(piece.corners(), reach, NEARBY, &mut self.nearby) {
            return false;
        }
        self.now.clear();
        self.now.push(*piece);
        let [a, b, c] = [0, 1, 2].map(|k| piece.corners[k]);
        let around = Prism::new([a, b, c], reach);
        for place in &self.nearby {
            let place = *place as usize;
            if piece.count == 3 && around.is_beside(&self.surface.triangle(place)) {
                continue;
            }
            let radius = self.surface.radius(place);
            let allowed = reach - radius;
            if allowed <= 0.0 {
                continue;
            }
            let prism = Prism::new(self.surface.triangle(place), allowed);
            // What is left of a piece lies beside this triangle: going backwards, it is not looked at again.
            for i in (0..self.now.len()).rev() {
                if let Some(most) = prism.take(&self.now[i], &mut self.rest) {
                    self.upper = self.upper.max(most.sqrt() + radius + extra);
                    self.now.swap_remove(i);
                    self.now.append(&mut self.rest);
                }
            }
            if self.now.is_empty() || self.now.len() > PIECES {
                break;
            }
        }
        self.stack.extend(self.now.iter().map(|piece| Piece { left_over: true, ..*piece }));
        true
    }
}

/// What lies over a triangle.
struct Prism {
    triangle: Triangle,
    /// Outwards through the edges; not unit vectors, zero for degenerate triangles.
    outwards: [Vec3; 3],
    lengths: [f64; 3],
    allowed: f64,
}

impl Prism {
    fn new(triangle: Triangle, allowed: f64) -> Self {
        let n = normal(triangle);
        let [a, b, c] = triangle;
        let outwards = [cross(sub(b, a), n), cross(sub(c, b), n), cross(sub(a, c), n)];
        Self { triangle, outwards, lengths: outwards.map(|o| dot(o, o).sqrt()), allowed }
    }

    /// True where a triangle lies beside one of the sides, farther than allowed.
    fn is_beside(&self, other: &Triangle) -> bool {
        (0..3).any(|k| {
            let beside = self.lengths[k] * self.allowed;
            other.iter().all(|p| dot(self.outwards[k], sub(*p, self.triangle[k])) > beside)
        })
    }

    /// The largest squared distance of a piece, if it is allowed.
    fn squared_allowed(&self, piece: &Piece) -> Option<f64> {
        let limit = self.allowed * self.allowed;
        let mut most = 0.0;
        for p in piece.corners() {
            let d = squared_distance(*p, self.triangle);
            if d > most {
                most = d;
                if d > limit {
                    return None;
                }
            }
        }
        Some(most)
    }

    /// Takes what lies over the triangle within the distance allowed, and appends what is left of the piece to
    /// `rest`. Returns the largest squared distance of what was taken; `None` where that is nothing.
    fn take(&self, piece: &Piece, rest: &mut Vec<Piece>) -> Option<f64> {
        let degenerate = self.lengths == [0.0; 3];
        let mut far = false;
        for k in 0..3 {
            let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
            for p in piece.corners() {
                let side = dot(self.outwards[k], sub(*p, self.triangle[k]));
                least = if side < least { side } else { least };
                most = if side > most { side } else { most };
            }
            let allowed = self.lengths[k] * self.allowed;
            if least > allowed * BESIDE[0] {
                return None;
            }
            far |= most > allowed;
        }
        if !far || degenerate {
            let all = self.squared_allowed(piece);
            if all.is_some() || degenerate {
                return all;
            }
        }
        if piece.cuts >= MOST_CUTS - 3 {
            return None;
        }
        for beside in BESIDE {
            let part = self.carve(*piece, beside * self.allowed, rest);
            if part.is_some() {
                return part;
            }
            rest.clear();
        }
        None
    }

    /// Cuts along the three sides. `None`, with anything appended to `rest`, where what is inside is too far or nothing.
    fn carve(&self, piece: Piece, beside: f64, rest: &mut Vec<Piece>) -> Option<f64> {
        let mut inside = piece;
        for k in 0..3 {
            let mut sides = [0.0; CORNERS];
            let (mut any_in, mut any_out) = (false, false);
            for (s, p) in sides.iter_mut().zip(inside.corners()) {
                *s = dot(self.outwards[k], sub(*p, self.triangle[k])) - beside * self.lengths[k];
                any_in |= *s <= 0.0;
                any_out |= *s > 0.0;
            }
            if !any_in {
                return None;
            }
            if any_out {
                let mut part = inside.child();
                rest.push(inside.child());
                inside.cut(&sides, &mut part, rest.last_mut()?)?;
                inside = part;
            }
        }
        self.squared_allowed(&inside)
    }
}
