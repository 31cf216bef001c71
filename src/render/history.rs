//! What the frame before showed: drawn first in the next one, it hides most of the rest.
//!
//! A hint and no more: whatever comes first, the picture is the same. So pixels are sampled, slots may have got
//! other instances, and a jump of the camera costs time at most.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use crate::cpu::cluster_cull::CandidateCluster;
use crate::cpu::visibility::Pixel;
use crate::model::ClusterAddress;
use crate::views::{InstanceView, Visible};

/// Of so many columns and of so many rows one is looked at.
const EVERY: usize = 2;

/// Clusters that a frame showed.
#[derive(Debug, Default)]
pub(super) struct VisibilityHistory {
    /// Each with the slot of its instance, in ascending order.
    clusters: Vec<(u32, ClusterAddress)>,
    /// By slot, as far as any was seen.
    instances: Vec<bool>,
}

impl VisibilityHistory {
    /// Whether any cluster of the instance was seen.
    pub(super) fn instance(&self, view: &InstanceView) -> bool {
        self.instances.get(view.slot as usize).is_some_and(|seen| *seen)
    }

    /// Whether the cluster was seen.
    pub(super) fn cluster(&self, view: &InstanceView, of: Visible) -> bool {
        self.clusters.binary_search(&(view.slot, of.cluster)).is_ok()
    }

    /// Forgets.
    pub(super) fn clear(&mut self) {
        self.clusters.clear();
        self.instances.clear();
    }

    /// Takes note of the clusters of `list` that pixels, in rows of `width`, show; depth alone shows none.
    pub(super) fn note<P: Pixel>(
        &mut self,
        pixels: &[P],
        width: usize,
        list: &[CandidateCluster],
        views: &[InstanceView],
    ) {
        let marks: Vec<AtomicBool> = list.iter().map(|_| AtomicBool::new(false)).collect();
        pixels.par_chunks(EVERY * width).with_min_len(16).for_each(|rows| {
            let numbers = rows[..width].iter().step_by(EVERY).filter_map(|pixel| pixel.visible());
            numbers.for_each(|number| marks[number as usize].store(true, Ordering::Relaxed));
        });
        self.clear();
        for (candidate, seen) in list.iter().zip(marks) {
            if seen.into_inner() {
                let Visible { instance, cluster } = candidate.visible;
                self.clusters.push((views[instance as usize].slot, cluster));
            }
        }
        self.clusters.sort_unstable();
        self.instances.resize(self.clusters.last().map_or(0, |(slot, _)| *slot as usize + 1), false);
        self.clusters.iter().for_each(|(slot, _)| self.instances[*slot as usize] = true);
    }
}
