//! Where everything was in the frame before, so that a frame can tell how far each pixel has moved.

use std::sync::Arc;

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
    /// By slot: which instance that is, its shape and its place.
    instances: FxHashMap<u32, (Handle, Arc<Dag>, Placement)>,
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
        Self {
            scene: scene.identity(),
            eye: frame.eye,
            screen: frame.screen,
            instances: slots.handles().zip(slots.iter()).map(instance).collect(),
        }
    }

    /// What `frame`, drawn of a scene later, shows as it was here; `None` for another scene.
    pub(super) fn of(&self, scene: &Scene, frame: &Frame) -> Option<Before> {
        if self.scene != scene.identity() {
            return None;
        }
        let orthographic = self.screen.orthographic;
        let as_it_was = |view: &InstanceView| {
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
}
