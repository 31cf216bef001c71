//! Which pages a frame may draw.

use std::sync::Arc;

use rustc_hash::FxHashMap;

use crate::model::{Dag, Pages};

/// The pages of streamed meshes that are there, as of one moment: later arrivals and evictions do not change it.
#[derive(Clone, Debug, Default)]
pub struct Resident {
    pub(super) meshes: FxHashMap<u64, Arc<Pages>>,
    /// Their pages but for those of roots.
    pub(super) held: usize,
    /// How many of these the pool has room for.
    pub(super) most: usize,
}

impl Resident {
    /// Puts the pages of a mesh in place of its own.
    pub(super) fn set(&mut self, mesh: &Arc<Dag>, pages: Arc<Pages>) {
        self.meshes.insert(mesh.id.number(), pages);
    }

    /// The pages of a mesh that may be drawn: its own, unless it is streamed.
    pub fn pages<'a>(&'a self, mesh: &'a Arc<Dag>) -> &'a Arc<Pages> {
        if self.is_empty() {
            return &mesh.pages;
        }
        self.meshes.get(&mesh.id.number()).unwrap_or(&mesh.pages)
    }

    /// Whether no mesh is streamed.
    pub fn is_empty(&self) -> bool {
        self.meshes.is_empty()
    }

    /// How many pages of streamed meshes there are besides root pages.
    pub fn held(&self) -> usize {
        self.held
    }

    /// How many of these the pool has room for.
    pub fn most(&self) -> usize {
        self.most
    }

    /// How many pages the streamed meshes have, there or not.
    pub fn total(&self) -> usize {
        self.meshes.values().map(|pages| pages.table.len()).sum()
    }

    /// Whether a mesh is streamed.
    pub fn streams(&self, mesh: &Arc<Dag>) -> bool {
        self.meshes.contains_key(&mesh.id.number())
    }
}
