//! Where everything was in the frame before, so that a frame can tell how far each pixel has moved.

use std::sync::Arc;

use glam::DAffine3;
use rustc_hash::FxHashMap;

use super::frame::Frame;
use crate::model::Dag;
use crate::scene::placement::{Eye, Placement};
use crate::scene::{Handle, Instance, Scene};
use crate::views::{InstanceView, Screen};

/// Where the instances of a scene and the eye are.
#[derive(Debug)]
pub(super) struct Stance {
    scene: u64,
    eye: Eye,
    screen: Screen,
    /// By slot: which instance that is, its shape and its place. Parts of assemblies are where these were.
    instances: FxHashMap<u32, (Handle, Arc<Dag>, Placement)>,
    /// Poses of instances of assemblies by slot.
    assemblies: FxHashMap<u32, DAffine3>,
}

/// What a frame shows as it was in the frame before.
#[derive(Debug)]
pub(super) struct Before {
    /// The frame's instances there. One that was not there yet stands where it is.
    pub(super) views: Vec<InstanceView>,
    /// That frame's screen.
    pub(super) screen: Screen,
}

impl Stance {
    /// That of a frame which was drawn of a scene.
    pub(super) fn new(scene: &Scene, frame: &Frame) -> Self {
        let instance = |(handle, (slot, instance)): (Handle, (u32, &Instance))| {
            (slot, (handle, Arc::clone(&instance.mesh), *instance.placement()))
        };
        let slots = scene.instances();
        let whole = |(_, (slot, _)): &(Handle, (u32, &Instance))| scene.owners().of(*slot) == *slot;
        let assembly = |(slot, instance): (u32, &Instance)| {
            instance.assembly.is_some().then(|| (slot, *instance.pose()))
        };
        Self {
            scene: scene.origin(),
            eye: frame.eye,
            screen: frame.screen,
            instances: slots.handles().zip(slots.iter()).filter(whole).map(instance).collect(),
            assemblies: slots.iter().filter_map(assembly).collect(),
        }
    }

    /// What `frame`, drawn of a scene later, shows as it was here; `None` for another scene.
    pub(super) fn of(&self, scene: &Scene, frame: &Frame) -> Option<Before> {
        if self.scene != scene.origin() {
            return None;
        }
        let orthographic = self.screen.orthographic;
        let as_it_was = |view: &InstanceView| {
            let owner = scene.owners().of(view.slot);
            if owner != view.slot {
                let placed =
                    scene.instances().at(view.slot as usize).map(|part| self.part(scene, owner, part));
                return placed.map_or_else(|| view.clone(), |at| view.moved_to(&self.eye, orthographic, &at));
            }
            let known = self.instances.get(&view.slot);
            let now = scene.instances().at(view.slot as usize);
            match (known, now) {
                (Some((handle, mesh, placement)), Some(_)) if scene.instances().get(*handle).is_ok() => {
                    let mut was = view.moved_to(&self.eye, orthographic, placement);
                    if !Arc::ptr_eq(mesh, &view.mesh)
                        && mesh.pages.cluster_count() == view.pages.cluster_count()
                    {
                        (was.mesh, was.pages) = (Arc::clone(mesh), Arc::clone(&mesh.pages));
                    }
                    was
                }
                (_, Some(instance)) => view.moved_to(&self.eye, orthographic, instance.placement()),
                _ => view.clone(),
            }
        };
        Some(Before { views: frame.views.iter().map(as_it_was).collect(), screen: self.screen })
    }

    /// Where a part of an instance of an assembly was: it moves with the whole.
    fn part(&self, scene: &Scene, owner: u32, part: &Instance) -> Placement {
        let same = |(handle, ..): &&(Handle, Arc<Dag>, Placement)| scene.instances().get(*handle).is_ok();
        let known = self.instances.get(&owner).filter(same).and_then(|_| self.assemblies.get(&owner));
        match (known, scene.instances().at(owner as usize)) {
            // Nothing is rounded of what stands still.
            (Some(was), Some(now)) if was != now.pose() => {
                part.placement_at(&(*was * now.pose().inverse() * *part.pose()))
            }
            _ => *part.placement(),
        }
    }
}
