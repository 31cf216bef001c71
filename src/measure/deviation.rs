//! How far a surface moved.

use super::tree::TriangleTree;
use super::triangle::{Prism, squared_distance};

/// A mesh whose vertices may have moved: triangles over positions.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Positions.
    pub positions: &'a [[f32; 3]],
    /// Three per triangle.
    pub indices: &'a [u32],
}

/// The triangles around each vertex.
#[derive(Debug)]
pub struct Stars {
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl Stars {
    /// The stars of `vertices` vertices in an index buffer.
    pub fn new(vertices: usize, indices: &[u32]) -> Self {
        // Counted two places ahead, so that filling leaves the starts where they belong.
        let mut starts = vec![0u32; vertices + 2];
        indices.iter().for_each(|v| starts[*v as usize + 2] += 1);
        for i in 2..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut triangles = vec![0; indices.len()];
        for (corner, v) in indices.iter().enumerate() {
            let at = &mut starts[*v as usize + 1];
            triangles[*at as usize] = corner as u32 / 3;
            *at += 1;
        }
        Self { starts, triangles }
    }

    /// The triangles around a vertex.
    pub fn of(&self, vertex: u32) -> &[u32] {
        &self.triangles[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }
}

/// The larger of `estimate` and the distances of `probes` (points of one surface) to the other surface. Each
/// probe comes with vertices of that other surface that are probably near.
///
/// An estimate that is nearly right makes this cheap: a probe is done as soon as anything within the largest
/// distance so far is found, mostly around the vertices named.
pub fn deviation<N: Iterator<Item = u32> + Clone>(
    surface: Surface<'_>,
    stars: &Stars,
    probes: impl Iterator<Item = ([f32; 3], N)>,
    estimate: f32,
) -> f32 {
    let tree = TriangleTree::new(surface.positions, surface.indices);
    let mut most = estimate * estimate;
    let prisms: Vec<Prism> = tree.triangles().iter().map(|t| Prism::new(*t)).collect();
    'probes: for (p, near) in probes {
        for v in near.clone() {
            for t in stars.of(v) {
                if prisms[*t as usize].is_within(p, most) {
                    continue 'probes;
                }
            }
        }
        let around = near.flat_map(|v| stars.of(v)).map(|t| tree.triangles()[*t as usize]);
        let best = around.fold(f32::INFINITY, |best, t| best.min(squared_distance(p, t)));
        most = most.max(tree.squared_distance_between(p, most, best));
    }
    most.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_farthest_probe_and_keeps_a_larger_estimate() {
        let positions: Vec<[f32; 3]> =
            (0..400).flat_map(|i| (0..2).map(move |j| [i as f32, j as f32, 0.0])).collect();
        let indices: Vec<u32> = (0..399u32).flat_map(|i| [2 * i, 2 * i + 2, 2 * i + 1]).collect();
        let surface = Surface { positions: &positions, indices: &indices };
        let stars = Stars::new(positions.len(), &indices);
        let probes = [([5.25, 0.25, 0.5], 10), ([390.25, 0.25, 2.0], 7), ([100.25, 0.25, -1.5], 200)];
        let probes = || probes.into_iter().map(|(p, near)| (p, std::iter::once(near)));
        assert_eq!(deviation(surface, &stars, probes(), 0.0), 2.0);
        assert_eq!(deviation(surface, &stars, probes(), 3.0), 3.0);
    }
}
