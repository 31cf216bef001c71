//! What a frame needs of the meshes that are streamed: the pages of what it drew, and those that it missed.
//!
//! With all of them there, the frame is the one of the whole mesh, bit for bit: every cluster it drew is then one of the
//! cut, and what else the cut has is hidden by what was drawn.

use rustc_hash::FxHashSet;

use super::renderer::{DrawnView, Rastered};
use crate::cpu::hzb::Hzb;
use crate::cpu::node_cull::CandidateGroup;
use crate::cpu::{instance_cull, node_cull};
use crate::model::rule::Threshold;
use crate::scene::placement::Eye;
use crate::scene::{Instance, Scene, View};
use crate::stream::{Needs, Request, Resident};
use crate::views::{InstanceView, Screen};

/// Frames that are looked ahead: while these are drawn, a disk brings what they will need.
const AHEAD: usize = 8;

/// Groups that were to be drawn and whose pages are not there.
pub(super) fn missed(absent: &[CandidateGroup], views: &[InstanceView]) -> Needs {
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
    if resident.is_empty() {
        return;
    }
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
        let (sphere, error) = view.mesh.own_error(record);
        if Threshold::View(view.lod, tau).exceeded_by(&sphere, error) {
            let pixels = view.lod.pixels(&sphere, error);
            needs.add(&view.mesh, Request { page: record.refined_page, pixels });
            needs.coarsest = needs.coarsest.max(pixels);
        }
    }
}

/// The pages that moving on as from `before` to `now` will bring into the cut: what the view a few frames ahead refines
/// and this one does not. Nothing is left out for being hidden, so that they come after all that is needed now.
pub(super) fn expected(
    scene: &Scene,
    before: &[DrawnView],
    now: &[DrawnView],
    resident: &Resident,
    needs: &mut Needs,
) {
    if resident.is_empty() {
        return;
    }
    let streamed = |(_, instance): &(u32, &Instance)| resident.streams(&instance.mesh);
    let instances: Vec<(u32, &Instance)> = scene.instances().iter().filter(streamed).collect();
    for DrawnView { id, view: now, options } in now {
        let tau = options.pixel_error;
        let Some(before) = before.iter().find(|other| other.id == *id) else { continue };
        let Some(ahead) = now.ahead(&before.view, AHEAD) else { continue };
        let (found, _) = refined(&instances, now, tau, resident);
        let known: FxHashSet<(u32, u32)> = found.iter().map(|(slot, group, _)| (*slot, *group)).collect();
        let (found, views) = refined(&instances, &ahead, tau, resident);
        for (slot, group, view) in found {
            if !known.contains(&(slot, group)) {
                let view = &views[view as usize];
                let group = &view.mesh.groups[group as usize];
                let pixels = view.lod.pixels(&group.lod_sphere, group.error);
                needs.add(&view.mesh, Request::later(group.first.page() as u32, pixels));
            }
        }
    }
}

/// The groups that a view refines, there or not: slot of the instance, group, and which of the instances on the screen.
fn refined(
    instances: &[(u32, &Instance)],
    view: &View,
    tau: f32,
    resident: &Resident,
) -> (Vec<(u32, u32, u32)>, Vec<InstanceView>) {
    let (eye, screen) = (Eye::new(view), Screen::new(view));
    let views = instance_cull::run(instances, view, &eye, &screen, resident);
    let all: Vec<u32> = (0..views.len() as u32).collect();
    let walk = node_cull::run(&all, &views, &screen, tau, None::<&Hzb>);
    let found = walk.groups.iter().chain(&walk.absent);
    (found.map(|at| (views[at.instance as usize].slot, at.group, at.instance)).collect(), views)
}
