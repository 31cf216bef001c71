//! The area of a surface's silhouette, over many directions: foliage keeps it as its leaves become fewer.

use serde::{Deserialize, Serialize};

use crate::math::Aabb;

/// View directions: the axes, and the diagonals of a cube and of its faces.
const DIRECTIONS: [[f64; 3]; 13] = [
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, 1.0, 1.0],
    [-1.0, 1.0, 1.0],
    [1.0, -1.0, 1.0],
    [1.0, 1.0, -1.0],
    [1.0, 1.0, 0.0],
    [1.0, -1.0, 0.0],
    [1.0, 0.0, 1.0],
    [1.0, 0.0, -1.0],
    [0.0, 1.0, 1.0],
    [0.0, 1.0, -1.0],
];
/// Bisections that find a number.
const HALVINGS: usize = 8;
/// Rows, and pixels of a row.
const SIZE: usize = u128::BITS as usize;

/// Images of one bit per pixel: parallel projections of the drawn triangles.
#[derive(Clone, Debug)]
pub struct Silhouettes {
    center: [f64; 3],
    /// Pixels per unit.
    scale: f64,
    /// Rightwards and upwards, unit vectors, of each view.
    axes: Vec<[[f64; 3]; 2]>,
    /// A row after the other, view after view.
    rows: Vec<u128>,
}

/// The area that is covered inside a box.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Silhouette {
    /// The box.
    pub bounds: Aabb,
    /// Pixels, over all views.
    pub covered: u32,
}

impl Silhouette {
    /// The area that triangles cover inside a box around them.
    pub fn of(bounds: Aabb, positions: &[[f32; 3]], indices: &[u32]) -> Self {
        let mut silhouettes = Silhouettes::new(&bounds);
        silhouettes.draw_all(positions, indices);
        Self { bounds, covered: silhouettes.covered() }
    }

    /// The number between `low` and `high` for which as much is covered, where more means more.
    pub fn solve(&self, mut low: f64, mut high: f64, covered: impl Fn(f64) -> u32) -> f64 {
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if covered(middle) < self.covered {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt();
    a.map(|x| x / length)
}

impl Silhouettes {
    /// Empty images of a box.
    pub fn new(bounds: &Aabb) -> Self {
        let views = |direction: &[f64; 3]| {
            // Never parallel to any of the directions.
            let right = unit(cross(*direction, [0.6, 0.48, 0.64]));
            [right, unit(cross(*direction, right))]
        };
        let diagonal = f64::from(bounds.diagonal());
        Self {
            center: [0, 1, 2].map(|k| (f64::from(bounds.min[k]) + f64::from(bounds.max[k])) * 0.5),
            scale: if diagonal > 0.0 { SIZE as f64 / diagonal } else { 0.0 },
            axes: DIRECTIONS.iter().map(views).collect(),
            rows: vec![0; DIRECTIONS.len() * SIZE],
        }
    }

    /// Draws triangles.
    pub fn draw_all(&mut self, positions: &[[f32; 3]], indices: &[u32]) {
        indices.chunks_exact(3).for_each(|t| self.draw([0, 1, 2].map(|k| positions[t[k] as usize])));
    }

    /// Draws a triangle: pixels with their centres inside.
    pub fn draw(&mut self, triangle: [[f32; 3]; 3]) {
        let p = triangle.map(|p| [0, 1, 2].map(|k| (f64::from(p[k]) - self.center[k]) * self.scale));
        for (axes, rows) in self.axes.iter().zip(self.rows.chunks_exact_mut(SIZE)) {
            let at = |p: [f64; 3]| axes.map(|a| a[0] * p[0] + a[1] * p[1] + a[2] * p[2] + 0.5 * SIZE as f64);
            fill(p.map(at), rows);
        }
    }

    /// Adds what others of the same box show.
    #[must_use]
    pub fn union(mut self, other: &Self) -> Self {
        self.rows.iter_mut().zip(&other.rows).for_each(|(row, other)| *row |= other);
        self
    }

    /// Pixels covered, over all views.
    pub fn covered(&self) -> u32 {
        self.rows.iter().map(|row| row.count_ones()).sum()
    }
}

fn fill(p: [[f64; 2]; 3], rows: &mut [u128]) {
    let low = p.iter().fold(f64::INFINITY, |low, p| low.min(p[1]));
    let high = p.iter().fold(f64::NEG_INFINITY, |high, p| high.max(p[1]));
    let pixel = |x: f64| (x - 0.5).ceil().clamp(0.0, SIZE as f64) as usize;
    for row in pixel(low)..pixel(high) {
        let y = row as f64 + 0.5;
        let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
        for (a, b) in [(p[0], p[1]), (p[1], p[2]), (p[2], p[0])] {
            if (a[1] <= y) != (b[1] <= y) {
                let x = a[0] + (b[0] - a[0]) * ((y - a[1]) / (b[1] - a[1]));
                (left, right) = (left.min(x), right.max(x));
            }
        }
        let (left, right) = (pixel(left), pixel(right));
        if left < right {
            rows[row] |= (u128::MAX >> (SIZE - (right - left))) << left;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covers_the_mean_of_the_areas_seen() {
        // The three squares through the centre of a cube, seen along the axes and the diagonals.
        let bounds = Aabb { min: [-1.0; 3], max: [1.0; 3] };
        let mut silhouettes = Silhouettes::new(&bounds);
        silhouettes.draw([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]);
        silhouettes.draw([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]);
        let pixels = 4.0 * silhouettes.scale.powi(2) * (1.0 + 4.0 / 3f64.sqrt() + 4.0 / 2f64.sqrt());
        let covered = f64::from(silhouettes.covered());
        assert!((covered - pixels).abs() < 0.02 * pixels, "{covered} {pixels}");
    }
}
