//! The vertices of some pages in slabs across the longest axis, for what looks at all vertices with one position: each slab has
//! few enough to be held at a time.

use std::ops::Range;

use crate::model::Dag;

/// Clusters of a slab at most, about: some five million vertices, of which 32 bytes are kept each.
const SLAB_CLUSTERS: usize = 1 << 16;
/// By how much boxes of groups may be too small; [`super::check`] allows for less.
const SLACK: f32 = 1.0e-6;

/// Slabs of vertices, and the pages that reach into them.
pub struct Slabs {
    axis: usize,
    /// Where slabs begin along the axis, but for the first.
    begins: Vec<f32>,
    /// Pages with the slabs that they reach into.
    pages: Vec<(usize, Range<usize>)>,
}

impl Slabs {
    /// Slabs of pages that have so many clusters of interest each.
    pub fn new(dag: &Dag, pages: &[(usize, usize)]) -> Self {
        let size = |axis: usize| dag.bounds.max[axis] - dag.bounds.min[axis];
        let axis = (0..3).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(0);
        let reach = |page: usize| {
            let ends = dag.groups_of(page).map(|g| {
                let group = &dag.groups[g];
                [group.center[axis] - group.extent[axis], group.center[axis] + group.extent[axis]]
            });
            ends.fold([f32::INFINITY, f32::NEG_INFINITY], |a, b| [a[0].min(b[0]), a[1].max(b[1])])
        };
        let reaches: Vec<[f32; 2]> = pages.iter().map(|(page, _)| reach(*page)).collect();
        let mut middles: Vec<(f32, usize)> = reaches
            .iter()
            .zip(pages)
            .map(|([low, high], (_, clusters))| ((low + high) * 0.5, *clusters))
            .collect();
        middles.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut begins = Vec::new();
        let mut clusters = 0;
        for (middle, own) in middles {
            if clusters + own > SLAB_CLUSTERS && clusters > 0 {
                begins.push(middle);
                clusters = 0;
            }
            clusters += own;
        }
        let of = |x: f32| begins.partition_point(|begin| *begin <= x);
        let slabs = |[low, high]: [f32; 2]| match low <= high {
            true => of(low - SLACK)..of(high + SLACK) + 1,
            // Whatever is wrong with them is found in one slab or another.
            false => 0..begins.len() + 1,
        };
        let pages = pages.iter().zip(reaches).map(|((page, _), reach)| (*page, slabs(reach))).collect();
        Self { axis, begins, pages }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.begins.len() + 1
    }

    /// The slab of a position.
    pub fn of(&self, p: [f32; 3]) -> usize {
        self.begins.partition_point(|begin| *begin <= p[self.axis])
    }

    /// Pages that may have vertices in a slab.
    pub fn pages(&self, slab: usize) -> Vec<usize> {
        self.pages.iter().filter(|(_, slabs)| slabs.contains(&slab)).map(|(page, _)| *page).collect()
    }
}
