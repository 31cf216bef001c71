//! A convex polygon, and cutting it by planes.

use super::closest::{Vec3, along, dot, normal, squared, sub};

/// Corners of a piece at most; a piece that would have more is halved instead.
pub const CORNERS: usize = 8;
/// Cuts that led to a piece at most. docs/numerics.md: each moves the surface by rounding.
pub const MOST_CUTS: u8 = 100;

/// A corner of a piece: a point, and whatever else is linear over the piece.
pub trait Corner: Copy + Default {
    /// Where it is.
    fn position(&self) -> Vec3;

    /// The corner at `t` of the way to another one.
    fn towards(&self, other: &Self, t: f64) -> Self;
}

impl Corner for Vec3 {
    fn position(&self) -> Vec3 {
        *self
    }

    fn towards(&self, other: &Self, t: f64) -> Self {
        along(*self, sub(*other, *self), t)
    }
}

/// A convex polygon.
#[derive(Clone, Copy, Debug)]
pub struct Piece<C = Vec3> {
    pub(super) corners: [C; CORNERS],
    pub(super) count: u8,
    pub(super) cuts: u8,
}

impl<C: Corner> Piece<C> {
    /// A whole triangle.
    pub fn new(triangle: [C; 3]) -> Self {
        Self::restored(&triangle, 0)
    }

    /// What `corners` and `cuts` of a piece said.
    pub fn restored(corners: &[C], cuts: u8) -> Self {
        let mut out = Self { corners: [C::default(); CORNERS], count: corners.len() as u8, cuts };
        out.corners[..corners.len()].copy_from_slice(corners);
        out
    }

    /// How often it was cut.
    pub fn cuts(&self) -> u8 {
        self.cuts
    }

    /// Its corners in order.
    pub fn corners(&self) -> &[C] {
        &self.corners[..usize::from(self.count)]
    }

    /// Twice its area.
    pub fn double_area(&self) -> f64 {
        let at = |c: &C| c.position();
        let fan = self.corners()[1..]
            .windows(2)
            .map(|pair| normal([at(&self.corners[0]), at(&pair[0]), at(&pair[1])]));
        fan.map(|n| dot(n, n).sqrt()).sum()
    }

    /// The mean of its corners.
    pub fn center(&self) -> Vec3 {
        let share = 1.0 / f64::from(self.count);
        self.corners().iter().fold([0.0; 3], |sum, c| along(sum, c.position(), share))
    }

    /// Greatest squared distance of a corner from a point.
    pub(super) fn squared_radius(&self, p: Vec3) -> f64 {
        self.corners().iter().fold(0.0, |most, c| most.max(squared(p, c.position())))
    }

    pub(super) fn push(&mut self, p: C) -> Option<()> {
        *self.corners.get_mut(usize::from(self.count))? = p;
        self.count += 1;
        Some(())
    }

    /// No corners yet, after one more cut.
    pub fn child(&self) -> Self {
        let cuts = self.cuts.saturating_add(1);
        Self { corners: [C::default(); CORNERS], count: 0, cuts }
    }

    /// Adds to `inside` the part where `sides`, one value per corner and linear between them, is up to 0, and to
    /// `outside` that where it is above. `None` where a part would have too many corners.
    pub fn cut(&self, sides: &[f64; CORNERS], inside: &mut Self, outside: &mut Self) -> Option<()> {
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
                let p = self.corners[i].towards(&self.corners[j], t);
                inside.push(p)?;
                outside.push(p)?;
            }
        }
        Some(())
    }

    /// Two halves, across the longest diagonal. A piece too small to be cut gives itself and nothing.
    pub fn halves(&self) -> (Self, Option<Self>) {
        let corners = self.corners();
        let (mut far, mut ends) = (0.0, (0, 0));
        for i in 0..corners.len() {
            for j in i + 1..corners.len() {
                let d = squared(corners[i].position(), corners[j].position());
                if d > far {
                    (far, ends) = (d, (i, j));
                }
            }
        }
        let (a, b) = (corners[ends.0].position(), corners[ends.1].position());
        let (axis, middle) = (sub(b, a), along(a, sub(b, a), 0.5));
        let mut sides = [0.0; CORNERS];
        sides.iter_mut().zip(corners).for_each(|(s, p)| *s = dot(axis, sub(p.position(), middle)));
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
