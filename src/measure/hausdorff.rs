//! Bounds of the Hausdorff distance: of two small surfaces for building, of two meshes for the public.

use rayon::prelude::*;

use super::bvh::Bvh;
use super::closest::{Triangle, Vec3};
use super::cover::Cover;
use super::overlay::{Bounds, Overlay, Sheet};
use super::piece::Piece;
use crate::error::{Error, Result};

/// A mesh: triangles over positions.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Positions.
    pub positions: &'a [[f32; 3]],
    /// Three per triangle.
    pub indices: &'a [u32],
}

/// How near a bound should come, and what it may cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundOptions {
    /// Distances up to this are as good as zero: nothing is done to tell them apart.
    pub floor: f64,
    /// The upper bound may be so much above the lower one, as a part of it.
    pub slack: f64,
    /// Pieces of one triangle that are looked at one by one, at most.
    pub budget: u64,
}

impl Default for BoundOptions {
    fn default() -> Self {
        Self { floor: 0.0, slack: 0.25, budget: 1_000 }
    }
}

/// Bounds of a distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceBound {
    /// A distance found at a point; 0 where the options' floor was never exceeded.
    pub lower: f64,
    /// No point is farther off: rounded outwards.
    pub upper: f64,
    /// The upper bound came as near as was asked; otherwise the budget was spent, and it still holds.
    pub complete: bool,
}

/// Relative rounding of a distance, many times over: docs/numerics.md.
pub(super) const RELATIVE_ROUNDING: f64 = 1.0 / (1u64 << 40) as f64;
/// Rounding of a position, as a part of the largest coordinate, many times over: docs/numerics.md.
pub(super) const POSITION_ROUNDING: f64 = 1.0 / (1u64 << 41) as f64;

/// An upper bound as it may be stated.
pub fn outwards(upper: f64, largest_coordinate: f64) -> f64 {
    upper * (1.0 + RELATIVE_ROUNDING) + largest_coordinate * POSITION_ROUNDING
}

fn triangles(surface: Surface<'_>) -> Vec<Triangle> {
    let corner = |v: u32| surface.positions[v as usize].map(f64::from);
    surface.indices.chunks_exact(3).map(|t| [corner(t[0]), corner(t[1]), corner(t[2])]).collect()
}

/// Bounds of the Hausdorff distance between two surfaces, where triangle t of `b` stands for something within
/// `radii[t]` of it: of the larger of
///
/// - the maximum over the points x of `a` of the minimum over t of distance(x, t) + `radii[t]`, and
/// - the maximum over t, and over the points x of t, of distance(x, `a`) + `radii[t]`.
///
/// `radii` are finite and not negative, one per triangle of `b`, or none. Without radii this is the Hausdorff
/// distance. Only the maximum matters, so that a triangle costs little unless it may be the worst. One thread, and
/// always the same result. An empty surface is infinitely far from any other.
pub fn hausdorff_upper(
    a: Surface<'_>,
    b: Surface<'_>,
    radii: &[f32],
    options: &BoundOptions,
) -> SurfaceBound {
    let (a_triangles, b_triangles) = (triangles(a), triangles(b));
    match (a_triangles.is_empty(), b_triangles.is_empty()) {
        (true, true) => return SurfaceBound { lower: 0.0, upper: 0.0, complete: true },
        (false, false) => {}
        _ => return SurfaceBound { lower: f64::INFINITY, upper: f64::INFINITY, complete: true },
    }
    let largest =
        a_triangles.iter().chain(&b_triangles).flatten().flatten().fold(0.0f64, |m, x| m.max(x.abs()));
    let corners = |s: Surface<'_>| s.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect::<Vec<_>>();
    let radius = |t: usize| radii.get(t).copied().map_or(0.0, f64::from);
    let wide = (0..b_triangles.len()).map(radius).collect();
    let none = vec![0.0; a_triangles.len()];
    let of_a = Sheet::new(a_triangles, &corners(a), none);
    let of_b = Sheet::new(b_triangles, &corners(b), wide);
    let mut bounds = Bounds::new(*options);
    let (mut to_a, mut to_b) = (Overlay::new(&of_a), Overlay::new(&of_b));
    for (i, t) in of_b.triangles().iter().enumerate() {
        to_a.lay(&mut bounds, &Piece::new(*t), radius(i), |_, _| 0);
    }
    for t in of_a.triangles() {
        to_b.lay(&mut bounds, &Piece::new(*t), 0.0, |_, _| 0);
    }
    SurfaceBound { lower: bounds.lower, upper: outwards(bounds.upper, largest), complete: bounds.complete }
}

/// Bounds of the distance of one mesh to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OneSidedBound {
    /// A distance found at a point, rounded down.
    pub lower: f64,
    /// No point is farther off: rounded up.
    pub upper: f64,
    /// Pieces that were looked at one by one.
    pub pieces: u64,
}

/// Triangles of a piece of work. Its result depends on nothing but the bounds known when its round began.
const WORK: usize = 512;
/// Pieces of work of the first round; each further one has twice as many, up to a limit.
const FIRST_ROUND: usize = 4;
const LARGEST_ROUND: usize = 1 << 10;

/// Bounds of the largest distance of a point of `from` to `surface`.
///
/// `lower` and `witness` are a distance known to occur and where; `tolerance` is what upper − lower should not exceed
/// as a part of the upper bound; `budget` is the number of pieces to look at one by one in all, about; `largest` is the
/// largest coordinate. `proceed(done, total)` is asked now and then.
pub(super) fn one_sided(
    from: &Bvh,
    surface: &Bvh,
    (lower, witness): (f64, Vec3),
    tolerance: f64,
    budget: u64,
    largest: f64,
    proceed: &(dyn Fn(u64, u64) -> bool + Sync),
) -> Result<OneSidedBound> {
    let floor = largest * POSITION_ROUNDING;
    // A little less than allowed, for what rounding the bounds outwards takes.
    let slack = tolerance * 0.99;
    let (mut lower, mut witness, mut upper, mut pieces) = (lower, witness, 0.0f64, 0u64);
    let (mut start, mut chunks) = (0, FIRST_ROUND);
    while start < from.len() {
        let end = from.len().min(start + chunks * WORK);
        // Few triangles need any: each may take eight times its share of what is left.
        let budget = budget.saturating_sub(pieces).div_ceil((end - start) as u64 / 8 + 1);
        let goal = BoundOptions { floor, slack, budget };
        let round: Vec<_> = from.triangles()[start..end]
            .par_chunks(WORK)
            .map(|part| {
                let proceed = || proceed(start as u64, from.len() as u64);
                let mut cover = Cover::new(surface, goal, lower, &proceed);
                for t in part {
                    cover.triangle(*t, 0.0);
                    if !proceed() {
                        return Err(Error::Cancelled);
                    }
                }
                Ok((cover.lower, cover.witness, cover.upper, cover.steps))
            })
            .collect::<Result<_>>()?;
        for (found, at, bound, steps) in round {
            if let (Some(at), true) = (at, found > lower) {
                (lower, witness) = (found, at);
            }
            upper = upper.max(bound);
            pieces += steps;
        }
        start = end;
        chunks = (2 * chunks).min(LARGEST_ROUND);
    }
    let certain = surface.distance_below(witness) * (1.0 - RELATIVE_ROUNDING) - largest * POSITION_ROUNDING;
    Ok(OneSidedBound { lower: certain.max(0.0), upper: outwards(upper, largest), pieces })
}
