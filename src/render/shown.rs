//! What the frame before showed: drawn first in the next one, it hides most of the rest.
//!
//! A hint and no more: whatever comes first, the picture is the same. So pixels are sampled, slots may have got
//! other instances, and a jump of the camera costs time at most.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use crate::cpu::cluster_cull::Candidate;
use crate::cpu::project::InstanceView;
use crate::cpu::visibility::{Pixel, Visible};
use crate::model::ClusterAddress;

/// Of so many columns and of so many rows one is looked at.
const EVERY: usize = 2;

/// Clusters that a frame showed, each with the slot of its instance, in ascending order.
#[derive(Debug, Default)]
pub(super) struct Shown(Vec<(u32, ClusterAddress)>);

impl Shown {
    /// Whether any cluster of the instance was seen.
    pub(super) fn instance(&self, view: &InstanceView) -> bool {
        let at = self.0.partition_point(|(slot, _)| *slot < view.slot);
        self.0.get(at).is_some_and(|(slot, _)| *slot == view.slot)
    }

    /// Whether the cluster was seen.
    pub(super) fn cluster(&self, view: &InstanceView, of: Visible) -> bool {
        self.0.binary_search(&(view.slot, of.cluster)).is_ok()
    }

    /// Forgets.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Takes note of the clusters of `list` that pixels, in rows of `width`, show; depth alone shows none.
    pub(super) fn note<P: Pixel>(
        &mut self,
        pixels: &[P],
        width: usize,
        list: &[Candidate],
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
                self.0.push((views[instance as usize].slot, cluster));
            }
        }
        self.0.sort_unstable();
    }
}
