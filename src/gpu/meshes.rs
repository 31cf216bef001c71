//! Meshes on the device: uploaded once, one after the other in arrays of nodes, groups, pages and a table of pages. What
//! pages take may be more than a device binds as one array; they then lie in several.

use std::sync::Arc;

use rustc_hash::FxHashMap;
use wgpu::{Buffer, BufferUsages};

use super::context::{Context, unavailable};
use super::shaders::PAGE_ARRAYS;
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

/// Elements of arrays: nodes, groups, entries of the table of pages.
type Sizes = [u64; 3];

/// What each array holds, for messages, and bytes per element.
const ARRAYS: [(&str, u64); 3] = [
    ("the nodes of the meshes", size_of::<Node>() as u64),
    ("the groups of the meshes", size_of::<Group>() as u64),
    ("the page tables of the meshes", WORD),
];

/// What pages hold, for messages.
const PAGES: &str = "the clusters of the meshes";

/// Bytes of a word of a page.
const WORD: u64 = size_of::<u32>() as u64;

/// All meshes on the device.
#[derive(Debug, Default)]
pub struct Meshes {
    /// By address, which is stable while the mesh is held.
    resident: FxHashMap<usize, (Arc<Dag>, Placement)>,
    buffers: Vec<Buffer>,
    used: Sizes,
    room: Sizes,
    /// Arrays of pages, all but the last of 2^`array_bits` words.
    pages: Vec<Buffer>,
    array_bits: u32,
    /// Words given away, and words there are.
    used_words: u64,
    room_words: u64,
}

fn address(mesh: &Arc<Dag>) -> usize {
    Arc::as_ptr(mesh).addr()
}

fn sizes(mesh: &Dag) -> Sizes {
    [mesh.nodes.len(), mesh.groups.len(), mesh.pages.table.len()].map(|n| n as u64)
}

fn sum(a: Sizes, b: Sizes) -> Sizes {
    std::array::from_fn(|k| a[k] + b[k])
}

/// Where each page of a mesh goes from word `at` on, so that none lies in two arrays of 2^`bits` words; and the first
/// word behind them.
fn layout(mesh: &Dag, mut at: u64, bits: u32) -> (Vec<u64>, u64) {
    let mut offsets = Vec::with_capacity(mesh.pages.table.len());
    for page in mesh.pages.table.iter() {
        let words = u64::from(page.words);
        if at >> bits != (at + words.max(1) - 1) >> bits {
            at = ((at >> bits) + 1) << bits;
        }
        offsets.push(at);
        at += words;
    }
    (offsets, at)
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
        let (needed, words) = self.needed(&new);
        if words > self.room_words || (0..ARRAYS.len()).any(|k| needed[k] > self.room[k]) {
            *self = Self { array_bits: context.array_bits(), ..Self::default() };
            new = self.missing(meshes);
            let (needed, words) = self.needed(&new);
            self.allocate(context, needed, words)?;
        }
        for mesh in new {
            self.append(context, mesh)?;
        }
        Ok(())
    }

    /// What the arrays hold once these are there.
    fn needed(&self, new: &[&Arc<Dag>]) -> (Sizes, u64) {
        let sizes = new.iter().fold(self.used, |total, mesh| sum(total, sizes(mesh)));
        let words = new.iter().fold(self.used_words, |at, mesh| layout(mesh, at, self.array_bits).1);
        (sizes, words)
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
    fn allocate(&mut self, context: &Context, needed: Sizes, words: u64) -> Result<()> {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        for ((what, bytes), needed) in ARRAYS.into_iter().zip(needed) {
            let room = (2 * needed).min(context.largest_array() / bytes).max(needed);
            self.buffers.push(context.buffer(what, room * bytes, usage)?);
        }
        self.room = std::array::from_fn(|k| self.buffers[k].size() / ARRAYS[k].1);
        let array = 1 << self.array_bits;
        let most = PAGE_ARRAYS as u64 * array;
        if words > most {
            let mib = |words: u64| (words * WORD).div_ceil(1 << 20);
            return Err(unavailable(format!(
                "{PAGES} take {} MiB, and {} gives {PAGE_ARRAYS} arrays of at most {} MiB",
                mib(words),
                context.name(),
                mib(array)
            )));
        }
        // Room for as much again, but no array for that alone.
        let room = (2 * words).min(words.next_multiple_of(array));
        for first in (0..room.max(1)).step_by(array as usize) {
            let bytes = array.min(room - first) * WORD;
            self.pages.push(context.buffer(PAGES, bytes, usage)?);
        }
        self.room_words = room;
        Ok(())
    }

    fn append(&mut self, context: &Context, mesh: &Arc<Dag>) -> Result<()> {
        let [first_node, first_group, first_page] = self.used;
        let (places, end) = layout(mesh, self.used_words, self.array_bits);
        self.write_pages(context, mesh, &places)?;
        // The room of the arrays of words bounds them.
        let offsets: Vec<u32> = places.iter().map(|place| *place as u32).collect();
        let data: [&[u8]; 3] = [
            bytemuck::cast_slice(&mesh.nodes),
            bytemuck::cast_slice(&mesh.groups),
            bytemuck::cast_slice(&offsets),
        ];
        for k in 0..ARRAYS.len() {
            let (what, bytes) = ARRAYS[k];
            context.write(what, &self.buffers[k], self.used[k] * bytes, data[k])?;
        }
        let placement = Placement {
            first_node: first_node as u32,
            first_group: first_group as u32,
            first_page: first_page as u32,
            vertex_words: mesh.layout().vertex_words() as u32,
            depth: depth(mesh),
        };
        self.used = sum(self.used, sizes(mesh));
        self.used_words = end;
        self.resident.insert(address(mesh), (Arc::clone(mesh), placement));
        Ok(())
    }

    /// Writes pages to their places.
    fn write_pages(&self, context: &Context, mesh: &Dag, places: &[u64]) -> Result<()> {
        for (page, at) in places.iter().enumerate() {
            let (array, word) = (at >> self.array_bits, at & ((1 << self.array_bits) - 1));
            let words = bytemuck::cast_slice(mesh.pages.page(page));
            context.write(PAGES, &self.pages[array as usize], word * WORD, words)?;
        }
        Ok(())
    }

    /// Where a mesh that was uploaded lies.
    pub fn placement(&self, mesh: &Arc<Dag>) -> Option<Placement> {
        self.resident.get(&address(mesh)).map(|(_, placement)| *placement)
    }

    /// The nodes of all meshes.
    pub fn nodes(&self) -> &Buffer {
        &self.buffers[0]
    }

    /// The groups of all meshes.
    pub fn groups(&self) -> &Buffer {
        &self.buffers[1]
    }

    /// Where each page starts, words.
    pub fn page_offsets(&self) -> &Buffer {
        &self.buffers[2]
    }

    /// The arrays of pages; the first again where there are fewer.
    pub fn pages(&self) -> [&Buffer; PAGE_ARRAYS] {
        std::array::from_fn(|k| self.pages.get(k).unwrap_or(&self.pages[0]))
    }

    /// Whether pages lie in several arrays.
    pub fn split(&self) -> bool {
        self.pages.len() > 1
    }
}
