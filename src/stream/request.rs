//! What frames ask for.

use std::sync::Arc;

use rustc_hash::FxHashMap;

use crate::model::Dag;

/// A page that a frame needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Page of its mesh.
    pub page: u32,
    /// Pixels by which the picture is off without it: what is drawn in its place projects to so much. Negative where
    /// that is expected of a later frame only, and then nearer to zero the more it is.
    pub pixels: f32,
}

impl Request {
    /// A page that a later frame is expected to need by so many pixels: it comes after all that this one needs.
    pub fn later(page: u32, pixels: f32) -> Self {
        Self { page, pixels: -1.0 / pixels.max(f32::MIN_POSITIVE) }
    }
}

/// The pages that a frame needs, there or not, each once, with the largest of the errors it was asked for.
#[derive(Debug, Default)]
pub struct Needs {
    /// By the numbers of the ids of meshes.
    meshes: FxHashMap<u64, FxHashMap<u32, f32>>,
    /// Largest error, pixels, of what the frame drew because what is finer was not there; 0 where nothing was.
    pub coarsest: f32,
}

impl Needs {
    /// Asks for a page of a mesh.
    pub fn add(&mut self, mesh: &Arc<Dag>, Request { page, pixels }: Request) {
        let most = self.meshes.entry(mesh.id.number()).or_default().entry(page).or_insert(pixels);
        *most = most.max(pixels);
    }

    /// Takes over what others ask for.
    pub fn merge(&mut self, other: Self) {
        self.coarsest = self.coarsest.max(other.coarsest);
        for (mesh, pages) in other.meshes {
            let own = self.meshes.entry(mesh).or_default();
            for (page, pixels) in pages {
                let most = own.entry(page).or_insert(pixels);
                *most = most.max(pixels);
            }
        }
    }

    /// What is asked for of a mesh, in the order of pages.
    pub(super) fn of(&self, mesh: &Arc<Dag>) -> Vec<Request> {
        let asked = self.meshes.get(&mesh.id.number()).into_iter().flatten();
        let mut requests: Vec<Request> = asked.map(|(&page, &pixels)| Request { page, pixels }).collect();
        requests.sort_unstable_by_key(|request| request.page);
        requests
    }
}
