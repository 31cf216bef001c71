//! Means of the light around a direction, as surfaces of a roughness gather it. Instead of samples: a tree over the map whose
//! cells know their light, their solid angle and where it comes from, opened where they are large beside what the weight
//! changes over (after J. Barnes and P. Hut, "A hierarchical O(N log N) force-calculation algorithm", Nature 324, 1986). So a
//! sun of a few texels is never missed and never counted too often, and white stays white exactly.

use std::f64::consts::PI;

use rayon::prelude::*;

/// How much light counts, by the cosine of its angle to the direction that is asked for.
#[derive(Clone, Copy, Debug)]
pub enum Kernel {
    /// Irradiance: as on a diffuse surface that faces there.
    Cosine,
    /// As in a surface seen along its normal: GGX with this α, times the cosine.
    Ggx(f32),
}

impl Kernel {
    #[inline(always)]
    fn weight(self, cosine: f32) -> f32 {
        match self {
            _ if cosine <= 0.0 => 0.0,
            Self::Cosine => cosine,
            Self::Ggx(alpha) => {
                let d = 0.5 * (1.0 - cosine) + 0.5 * (1.0 + cosine) * (alpha * alpha);
                cosine / (d * d)
            }
        }
    }

    /// So much nearer cells count as that lie on both sides of the horizon, where it ends.
    fn horizon(self) -> f32 {
        match self {
            Self::Cosine => 0.1,
            Self::Ggx(alpha) => (0.1 / (alpha * alpha)).min(1.0),
        }
    }

    /// The angle near the middle that it changes over.
    fn width(self) -> f32 {
        match self {
            Self::Cosine => 1.0,
            Self::Ggx(alpha) => alpha,
        }
    }
}

/// A part of the sphere.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Mean light.
    light: [f32; 3],
    solid_angle: f32,
    /// The mean of its directions: of their cosines to another it gives the mean.
    middle: [f32; 3],
    /// The mean of those that its light comes from.
    origin: [f32; 3],
    /// Of a cone about that which holds the cell.
    radius: f32,
    /// Square of the distance from which on it is taken as a whole.
    whole: f32,
}

/// A map and its cells, from texels up, each level half as wide and high.
pub struct Tree {
    levels: Vec<(usize, Vec<Cell>)>,
}

/// The distance from which on a cell is taken as a whole, in its radius where its light is even, and up to four times as many
/// where a quarter of it has nearly all.
const WHOLE: f32 = 2.5;

impl Tree {
    /// Over a map of so many columns, its rows from +Y down, its columns around it from −X over −Z.
    pub fn new(texels: &[[f32; 3]], columns: usize) -> Self {
        let rows = texels.len() / columns;
        let (height, width) = (PI / rows as f64, 2.0 * PI / columns as f64);
        let row = |(y, texels): (usize, &[[f32; 3]])| -> Vec<Cell> {
            let (top, below) = (height * y as f64, height * (y + 1) as f64);
            let (sin, cos) = (0.5 * (top + below)).sin_cos();
            let solid_angle = (width * (top.cos() - below.cos())) as f32;
            let radius = (0.5 * height.hypot(width * sin)) as f32;
            let cell = |(x, light): (usize, &[f32; 3])| {
                let turn = width * (x as f64 + 0.5) - PI;
                let middle = [sin * turn.cos(), cos, sin * turn.sin()].map(|c| c as f32);
                Cell { light: *light, solid_angle, middle, origin: middle, radius, whole: 0.0 }
            };
            texels.iter().enumerate().map(cell).collect()
        };
        let cells = texels.par_chunks(columns).enumerate().flat_map_iter(row).collect();
        let mut levels = vec![(columns, cells)];
        while let Some((columns, cells)) =
            levels.last().filter(|(_, cells): &&(_, Vec<Cell>)| cells.len() > 1)
        {
            let (across, rows) = (columns.div_ceil(2), (cells.len() / columns).div_ceil(2));
            let parent = |at: usize| {
                let (x, y) = (at % across, at / across);
                merged(children(*columns, cells.len(), x, y).map(|child| cells[child]))
            };
            let next = (across, (0..across * rows).into_par_iter().map(parent).collect());
            levels.push(next);
        }
        Self { levels }
    }

    /// The weighted mean of the light about a unit direction.
    pub fn mean(&self, direction: [f32; 3], kernel: Kernel) -> [f32; 3] {
        let mut sum = [0.0f32; 4];
        self.add(self.levels.len() - 1, 0, &direction, kernel, &mut sum);
        let [r, g, b, weight] = sum;
        // None where a map were empty.
        let share = if weight > 0.0 { 1.0 / weight } else { 0.0 };
        [r * share, g * share, b * share]
    }

    /// Adds what is under a cell: light times weight, and weight.
    fn add(&self, level: usize, at: usize, toward: &[f32; 3], kernel: Kernel, sum: &mut [f32; 4]) {
        let (columns, cells) = &self.levels[level];
        let Cell { light, solid_angle, middle, origin, radius, whole } = &cells[at];
        let cosine = dot(middle, toward);
        // All of it may lie behind the surface.
        if cosine < -radius {
            return;
        }
        let mut away = kernel.width() * kernel.width() + 2.0 * (1.0 - cosine);
        if cosine < *radius {
            away *= kernel.horizon() * kernel.horizon();
        }
        if away < *whole {
            let (finer, cells) = &self.levels[level - 1];
            for child in children(*finer, cells.len(), at % columns, at / columns) {
                self.add(level - 1, child, toward, kernel, sum);
            }
        } else {
            let weight = solid_angle * kernel.weight(dot(origin, toward));
            (0..3).for_each(|k| sum[k] += weight * light[k]);
            sum[3] += solid_angle * kernel.weight(cosine);
        }
    }
}

/// The cells below one, of a level with so many columns and cells.
fn children(columns: usize, cells: usize, x: usize, y: usize) -> impl Iterator<Item = usize> + Clone {
    let rows = cells / columns;
    let side = |at: usize, end: usize| 2 * at..(2 * at + 2).min(end);
    side(y, rows).flat_map(move |y| side(x, columns).map(move |x| y * columns + x))
}

/// Cells as one.
fn merged(cells: impl Iterator<Item = Cell> + Clone) -> Cell {
    let mut light = [0.0f64; 3];
    let (mut origin, mut middle, mut solid_angle) = ([0.0f64; 3], [0.0f64; 3], 0.0);
    let mut sum = 0.0;
    for cell in cells.clone() {
        let own = f64::from(cell.solid_angle);
        let bright = own * cell.light.iter().map(|c| f64::from(*c)).sum::<f64>();
        for k in 0..3 {
            light[k] += own * f64::from(cell.light[k]);
            origin[k] += bright * f64::from(cell.origin[k]);
            middle[k] += own * f64::from(cell.middle[k]);
        }
        solid_angle += own;
        sum += bright;
    }
    let middle = middle.map(|c| (c / solid_angle) as f32);
    // Black comes from wherever it is.
    let origin = if sum > 0.0 { origin.map(|c| (c / sum) as f32) } else { middle };
    let brightness = |light: [f32; 3]| light.iter().sum::<f32>();
    let brightest = cells.clone().map(|cell| brightness(cell.light)).fold(0.0, f32::max);
    let mean = (sum / solid_angle) as f32;
    let uneven = if mean > 0.0 { brightest / mean } else { 1.0 };
    let axis = unit(middle);
    let reach = |cell: Cell| dot(&axis, &unit(cell.middle)).clamp(-1.0, 1.0).acos() + cell.radius;
    let radius = cells.map(reach).fold(0.0, f32::max);
    Cell {
        light: light.map(|c| (c / solid_angle) as f32),
        solid_angle: solid_angle as f32,
        middle,
        origin,
        radius,
        whole: (WHOLE * uneven * radius).powi(2),
    }
}

fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The unit vector; up for none.
fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = dot(&v, &v).sqrt();
    if length > f32::MIN_POSITIVE { v.map(|c| c / length) } else { [0.0, 1.0, 0.0] }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dim sky, a bright patch and a sun of a few texels.
    fn sky(rows: usize) -> Vec<[f32; 3]> {
        let columns = 2 * rows;
        (0..rows * columns)
            .map(|at| {
                let (x, y) = (at % columns, at / columns);
                let sky = 0.2 + 0.5 * (y as f32 / rows as f32);
                let patch = if x < rows / 2 && y > rows / 2 { 3.0 } else { 0.0 };
                let sun = if y == rows / 3 && (x == rows / 4 || x == rows / 4 + 1) { 4000.0 } else { 0.0 };
                [sky, sky + patch, sky + sun]
            })
            .collect()
    }

    /// The same by all texels, in f64.
    fn summed(texels: &[[f32; 3]], columns: usize, n: [f64; 3], weight: impl Fn(f64) -> f64) -> [f64; 3] {
        let rows = texels.len() / columns;
        let (height, width) = (PI / rows as f64, 2.0 * PI / columns as f64);
        let (mut sum, mut whole) = ([0.0; 3], 0.0);
        for (at, texel) in texels.iter().enumerate() {
            let (y, x) = (at / columns, at % columns);
            let (top, turn) = (height * y as f64, width * (x as f64 + 0.5) - PI);
            let (sin, cos) = (top + 0.5 * height).sin_cos();
            let cosine = n[0] * sin * turn.cos() + n[1] * cos + n[2] * sin * turn.sin();
            if cosine > 0.0 {
                let own = width * (top.cos() - (top + height).cos()) * weight(cosine);
                (0..3).for_each(|k| sum[k] += own * f64::from(texel[k]));
                whole += own;
            }
        }
        sum.map(|c| c / whole)
    }

    #[test]
    fn cells_give_what_all_texels_give() {
        let rows = 256;
        let texels = sky(rows);
        let tree = Tree::new(&texels, 2 * rows);
        let alphas = [0.015_625f32, 0.0625, 0.25, 1.0];
        let kernels = [Kernel::Cosine].into_iter().chain(alphas.map(Kernel::Ggx));
        for kernel in kernels {
            let (mut worst, mut most) = ([0.0f64; 3], [0.0f64; 3]);
            for i in 0..150 {
                // All around, and at the sun and close to it.
                let (cos, turn) = (1.0 - (f64::from(i) + 0.5) / 75.0, 2.4 * f64::from(i));
                let sin = (1.0f64 - cos * cos).sqrt();
                let mut n = [sin * turn.cos(), cos, sin * turn.sin()];
                if i % 3 == 0 {
                    let near = [0.006, 0.5, -0.866];
                    n = [0, 1, 2].map(|k| near[k] + n[k] * 0.001 * f64::from(i));
                    let length = n.iter().map(|c| c * c).sum::<f64>().sqrt();
                    n = n.map(|c| c / length);
                }
                let got = tree.mean(n.map(|c| c as f32), kernel);
                let expected = summed(&texels, 2 * rows, n, |cosine| match kernel {
                    Kernel::Cosine => cosine,
                    Kernel::Ggx(alpha) => {
                        let alpha2 = f64::from(alpha).powi(2);
                        cosine / (0.5 * (1.0 + cosine) * (alpha2 - 1.0) + 1.0).powi(2)
                    }
                });
                for k in 0..3 {
                    worst[k] = worst[k].max((f64::from(got[k]) - expected[k]).abs());
                    most[k] = most[k].max(expected[k]);
                }
            }
            let bound = match kernel {
                Kernel::Cosine => 0.002,
                Kernel::Ggx(_) => 0.075,
            };
            assert!((0..3).all(|k| worst[k] < bound * most[k]), "{kernel:?}: off by {worst:?} of {most:?}");
        }
    }

    #[test]
    fn white_stays_white() {
        let tree = Tree::new(&vec![[1.0, 0.5, 2.0]; 2 * 32 * 32], 64);
        for kernel in [Kernel::Cosine, Kernel::Ggx(0.1)] {
            for n in [[0.0, 1.0, 0.0], [0.6, 0.0, -0.8]] {
                let mean = tree.mean(n, kernel);
                assert!((0..3).all(|k| (mean[k] / [1.0, 0.5, 2.0][k] - 1.0).abs() < 1e-5), "{mean:?}");
            }
        }
    }
}
