//! Visibility buffer → cascades: how far away what is seen is, and where it lies as seen from each light. The tiles of the
//! picture with the depths in them are prisms of visible space; a caster is of no use where none lies behind it.
//!
//! Lauritzen, Salvi and Lefohn, "Sample Distribution Shadow Maps", I3D 2011. Haar and Aaltonen, "GPU-Driven Rendering
//! Pipelines", SIGGRAPH 2015, leave out casters whose shadows meet no prism.

use rayon::prelude::*;

use super::lanes::{LANES, Lanes, along, dot};
use super::shadow_mark::Marker;
use super::shadow_mask::{UNUSED, Walls};
use crate::limits::{
    SHADOW_CASCADES, SHADOW_PAGE_SIDE, SHADOW_PRISM_SIDE, SHADOW_SIDE, SHADOW_TILE_SIDE, SHADOW_TILES,
};
use crate::shadow::cascades::{DISTANCE_BINS, bin_of};
use crate::shadow::receiver::{RelativePage, texel_of};
use crate::shadow::{Cascades, LightView, Splits};

/// What a tile of the picture shows of a cascade.
#[derive(Clone, Copy, Debug)]
pub struct Prism {
    cascade: usize,
    /// By how much it may be off the source at most, world units.
    error: f32,
    /// The nearest and the farthest, from the camera.
    distances: [f32; 2],
}

/// The bounds of a prism along a light's axes, from the camera.
pub type Bounds = [[f32; 3]; 2];

/// All prisms of a frame, and by lights their bounds.
#[derive(Debug)]
pub struct Prisms {
    prisms: Vec<Prism>,
    bounds: Vec<Vec<Bounds>>,
}

/// The least and the largest of each lane of some values.
#[derive(Clone, Copy)]
struct Span {
    low: Lanes,
    high: Lanes,
}

const NOTHING: Span = Span { low: Lanes([f32::INFINITY; LANES]), high: Lanes([f32::NEG_INFINITY; LANES]) };

impl Span {
    /// Takes values, in some lanes.
    #[inline(always)]
    fn take(&mut self, v: Lanes, of: &Option<[bool; LANES]>) {
        let (mut low, mut high) = (v, v);
        if let Some(of) = of {
            for lane in 0..LANES {
                low.0[lane] = if of[lane] { v.0[lane] } else { f32::INFINITY };
                high.0[lane] = if of[lane] { v.0[lane] } else { f32::NEG_INFINITY };
            }
        }
        for lane in 0..LANES {
            self.low.0[lane] = if low.0[lane] < self.low.0[lane] { low.0[lane] } else { self.low.0[lane] };
            self.high.0[lane] =
                if high.0[lane] > self.high.0[lane] { high.0[lane] } else { self.high.0[lane] };
        }
    }

    fn range(&self) -> [f32; 2] {
        [self.low.range().0, self.high.range().1]
    }
}

/// Fits the cascades of the lights of a frame that have none yet, and says what they are to hold.
pub fn run(marker: &Marker<'_>, lights: &mut [&mut LightView]) -> Prisms {
    let bins = occupied(marker);
    if bins.is_empty() {
        return Prisms::new(lights.len());
    }
    let splits = Splits::new(&bins);
    let views: Vec<&LightView> = lights.iter().map(|light| &**light).collect();
    let rows: Vec<Prisms> = (0..marker.rows().div_ceil(SHADOW_PRISM_SIDE))
        .into_par_iter()
        .map(|row| prisms(marker, row, &splits, &views))
        .collect();
    let mut all = Prisms::new(lights.len());
    for mut row in rows {
        all.prisms.append(&mut row.prisms);
        all.bounds.iter_mut().zip(&mut row.bounds).for_each(|(all, row)| all.append(row));
    }
    for (light, bounds) in lights.iter_mut().zip(&all.bounds) {
        let levels = std::array::from_fn(|number| {
            let mut own =
                all.prisms.iter().zip(bounds).filter(|(prism, _)| prism.cascade == number).peekable();
            if own.peek().is_none() {
                return 0;
            }
            let none = (f32::INFINITY, [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]]);
            let (nearest, [low, high]) = own.fold(none, |(nearest, [low, high]), (prism, bounds)| {
                let low = std::array::from_fn(|k| low[k].min(bounds[0][k]));
                let high = std::array::from_fn(|k| high[k].max(bounds[1][k]));
                (nearest.min(prism.distances[0]), [low, high])
            });
            light.fitting(&low, &high, light.pixel_at(nearest))
        });
        light.cascades = Some(Cascades { splits, levels });
    }
    all
}

/// The bins of distances that pixels show something in, ascending.
fn occupied(marker: &Marker<'_>) -> Vec<usize> {
    let tiles = marker.rows().div_ceil(SHADOW_PRISM_SIDE);
    let found: Vec<Vec<u64>> = (0..tiles).into_par_iter().map(|row| bins(marker, row)).collect();
    (0..DISTANCE_BINS).filter(|bin| found.iter().any(|bins| bins[bin / 64] >> (bin % 64) & 1 != 0)).collect()
}

/// The same of a row of tiles, as bits.
fn bins(marker: &Marker<'_>, row: usize) -> Vec<u64> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
        // SAFETY: the processor has AVX2 and BMI2.
        return unsafe { bins_avx2(marker, row) };
    }
    bins_anywhere(marker, row)
}

/// The same with 256-bit vectors. No operation fuses, so the result is the same.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi2")]
fn bins_avx2(marker: &Marker<'_>, row: usize) -> Vec<u64> {
    bins_anywhere(marker, row)
}

#[inline(always)]
fn bins_anywhere(marker: &Marker<'_>, row: usize) -> Vec<u64> {
    let mut bins = vec![0u64; DISTANCE_BINS / 64];
    for row in row * SHADOW_PRISM_SIDE..marker.rows().min((row + 1) * SHADOW_PRISM_SIDE) {
        let mut last = usize::MAX;
        for column in (0..marker.columns()).step_by(LANES) {
            let Some(eight) = marker.eight(row, column) else { continue };
            let distance = dot(&eight.at, &eight.at).sqrt();
            for lane in 0..LANES {
                let bin = bin_of(distance.0[lane]);
                if eight.covered[lane] & (bin != last) {
                    bins[bin / 64] |= 1 << (bin % 64);
                    last = bin;
                }
            }
        }
    }
    bins
}

/// The prisms of a row of tiles.
fn prisms(marker: &Marker<'_>, row: usize, splits: &Splits, lights: &[&LightView]) -> Prisms {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
        // SAFETY: the processor has AVX2 and BMI2.
        return unsafe { prisms_avx2(marker, row, splits, lights) };
    }
    prisms_anywhere(marker, row, splits, lights)
}

/// The same with 256-bit vectors. No operation fuses, so the result is the same.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi2")]
fn prisms_avx2(marker: &Marker<'_>, row: usize, splits: &Splits, lights: &[&LightView]) -> Prisms {
    prisms_anywhere(marker, row, splits, lights)
}

#[inline(always)]
fn prisms_anywhere(marker: &Marker<'_>, row: usize, splits: &Splits, lights: &[&LightView]) -> Prisms {
    let mut out = Prisms::new(lights.len());
    let rows = row * SHADOW_PRISM_SIDE..marker.rows().min((row + 1) * SHADOW_PRISM_SIDE);
    let mut places = vec![[[NOTHING; 3]; SHADOW_CASCADES]; lights.len()];
    for left in (0..marker.columns()).step_by(SHADOW_PRISM_SIDE) {
        places.fill([[NOTHING; 3]; SHADOW_CASCADES]);
        let mut distances = [NOTHING; SHADOW_CASCADES];
        let mut errors = [NOTHING; SHADOW_CASCADES];
        let columns = (left..marker.columns().min(left + SHADOW_PRISM_SIDE)).step_by(LANES);
        for (row, column) in rows.clone().flat_map(|row| columns.clone().map(move |column| (row, column))) {
            let Some(eight) = marker.eight(row, column) else { continue };
            let distance = dot(&eight.at, &eight.at).sqrt();
            let mut numbers = [0; LANES];
            for lane in 0..LANES {
                numbers[lane] = splits.number(distance.0[lane]);
            }
            let whole = !eight.covered.contains(&false) && numbers.iter().all(|number| *number == numbers[0]);
            let of_all = numbers[0]..numbers[0] + 1;
            for cascade in if whole { of_all } else { 0..SHADOW_CASCADES } {
                let of = (!whole)
                    .then(|| std::array::from_fn(|lane| eight.covered[lane] & (numbers[lane] == cascade)));
                if of.is_some_and(|of: [bool; LANES]| !of.contains(&true)) {
                    continue;
                }
                distances[cascade].take(distance, &of);
                errors[cascade].take(eight.error, &of);
                for (light, places) in lights.iter().zip(&mut places) {
                    for (axis, place) in light.axes.iter().zip(&mut places[cascade]) {
                        place.take(along(axis, &eight.at), &of);
                    }
                }
            }
        }
        for cascade in 0..SHADOW_CASCADES {
            let (distances, [_, error]) = (distances[cascade].range(), errors[cascade].range());
            if distances[0] > distances[1] {
                continue;
            }
            out.prisms.push(Prism { cascade, error, distances });
            for (out, places) in out.bounds.iter_mut().zip(&places) {
                let [x, y, z] = places[cascade].map(|place| place.range());
                out.push([[x[0], y[0], z[0]], [x[1], y[1], z[1]]]);
            }
        }
    }
    out
}

impl Prisms {
    /// None, for so many lights.
    fn new(lights: usize) -> Self {
        Self { prisms: Vec::new(), bounds: vec![Vec::new(); lights] }
    }

    /// How deep what is looked up lies at most, of a light by its number among those that were given, in the levels that it has
    /// by now.
    pub fn walls(&self, number: usize, light: &LightView, walls: &mut Walls) {
        let Some(cascades) = &light.cascades else { return };
        let (page, tile) = (SHADOW_PAGE_SIDE as i32, SHADOW_TILE_SIDE as i32);
        for (prism, [low, high]) in self.prisms.iter().zip(&self.bounds[number]) {
            let level = light.cascade_level(cascades, prism.cascade);
            let Some(anchor) = light.anchor(level) else { continue };
            let (texel, inverse) = (texel_of(level), texel_of(-level));
            let farthest = prism.distances[1];
            let own = prism.error + LightView::rounding(farthest, light.pixel_at(farthest));
            let reach = light.reach(own, texel);
            let tile_of = |texels: f32| (texels / tile as f32).floor() as i32;
            let [left, right] = [low[0] - reach, high[0] + reach].map(|x| tile_of(x * inverse + anchor[0]));
            let [top, bottom] = [high[1] + reach, low[1] - reach].map(|y| tile_of(anchor[1] - y * inverse));
            let [lowest, highest] = [low[2] - reach, high[2] + reach].map(|z| z * inverse + anchor[2]);
            let slab_of = |z: f32| (z / SHADOW_SIDE as f32).floor() as i32;
            let tiles = page / tile;
            for z in slab_of(lowest)..=slab_of(highest) {
                let depth = ((z as f32 + 1.0) * SHADOW_SIDE as f32 - lowest) * texel;
                let key = (!depth.max(0.0).to_bits()).min(UNUSED - 1);
                for y in top.div_euclid(tiles)..=bottom.div_euclid(tiles) {
                    for x in left.div_euclid(tiles)..=right.div_euclid(tiles) {
                        let at = RelativePage { face: 0, level: level as i16, x, y, z };
                        let cells =
                            walls.entry(light.key(&at)).or_insert_with(|| Box::new([UNUSED; SHADOW_TILES]));
                        let within = |from: i32, to: i32, page: i32| {
                            (from - page * tiles).max(0) as usize
                                ..=(to - page * tiles).min(tiles - 1) as usize
                        };
                        for row in within(top, bottom, y) {
                            for cell in &mut cells[row * tiles as usize..][within(left, right, x)] {
                                *cell = key.min(*cell);
                            }
                        }
                    }
                }
            }
        }
    }
}
