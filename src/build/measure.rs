//! The error of a step of simplification: how far what was made may be from the source.
//!
//! Against the group's own input, errors add up along the DAG: what the input was off, plus what the step adds.
//! [`super::reference`] is how samples avoid that. The proof of the bound is in docs/numerics.md.

use super::store::LocalMesh;
use crate::config::ErrorMeasure;
use crate::math::sphere::round_up;
use crate::measure::deviation::{Stars, Surface};
use crate::measure::{BoundOptions, deviation, hausdorff_upper};

/// Vertices only sample the two surfaces. Between them the deviation was seen to be up to 1.5 times as large
/// (`test_properties.py -k stated`), and shading, which follows the normals, changes before the shape does: with
/// 2.0 a fine sphere at one pixel lost half a decibel (`test_images.py -k no_further`).
pub const SAMPLING_MARGIN: f32 = 2.25;

/// A bound may be this part above the largest distance found.
const BOUND_SLACK: f64 = 0.25;
/// Distances below this part of the simplifier's estimate are not told apart: the largest is above it.
const BOUND_FLOOR: f64 = 0.5;

/// The error of `after`, made from `before`, each of whose triangles is off by its entry of `errors`.
pub fn step_error(
    measure: ErrorMeasure,
    before: &LocalMesh,
    after: &LocalMesh,
    errors: &[f32],
    estimate: f32,
) -> f32 {
    let below = errors.iter().fold(0.0f32, |most, e| most.max(*e));
    let plus = |added: f32| round_up(f64::from(below) + f64::from(added));
    match measure {
        ErrorMeasure::Quadric => plus(estimate),
        ErrorMeasure::Sampled => plus(SAMPLING_MARGIN * sampled(before, after, estimate)),
        // The estimate also weighs attributes, which change without the shape.
        ErrorMeasure::Bound => round_up(bound(before, after, errors, estimate)).max(plus(estimate)),
    }
}

/// The proven bound: of distance plus error, over every point of both surfaces.
fn bound(before: &LocalMesh, after: &LocalMesh, errors: &[f32], estimate: f32) -> f64 {
    let options = BoundOptions {
        floor: f64::from(estimate) * BOUND_FLOOR,
        slack: BOUND_SLACK,
        ..BoundOptions::default()
    };
    let surface = |m| {
        let LocalMesh { positions, indices, .. }: &LocalMesh = m;
        Surface { positions, indices }
    };
    hausdorff_upper(surface(after), surface(before), errors, &options).upper
}

/// The estimate, or the largest distance found at a vertex of either surface to the other one.
fn sampled(before: &LocalMesh, after: &LocalMesh, estimate: f32) -> f32 {
    let count = before.ids.len();
    let stars = [before, after].map(|m| Stars::new(count, &m.indices));
    let around = |v: usize| stars[0].of(v as u32);
    // A vertex that is gone lies near what its neighbours have become.
    let first = |v: &usize| before.position_ids[*v] as usize == *v && !before.locked[*v];
    let next = |v: u32, t: &u32| {
        let corners = &before.indices[3 * *t as usize..][..3];
        if corners[0] == v {
            corners[1]
        } else if corners[1] == v {
            corners[2]
        } else {
            corners[0]
        }
    };
    let neighbours = |v| around(v).iter().map(move |t| next(v as u32, t));
    let gone = (0..count).filter(first).map(|v| (before.positions[v], neighbours(v)));
    let surface = Surface { positions: &after.positions, indices: &after.indices };
    let error = deviation(surface, &stars[1], gone, estimate);
    // A vertex that moved lies near where it was.
    let moved = (0..count).filter(|v| after.positions[*v] != before.positions[*v]);
    let surface = Surface { positions: &before.positions, indices: &before.indices };
    deviation(surface, &stars[0], moved.map(|v| (after.positions[v], std::iter::once(v as u32))), error)
}
