//! Axis-aligned boxes.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

use super::sphere::round_up;

/// An axis-aligned box by its corners. Empty when `min > max`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
pub struct Aabb {
    /// Smallest corner.
    pub min: [f32; 3],
    /// Largest corner.
    pub max: [f32; 3],
}

impl Aabb {
    /// The box of nothing: the neutral element of [`Aabb::union`].
    pub const EMPTY: Self = Self { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] };

    /// The tight box of points.
    pub fn of_points<'a>(points: impl IntoIterator<Item = &'a [f32; 3]>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| b.union(&Self { min: *p, max: *p }))
    }

    /// The smallest box around both.
    pub fn union(&self, other: &Self) -> Self {
        let mut out = *self;
        for k in 0..3 {
            out.min[k] = out.min[k].min(other.min[k]);
            out.max[k] = out.max[k].max(other.max[k]);
        }
        out
    }

    /// True when `other` lies inside.
    pub fn contains(&self, other: &Self) -> bool {
        (0..3).all(|k| self.min[k] <= other.min[k] && other.max[k] <= self.max[k])
    }

    /// Centre, rounded to nearest.
    pub fn center(&self) -> [f32; 3] {
        std::array::from_fn(|k| self.min[k] * 0.5 + self.max[k] * 0.5)
    }

    /// Its rounded centre, and half extents about that, rounded up so that they hold it.
    pub fn center_extent(&self) -> ([f32; 3], [f32; 3]) {
        let center = self.center();
        let extent = std::array::from_fn(|k| {
            let c = f64::from(center[k]);
            round_up((f64::from(self.max[k]) - c).max(c - f64::from(self.min[k])))
        });
        (center, extent)
    }

    /// Length of the diagonal.
    pub fn diagonal(&self) -> f32 {
        (0..3).map(|k| (f64::from(self.max[k]) - f64::from(self.min[k])).powi(2)).sum::<f64>().sqrt() as f32
    }
}
