//! The distance of a whole triangle to a surface: an upper bound, and points that come near it.
//!
//! The distance to *one* triangle t is a convex function, so that over a convex piece of the plane it is largest at
//! a corner. A triangle is therefore overlaid with the surface. The part that lies over t (inside the prism on it,
//! or a little beside it) is cut off and bounded by t; the rest is tried with the next triangle of the surface. A
//! part that no triangle takes is measured at its corners and its centre, which raises the lower bound, and halved
//! (branch and bound: Guthe, Borodin and Klein, "Fast and accurate Hausdorff distance calculation between meshes",
//! 2005; Tang, Lee and Kim, "Interactive Hausdorff distance computation for general polygonal models", 2009).
//!
//! docs/numerics.md has the proof and its rounding.

use super::bvh::Bvh;
use super::closest::{Triangle, Vec3, cross, dot, normal, squared_distance, sub};
use super::hausdorff::BoundOptions;
use super::piece::{CORNERS, MOST_CUTS, Piece};

/// Triangles to overlay a piece with; a piece that is near to more is halved first.
const NEARBY: usize = 40;
/// Pieces of one triangle during an overlay.
const PIECES: usize = 48;
/// Pieces between two interrupt checks.
const STEPS_BETWEEN_ASKING: u64 = 1_000;
/// How far beside its prism a triangle takes parts, relative to the allowed distance. Each is tried where the one
/// before takes corners too far out, at sharp angles.
const BESIDE: [f64; 3] = [0.6, 0.2, 0.002];

/// The bounds of what was covered so far, and scratch buffers.
pub(super) struct Cover<'a> {
    surface: &'a Bvh,
    goal: BoundOptions,
    /// The interrupt check; after `false` the result is void.
    proceed: &'a dyn Fn() -> bool,
    /// The largest distance at a point.
    pub lower: f64,
    /// That point.
    pub witness: Option<Vec3>,
    /// An upper bound of the distance of every covered point.
    pub upper: f64,
    /// Pieces that were overlaid or halved.
    pub steps: u64,
    /// The goal was met everywhere.
    pub complete: bool,
    hint: usize,
    /// Pieces to do, and whether they were already overlaid without success.
    stack: Vec<(Piece, bool)>,
    nearby: Vec<u32>,
    now: Vec<Piece>,
    rest: Vec<Piece>,
}

impl<'a> Cover<'a> {
    /// Nothing covered. `lower` is a distance known to occur.
    pub(super) fn new(
        surface: &'a Bvh,
        goal: BoundOptions,
        lower: f64,
        proceed: &'a dyn Fn() -> bool,
    ) -> Self {
        Self {
            surface,
            goal,
            proceed,
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

    /// The distance that needs no better bound.
    fn limit(&self) -> f64 {
        self.goal.floor.max(self.lower * (1.0 + self.goal.slack))
    }

    /// The distance at a point, with `extra`, and the place it was measured to; raises the lower bound.
    fn measure(&mut self, p: Vec3, extra: f64) -> (f64, usize) {
        let Some(nearest) = self.surface.nearest(p, f64::INFINITY, -1.0, self.hint) else {
            return (f64::INFINITY, usize::MAX);
        };
        self.hint = nearest.place;
        let distance = nearest.distance + extra;
        if distance > self.lower {
            self.lower = distance;
            self.witness = Some(p);
        }
        (distance, nearest.place)
    }

    /// Covers a triangle that stands for a surface within `extra` of it.
    pub(super) fn triangle(&mut self, triangle: Triangle, extra: f64) {
        self.piece(Piece::new(triangle), extra, &mut |_, _| {});
    }

    /// Covers a piece that stands for a surface within `extra` of it. `taken` is called with each part and the
    /// place that bounds it.
    pub(super) fn piece(&mut self, piece: Piece, extra: f64, taken: &mut dyn FnMut(&Piece, usize)) {
        let mut budget = self.goal.budget;
        self.stack.push((piece, false));
        while let Some((piece, left_over)) = self.stack.pop() {
            let reach = self.limit() - extra;
            if !left_over && reach > 0.0 && self.overlay(&piece, reach, extra, taken) {
                continue;
            }
            self.steps += 1;
            if self.steps.is_multiple_of(STEPS_BETWEEN_ASKING) && !(self.proceed)() {
                self.stack.clear();
                self.complete = false;
                self.upper = f64::INFINITY;
                return;
            }
            let (bound, place) = self.bound(&piece, extra);
            let enough = bound <= self.limit();
            if enough || budget == 0 || piece.cuts >= MOST_CUTS {
                self.upper = self.upper.max(bound);
                self.complete &= enough;
                taken(&piece, place);
                continue;
            }
            budget -= 1;
            let (first, second) = piece.halves();
            self.stack.extend(second.map(|piece| (piece, false)));
            self.stack.push((first, false));
        }
    }

    /// A bound of a piece, and the place it holds for, from the triangles nearest to its centre and, if that is not
    /// enough, to its corners.
    fn bound(&mut self, piece: &Piece, extra: f64) -> (f64, usize) {
        let center = piece.center();
        let (distance, place) = self.measure(center, extra);
        let mut best = distance + piece.squared_radius(center).sqrt();
        let mut at = place;
        best = best.min(self.to_triangle(piece, place) + extra);
        for corner in piece.corners() {
            if best <= self.limit() {
                break;
            }
            let (_, place) = self.measure(*corner, extra);
            let bound = self.to_triangle(piece, place) + extra;
            if bound < best {
                (best, at) = (bound, place);
            }
        }
        (best, at)
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
    fn overlay(
        &mut self,
        piece: &Piece,
        reach: f64,
        extra: f64,
        taken: &mut dyn FnMut(&Piece, usize),
    ) -> bool {
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
                if let Some((most, part)) = prism.take(&self.now[i], &mut self.rest) {
                    self.upper = self.upper.max(most.sqrt() + radius + extra);
                    taken(&part, place);
                    self.now.swap_remove(i);
                    self.now.append(&mut self.rest);
                }
            }
            if self.now.is_empty() || self.now.len() > PIECES {
                break;
            }
        }
        self.stack.extend(self.now.iter().map(|piece| (*piece, true)));
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
    /// `rest`. Returns the largest squared distance of what was taken, and that; `None` where it is nothing.
    fn take(&self, piece: &Piece, rest: &mut Vec<Piece>) -> Option<(f64, Piece)> {
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
                return all.map(|most| (most, *piece));
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
    fn carve(&self, piece: Piece, beside: f64, rest: &mut Vec<Piece>) -> Option<(f64, Piece)> {
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
        self.squared_allowed(&inside).map(|most| (most, inside))
    }
}
