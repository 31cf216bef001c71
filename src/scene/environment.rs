//! Environment maps: what surfaces of each roughness see of it, made beforehand ([`super::prefilter`]), beside
//! what they reflect of it ([`super::albedo`]).
//!
//! Maps are equirectangular: rows from +Y down, columns around it from −X over −Z, +X in the middle, and +Z. What is made of
//! one lies on octahedra unfolded to squares (E. Praun, H. Hoppe, "Spherical parametrization and remeshing", SIGGRAPH 2003):
//! values stand at the nodes of a grid whose edges fold onto themselves, so that interpolation meets no seam.

use std::f64::consts::{FRAC_1_PI, FRAC_PI_2};
use std::sync::Arc;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::View;
use super::albedo;
use super::image::{MAX_IMAGE_SIDE, Pixels, Taps};
use super::pose;
use super::prefilter::{Kernel, Tree};
use crate::config::Transfer;
use crate::error::{Error, Result};

/// Grids for surfaces of equal steps of roughness, from a mirror to 1.
pub const ROUGHNESS_LEVELS: usize = 9;
/// The grid of irradiance, behind those.
pub const IRRADIANCE: usize = ROUGHNESS_LEVELS;
/// All grids.
pub const GRIDS: usize = ROUGHNESS_LEVELS + 1;
/// Nodes along the sides of all but the first.
const SIDES: [u32; GRIDS - 1] = [257, 129, 65, 65, 33, 33, 33, 33, 65];
/// Nodes along the side of the first: two for each row of the map.
const NODES_PER_ROW: u32 = 2;
/// Fewer rows than the first become whole multiples; more than the second are averaged.
const ROWS: [u32; 2] = [256, 512];
/// Brighter light than this has no place in sums.
const BRIGHTEST: f32 = 1e18;

/// A square of values, red, green and blue each, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Grid {
    /// Nodes along a side.
    pub side: u32,
    /// Where it starts among [`EnvironmentMap::values`].
    pub start: u32,
}

/// A map ready for shading.
#[derive(Debug)]
pub struct EnvironmentMap {
    values: Vec<f32>,
    grids: [Grid; GRIDS],
}

impl EnvironmentMap {
    /// From a map twice as wide as high; integers are sRGB, floats linear. Grey is taken for white light, alpha for nothing.
    pub fn new(pixels: Pixels<'_>, width: u32, height: u32, channels: usize) -> Result<Self> {
        let wrong = |message: String| Err(Error::argument("image", message));
        if height == 0 || width != 2 * height || width > MAX_IMAGE_SIDE {
            let message =
                format!("must be twice as wide as high, up to {MAX_IMAGE_SIDE}, not {width} x {height}");
            return wrong(message);
        }
        let count = width as usize * height as usize;
        if !(1..=4).contains(&channels) || pixels.len() != count * channels {
            let found = pixels.len();
            return wrong(format!("{found} numbers are no {width} x {height} pixels of {channels} channels"));
        }
        let srgb = |v: f64| Transfer::Srgb.decode(v) as f32;
        let texels: Vec<[f32; 3]> = (0..count)
            .into_par_iter()
            .map(|at| {
                let color = |k: usize| at * channels + if channels < 3 { 0 } else { k };
                [0, 1, 2].map(|k| match pixels {
                    Pixels::Bytes(bytes) => srgb(f64::from(bytes[color(k)]) / 255.0),
                    Pixels::Words(words) => srgb(f64::from(words[color(k)]) / 65535.0),
                    Pixels::Floats(floats) => floats[color(k)],
                })
            })
            .collect();
        let bad = |c: &&f32| !(0.0..=BRIGHTEST).contains(*c);
        if let Some(at) = texels.iter().position(|texel| texel.iter().any(|c| bad(&c))) {
            let found = texels[at].iter().find(bad).copied().unwrap_or(f32::NAN);
            let (row, column) = (at / width as usize, at % width as usize);
            return wrong(format!(
                "light must be 0 to {BRIGHTEST:e}, not {found} at row {row}, column {column}"
            ));
        }
        Ok(Self::made(&texels, height))
    }

    fn made(texels: &[[f32; 3]], height: u32) -> Self {
        let rows = (height * ROWS[0].div_ceil(height)).min(ROWS[1]);
        let texels = resized(texels, height, rows);
        let tree = Tree::new(&texels, 2 * rows as usize);
        let sides = [NODES_PER_ROW * rows + 1].into_iter().chain(SIDES);
        let mut values = albedo::table().to_vec();
        let grids = sides.enumerate().map(|(number, side)| {
            let start = values.len() as u32;
            let alpha = (number as f32 / (ROUGHNESS_LEVELS - 1) as f32).powi(2);
            let value = |at: u32| {
                let direction = node(side, at);
                match number {
                    0 => seen(&texels, 2 * rows as usize, direction),
                    IRRADIANCE => tree.mean(direction.as_vec3().to_array(), Kernel::Cosine),
                    _ => tree.mean(direction.as_vec3().to_array(), Kernel::Ggx(alpha)),
                }
            };
            let grid: Vec<[f32; 3]> = (0..side * side).into_par_iter().map(value).collect();
            values.extend(grid.as_flattened());
            Grid { side, start }
        });
        let grids: Vec<Grid> = grids.collect();
        Self { grids: std::array::from_fn(|k| grids[k]), values }
    }

    /// What shading reads: [`albedo::table`], then the grids.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// By roughness in equal steps, then [`IRRADIANCE`].
    pub fn grids(&self) -> &[Grid; GRIDS] {
        &self.grids
    }
}

/// A map as a scene has it.
#[derive(Clone, Debug)]
pub struct Environment {
    /// The map.
    pub map: Arc<EnvironmentMap>,
    /// Times its light.
    pub intensity: f32,
    /// How far it is turned about +Y, radians, counter-clockwise seen from above.
    pub rotation: f64,
    /// It is also seen where nothing is in front of it.
    pub background: bool,
}

impl Environment {
    /// Checks every range; the error names the field.
    pub fn validate(&self) -> Result<()> {
        let Self { intensity, rotation, .. } = *self;
        if !(0.0..=BRIGHTEST).contains(&intensity) {
            return Err(Error::argument("intensity", format!("must be 0 to {BRIGHTEST:e}, not {intensity}")));
        }
        if !rotation.is_finite() {
            return Err(Error::argument("rotation", format!("must be finite, not {rotation}")));
        }
        Ok(())
    }
}

/// An environment as seen from a view.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// The map.
    pub map: Arc<EnvironmentMap>,
    /// Rows of the rotation from camera space to the map.
    pub to_map: [[f32; 3]; 3],
    /// Times its light.
    pub intensity: f32,
    /// It is also seen where nothing is in front of it.
    pub background: bool,
}

impl Surroundings {
    pub(super) fn new(environment: &Environment, view: &View) -> Self {
        let Environment { map, intensity, rotation, background } = environment;
        let to_map = DMat3::from_rotation_y(-rotation) * view.pose.matrix3;
        Self {
            map: Arc::clone(map),
            to_map: pose::linear_rows(&to_map).map(|row| row.map(|v| v as f32)),
            intensity: *intensity,
            background: *background,
        }
    }
}

/// A map with another number of rows: each texel the mean of what is under it.
fn resized(texels: &[[f32; 3]], from: u32, to: u32) -> Vec<[f32; 3]> {
    let (down, across) = (Taps::new(from, to), Taps::new(2 * from, 2 * to));
    let row = |y: u32| {
        let (down, across) = (&down, &across);
        (0..2 * to).map(move |x| {
            let mut mean = [0.0f32; 3];
            for (row, of_row) in down.of(y) {
                for (column, of_column) in across.of(x) {
                    let texel = texels[row * 2 * from as usize + column];
                    (0..3).for_each(|k| mean[k] += texel[k] * (of_row * of_column));
                }
            }
            mean
        })
    };
    (0..to).into_par_iter().flat_map_iter(row).collect()
}

/// The direction of a node of a grid.
fn node(side: u32, at: u32) -> DVec3 {
    let place = |at: u32| 2.0 * f64::from(at) / f64::from(side - 1) - 1.0;
    let (x, z) = (place(at % side), place(at / side));
    let y = 1.0 - x.abs() - z.abs();
    // The lower half lies folded out around the upper one.
    let fold = (-y).max(0.0);
    DVec3::new(x - fold.copysign(x), y, z - fold.copysign(z)).normalize()
}

/// What of a map is seen in a direction, between texels.
fn seen(texels: &[[f32; 3]], columns: usize, direction: DVec3) -> [f32; 3] {
    let rows = texels.len() / columns;
    let turn = 0.5 + 0.5 * FRAC_1_PI * direction.z.atan2(direction.x);
    let fall = FRAC_1_PI * (FRAC_PI_2 - direction.y.clamp(-1.0, 1.0).asin());
    let (x, y) = (turn * columns as f64 - 0.5, fall * rows as f64 - 0.5);
    let (right, down) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
    let texel = |row: f64, column: f64| {
        let row = row.clamp(0.0, (rows - 1) as f64) as usize;
        texels[row * columns + column.rem_euclid(columns as f64) as usize]
    };
    let between = |row: f64| {
        let (a, b) = (texel(row, x.floor()), texel(row, x.floor() + 1.0));
        [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * right)
    };
    let (above, below) = (between(y.floor()), between(y.floor() + 1.0));
    [0, 1, 2].map(|k| above[k] + (below[k] - above[k]) * down)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_hold_what_maps_show() {
        // +X red, −X green, +Z blue, up white: in the middle, at the edges, to the right of the middle, in the top row.
        let (width, height) = (64u32, 32u32);
        let texel = |at: u32| -> [f32; 3] {
            let (x, y) = (at % width, at / width);
            match (x, y) {
                (_, 0..6) => [1.0; 3],
                (28..36, _) => [1.0, 0.0, 0.0],
                (0..4 | 60..64, _) => [0.0, 1.0, 0.0],
                (44..52, _) => [0.0, 0.0, 1.0],
                _ => [0.0; 3],
            }
        };
        let floats: Vec<f32> = (0..width * height).flat_map(texel).collect();
        let map = EnvironmentMap::new(Pixels::Floats(&floats), width, height, 3).unwrap();
        let Grid { side, start } = map.grids()[0];
        let mut found = 0;
        for at in 0..side * side {
            let direction = node(side, at);
            let first = (start + 3 * at) as usize;
            for (axis, light) in [
                (DVec3::X, [1.0, 0.0, 0.0]),
                (-DVec3::X, [0.0, 1.0, 0.0]),
                (DVec3::Z, [0.0, 0.0, 1.0]),
                (DVec3::Y, [1.0; 3]),
            ] {
                if direction.dot(axis) > 0.97 {
                    assert_eq!(map.values()[first..first + 3], light, "{direction}");
                    found += 1;
                }
            }
        }
        assert!(found > 1000, "{found}");
    }

    #[test]
    fn what_is_no_map_is_refused() {
        let new = |floats: &[f32], width, height| {
            EnvironmentMap::new(Pixels::Floats(floats), width, height, 1).unwrap_err().to_string()
        };
        for (width, height) in [(0, 0), (3, 2), (2, 2), (2, 0)] {
            assert!(new(&vec![1.0; (width * height) as usize], width, height).contains("twice as wide"));
        }
        assert!(new(&[1.0; 3], 2, 1).contains("3 numbers are no 2 x 1 pixels"));
        for bad in [f32::NAN, f32::INFINITY, -1.0, 1e19] {
            assert!(new(&[0.5, bad], 2, 1).contains("at row 0, column 1"), "{bad}");
        }
    }
}
