//! What a frame needs of the meshes that are streamed: the pages of what it drew, and those that it missed.
//!
//! With all of them there, the frame is the one of the whole mesh, bit for bit: every cluster it drew is then one of the
//! cut, and what else the cut has is hidden by what was drawn.

use super::renderer::Rastered;
use crate::cpu::node_cull::GroupCandidate;
use crate::cpu::project::InstanceView;
use crate::model::rule::Threshold;
use crate::stream::{Needs, Request, Resident};

/// Groups that were to be drawn and whose pages are not there.
pub(super) fn missed(absent: &[GroupCandidate], views: &[InstanceView]) -> Needs {
    let mut needs = Needs::default();
    for at in absent {
        let view = &views[at.instance as usize];
        let group = &view.mesh.groups[at.group as usize];
        let pixels = view.lod.pixels(&group.lod_sphere, group.error);
        needs.add(&view.mesh, Request { page: group.first.page() as u32, pixels });
    }
    needs
}

/// The pages of what was drawn; and where something stands in for what is finer and not there, those of the latter.
pub(super) fn drawn(frame: &Rastered, tau: f32, resident: &Resident, needs: &mut Needs) {
    let mut last = None;
    for visible in &frame.visible {
        let view = &frame.views[visible.instance as usize];
        if !resident.streams(&view.mesh) {
            continue;
        }
        let record = view.pages.record(visible.cluster);
        // The clusters of a group follow each other.
        if last != Some((visible.instance, record.group)) {
            last = Some((visible.instance, record.group));
            let group = &view.mesh.groups[record.group as usize];
            let pixels = view.lod.pixels(&group.lod_sphere, group.error);
            needs.add(&view.mesh, Request { page: visible.cluster.page() as u32, pixels });
        }
        if Threshold::View(view.lod, tau).exceeded_by(&record.lod_sphere, record.error) {
            let pixels = view.lod.pixels(&record.lod_sphere, record.error);
            needs.add(&view.mesh, Request { page: record.refined_page, pixels });
            needs.coarsest = needs.coarsest.max(pixels);
        }
    }
}
