//! Meshes on the device: uploaded once, one after the other in four arrays.

use std::sync::Arc;

use rustc_hash::FxHashMap;
use wgpu::{Buffer, BufferUsages};

use super::context::Context;
use crate::error::Result;
use crate::model::{Dag, Group, Node};

/// Where a mesh starts in each array, and what its streams look like.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// First node.
    pub first_node: u32,
    /// First group.
    pub first_group: u32,
    /// First entry of the table of pages.
    pub first_page: u32,
    /// Words per vertex.
    pub vertex_words: u32,
    /// Levels of its hierarchy.
    pub depth: u32,
}

/// Elements of the four arrays: nodes, groups, entries of the table of pages, words of pages.
type Sizes = [u64; 4];

/// What each array holds, for messages, and bytes per element.
const ARRAYS: [(&str, u64); 4] = [
    ("the nodes of the meshes", size_of::<Node>() as u64),
    ("the groups of the meshes", size_of::<Group>() as u64),
    ("the page tables of the meshes", 4),
    ("the clusters of the meshes", 4),
];

/// All meshes on the device.
#[derive(Debug, Default)]
pub struct Meshes {
    /// By address, which is stable while the mesh is held.
    resident: FxHashMap<usize, (Arc<Dag>, Placement)>,
    buffers: Vec<Buffer>,
    used: Sizes,
    room: Sizes,
}

fn address(mesh: &Arc<Dag>) -> usize {
    Arc::as_ptr(mesh).addr()
}

fn sizes(mesh: &Dag) -> Sizes {
    let pages = &mesh.pages;
    [mesh.nodes.len(), mesh.groups.len(), pages.table.len(), pages.words.len()].map(|n| n as u64)
}

fn sum(a: Sizes, b: Sizes) -> Sizes {
    std::array::from_fn(|k| a[k] + b[k])
}

/// Nodes on the longest way from the root to a group. Children have larger numbers than their parent.
fn depth(mesh: &Dag) -> u32 {
    let mut depths = vec![1; mesh.nodes.len()];
    for (i, node) in mesh.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf == 0) {
        for child in node.first..node.first + u32::from(node.count) {
            depths[child as usize] = depths[i] + 1;
        }
    }
    depths.into_iter().max().unwrap_or(0)
}

impl Meshes {
    /// Makes sure that all of `meshes` are there. Where there is no room, only these stay.
    pub fn upload<'a>(
        &mut self,
        context: &Context,
        meshes: impl Iterator<Item = &'a Arc<Dag>> + Clone,
    ) -> Result<()> {
        let mut new = self.missing(meshes.clone());
        if new.is_empty() {
            return Ok(());
        }
        let needed = new.iter().fold(self.used, |total, mesh| sum(total, sizes(mesh)));
        if (0..ARRAYS.len()).any(|k| needed[k] > self.room[k]) {
            *self = Self::default();
            new = self.missing(meshes);
            let needed = new.iter().fold(Sizes::default(), |total, mesh| sum(total, sizes(mesh)));
            self.allocate(context, needed)?;
        }
        for mesh in new {
            self.append(context, mesh);
        }
        Ok(())
    }

    /// Those of `meshes` that are not there, each once.
    fn missing<'a>(&self, meshes: impl Iterator<Item = &'a Arc<Dag>>) -> Vec<&'a Arc<Dag>> {
        let mut seen = FxHashMap::default();
        meshes
            .filter(|mesh| !self.resident.contains_key(&address(mesh)))
            .filter(|mesh| seen.insert(address(mesh), ()).is_none())
            .collect()
    }

    /// Makes arrays with room for as much again where the device allows.
    fn allocate(&mut self, context: &Context, needed: Sizes) -> Result<()> {
        for ((what, bytes), needed) in ARRAYS.into_iter().zip(needed) {
            let room = (2 * needed).min(context.largest_array() / bytes).max(needed);
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
            self.buffers.push(context.buffer(what, room * bytes, usage)?);
        }
        self.room = std::array::from_fn(|k| self.buffers[k].size() / ARRAYS[k].1);
        Ok(())
    }

    fn append(&mut self, context: &Context, mesh: &Arc<Dag>) {
        let [first_node, first_group, first_page, first_word] = self.used;
        // The room of an array of words bounds them.
        let offsets: Vec<u32> = mesh.pages.table.iter().map(|p| (first_word + p.offset) as u32).collect();
        let data: [&[u8]; 4] = [
            bytemuck::cast_slice(&mesh.nodes),
            bytemuck::cast_slice(&mesh.groups),
            bytemuck::cast_slice(&offsets),
            bytemuck::cast_slice(&mesh.pages.words),
        ];
        for k in 0..ARRAYS.len() {
            context.queue().write_buffer(&self.buffers[k], self.used[k] * ARRAYS[k].1, data[k]);
        }
        let placement = Placement {
            first_node: first_node as u32,
            first_group: first_group as u32,
            first_page: first_page as u32,
            vertex_words: mesh.layout().vertex_words() as u32,
            depth: depth(mesh),
        };
        self.used = sum(self.used, sizes(mesh));
        self.resident.insert(address(mesh), (Arc::clone(mesh), placement));
    }

    /// Where a mesh that was uploaded lies.
    pub fn placement(&self, mesh: &Arc<Dag>) -> Option<Placement> {
        self.resident.get(&address(mesh)).map(|(_, placement)| *placement)
    }

    pub(super) fn nodes(&self) -> &Buffer {
        &self.buffers[0]
    }

    pub(super) fn groups(&self) -> &Buffer {
        &self.buffers[1]
    }

    pub(super) fn page_offsets(&self) -> &Buffer {
        &self.buffers[2]
    }

    pub(super) fn pages(&self) -> &Buffer {
        &self.buffers[3]
    }
}
