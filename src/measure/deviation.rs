//! How far a surface moved.

use super::tree::TriangleTree;

/// A mesh whose vertices may have moved: triangles over positions.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Positions.
    pub positions: &'a [[f32; 3]],
    /// Three per triangle.
    pub indices: &'a [u32],
}

/// The larger of `estimate` and the distances of `probes` (points of one surface) to the other surface.
///
/// An estimate that is nearly right makes this cheap: a probe is done as soon as anything within the largest
/// distance so far is found.
pub fn deviation(surface: Surface<'_>, probes: impl Iterator<Item = [f32; 3]>, estimate: f32) -> f32 {
    let tree = TriangleTree::new(surface.positions, surface.indices);
    let mut leaf = 0;
    let largest = probes
        .fold(estimate * estimate, |most, p| most.max(tree.squared_distance_beyond(p, most, &mut leaf)));
    largest.sqrt()
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
        let probes = [[5.25, 0.25, 0.5], [390.25, 0.25, 2.0], [100.25, 0.25, -1.5]];
        assert_eq!(deviation(surface, probes.into_iter(), 0.0), 2.0);
        assert_eq!(deviation(surface, probes.into_iter(), 3.0), 3.0);
    }
}
