//! **The rule of the cut**, stated once: draw a cluster if its group's (parent) error projects above τ and its
//! own projects to τ or below.
//!
//! Errors increase strictly along the DAG and spheres nest, so over every piece of the surface the projected
//! error passes τ exactly once, and exactly one cluster is drawn there. The argument needs the *evaluated*
//! projection to be monotone, f32 rounding included. Two margins give that. A parent sphere's radius exceeds
//! the tight one by the factor 1 + 1e-4 ([`crate::math::sphere::RADIUS_MARGIN`]): while the eye is within some
//! 500 radii, that is more than the rounding of |c − eye|. A parent error exceeds every child's by the factor
//! 1 + 2⁻¹⁵ ([`ERROR_STEP`]): farther away, that is more than the relative rounding of the whole quotient.

use crate::math::{LodView, Sphere};

/// Own error of level-0 clusters: projects below every threshold, so τ = 0 is full detail.
pub const SOURCE_ERROR: f32 = -1.0;

/// Parent error of clusters that nothing coarser was made from.
pub const ROOT_ERROR: f32 = f32::INFINITY;

/// Smallest relative step from an error to its parent's.
pub const ERROR_STEP: f32 = 1.0 + 1.0 / 32768.0;

/// Smallest error above level 0, internal units (the mesh is about 1 across): the rounding of a position.
pub const ERROR_FLOOR: f32 = 1.0 / 16_777_216.0;

/// A threshold with everything needed to compare an error with it.
#[derive(Clone, Copy, Debug)]
pub enum Threshold {
    /// An error in internal units, the same everywhere.
    Uniform(f32),
    /// An error in pixels, as seen from a view.
    View(LodView, f32),
}

impl Threshold {
    /// True when an error on a sphere is too large to be drawn.
    pub fn exceeded_by(&self, sphere: &Sphere, error: f32) -> bool {
        match self {
            Self::Uniform(tau) => error > *tau,
            Self::View(view, tau) => view.pixels(sphere, error) > *tau,
        }
    }

    /// Whether clusters inside of a sphere may be drawn, from the largest of their parent errors and the least of their own.
    pub fn may_be_in_cut(&self, sphere: &Sphere, parent_error: f32, own_error: f32) -> bool {
        self.exceeded_by(sphere, parent_error) && !self.exceeded_throughout(sphere, own_error)
    }

    /// True when no error of at least `error`, on whatever sphere inside of this one, is small enough to be drawn: none of
    /// them fails [`Threshold::exceeded_by`].
    pub fn exceeded_throughout(&self, sphere: &Sphere, error: f32) -> bool {
        match self {
            Self::Uniform(tau) => error > *tau,
            Self::View(view, tau) => view.least_pixels(sphere, error) > *tau,
        }
    }
}
