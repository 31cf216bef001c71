//! Stage 1. Instances of the scene → instances on the screen, in scene order.

use rayon::prelude::*;

use crate::scene::placement::Eye;
use crate::scene::{Instance, View};
use crate::stream::Resident;
use crate::views::{InstanceView, Occluder, Screen};

/// Instances per task.
const INSTANCES_PER_TASK: usize = 64;

/// Keeps the visible instances whose bounds meet the view, and derives their matrices. `instances` holds slot
/// numbers and entries in scene order.
pub fn run(
    instances: &[(u32, &Instance)],
    view: &View,
    eye: &Eye,
    screen: &Screen,
    resident: &Resident,
) -> Vec<InstanceView> {
    let planes = view.planes();
    let place = view.eye();
    let chunks: Vec<Vec<InstanceView>> = instances
        .par_chunks(INSTANCES_PER_TASK)
        .map(|chunk| {
            chunk
                .iter()
                .filter_map(|&(slot, instance)| {
                    let (center, radius) = instance.sphere();
                    let to = center - place;
                    // f64: this much covers the rounding of the sphere and the test.
                    let radius = radius + 1.0e-12 * (center.length() + place.length());
                    // What is drawn of points and lines reaches beyond their vertices by pixels.
                    let outside = || planes.iter().any(|(n, d)| n.dot(to) + d < -radius);
                    if !instance.visible || instance.is_ordinary() && outside() {
                        return None;
                    }
                    let mut seen = InstanceView::new(eye, screen, slot, instance, resident);
                    let (center, extent) = seen.bounds();
                    seen.footprint = seen.footprint(screen, center, extent)?;
                    Some(seen)
                })
                .collect()
        })
        .collect();
    chunks.into_iter().flatten().collect()
}

/// A later round: keeps the numbers of instances that the depth pyramid does not hide.
pub fn unhidden(numbers: &[u32], views: &[InstanceView], hzb: &impl Occluder) -> Vec<u32> {
    numbers.iter().copied().filter(|&i| !hzb.hides(&views[i as usize].footprint)).collect()
}
