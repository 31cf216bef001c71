//! Image-based lighting of eight surface points at a time: `shaders/shared/environment.wgsl` does the same
//! operations in the same order.
//!
//! The sum over all directions is split in two, what arrives about the main direction and what is reflected of white (Karis,
//! see [`crate::scene::albedo`]); both are looked up. The main direction is the mirrored one where surfaces are smooth, and
//! nearer to the normal the rougher they are (S. Lagarde, C. de Rousiers, "Moving Frostbite to physically based rendering",
//! SIGGRAPH 2014).

use super::lanes::{LANES, Lanes, Vec3x8, apply, dot};
use crate::scene::albedo::{ALBEDO_PARTS, ALBEDO_SIDE};
use crate::scene::environment::{Grid, IRRADIANCE, ROUGHNESS_LEVELS};
use crate::scene::{EnvironmentMap, Surroundings};

/// Light reflected to `view`.
#[inline(always)]
pub fn reflect(
    around: &Surroundings,
    normal: &Vec3x8,
    view: &Vec3x8,
    roughness: Lanes,
    diffuse: &Vec3x8,
    f0: &Vec3x8,
) -> Vec3x8 {
    let nv = dot(normal, view);
    let twice = nv * 2.0;
    let mirrored = [normal[0] * twice - view[0], normal[1] * twice - view[1], normal[2] * twice - view[2]];
    // Rough surfaces reflect nearer to their normals.
    let alpha = roughness * roughness;
    let smooth = -(alpha - 1.0);
    let part = smooth * (smooth.sqrt() + alpha);
    let main = [
        normal[0] + (mirrored[0] - normal[0]) * part,
        normal[1] + (mirrored[1] - normal[1]) * part,
        normal[2] + (mirrored[2] - normal[2]) * part,
    ];
    let matt_place = unfolded(&apply(&around.to_map, normal));
    let gloss_place = unfolded(&apply(&around.to_map, &main));
    let facing = nv.max(0.0).min(1.0).sqrt();
    let mut out = *f0;
    for lane in 0..LANES {
        let lane_of = |place: &[Lanes; 2]| place.each_ref().map(|c| c.0[lane]);
        let irradiance = at(&around.map, IRRADIANCE, lane_of(&matt_place));
        let gloss = between_levels(&around.map, roughness.0[lane], lane_of(&gloss_place));
        let [scale, offset, loss] = albedo(&around.map, facing.0[lane], roughness.0[lane]);
        for c in 0..3 {
            let f0 = f0[c].0[lane];
            let kept = (1.0 - f0) * (1.0 - loss);
            let sum = irradiance[c] * (diffuse[c].0[lane] * kept) + gloss[c] * (f0 * scale + offset);
            out[c].0[lane] = sum * around.intensity;
        }
    }
    out
}

/// What is seen of the map itself along directions of any length.
#[inline(always)]
pub fn behind(around: &Surroundings, direction: &Vec3x8) -> Vec3x8 {
    let place = unfolded(&apply(&around.to_map, direction));
    let mut out = *direction;
    for lane in 0..LANES {
        let light = at(&around.map, 0, place.each_ref().map(|c| c.0[lane]));
        (0..3).for_each(|c| out[c].0[lane] = light[c] * around.intensity);
    }
    out
}

/// Where directions lie on an unfolded octahedron, −1 to 1.
#[inline(always)]
fn unfolded([x, y, z]: &Vec3x8) -> [Lanes; 2] {
    let inverse = Lanes::splat(1.0) / (x.abs() + y.abs() + z.abs());
    let (u, v) = (*x * inverse, *z * inverse);
    let (p, q) = (-(v.abs() - 1.0), -(u.abs() - 1.0));
    [y.where_negative(u.where_negative(-p, p), u), y.where_negative(v.where_negative(-q, q), v)]
}

/// A node and the way from there to the next, of so many along a side.
#[inline(always)]
fn step(part: f32, side: u32) -> (usize, f32) {
    let at = part * (side - 1) as f32;
    // What is not a number becomes 0.
    let node = (at as usize).min(side as usize - 2);
    (node, at - node as f32)
}

#[inline(always)]
fn blend(a: [f32; 3], b: [f32; 3], part: f32) -> [f32; 3] {
    [a[0] + (b[0] - a[0]) * part, a[1] + (b[1] - a[1]) * part, a[2] + (b[2] - a[2]) * part]
}

/// Between the four values about a place, of a square of them.
#[inline(always)]
fn bilinear(values: &[f32], Grid { side, start }: Grid, place: [f32; 2]) -> [f32; 3] {
    let ((x, right), (y, down)) = (step(place[0], side), step(place[1], side));
    let first = start as usize + 3 * (y * side as usize + x);
    let value = |at: usize| [values[at], values[at + 1], values[at + 2]];
    let below = first + 3 * side as usize;
    let upper = blend(value(first), value(first + 3), right);
    blend(upper, blend(value(below), value(below + 3), right), down)
}

/// The light of a grid at a place.
#[inline(always)]
fn at(map: &EnvironmentMap, grid: usize, place: [f32; 2]) -> [f32; 3] {
    bilinear(map.values(), map.grids()[grid], place.map(|c| c * 0.5 + 0.5))
}

/// The light that arrives at a roughness about a place.
#[inline(always)]
fn between_levels(map: &EnvironmentMap, roughness: f32, place: [f32; 2]) -> [f32; 3] {
    let (level, part) = step(roughness, ROUGHNESS_LEVELS as u32);
    blend(at(map, level, place), at(map, level + 1, place), part)
}

/// See [`crate::scene::albedo`].
#[inline(always)]
fn albedo(map: &EnvironmentMap, facing: f32, roughness: f32) -> [f32; ALBEDO_PARTS] {
    bilinear(map.values(), Grid { side: ALBEDO_SIDE as u32, start: 0 }, [facing, roughness])
}
