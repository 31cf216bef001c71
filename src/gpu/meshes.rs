//! Meshes on the device: uploaded once, one after the other in arrays of nodes, groups, pages and a table of pages. Of
//! streamed meshes root pages stay, others come and go. A new shape of a mesh takes the place of one that is not drawn any
//! more, and no more is written than where its vertices are.

use std::sync::Arc;

use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};
use wgpu::{Buffer, BufferUsages};

use super::context::Context;
use super::kernel::BoundBuffer;
use super::page_arrays::PageArrays;
use super::shaders::PAGE_ARRAYS;
use crate::error::Result;
use crate::gpu_types::{ABSENT, Group, Node};
use crate::model::page::shape_ranges;
use crate::model::rule::SOURCE_ERROR;
use crate::model::{self, Dag, PageEntry, Pages};
use crate::stream::{Needs, Request, Resident};

/// Where a mesh starts in each array.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// First node.
    pub first_node: u32,
    /// First group.
    pub first_group: u32,
    /// First entry of the table of pages.
    pub first_page: u32,
    /// Levels of its hierarchy.
    pub depth: u32,
}

/// Pages of a shape that are written at a time.
const PAGES_AT_ONCE: usize = 256;

/// Elements of arrays: nodes, groups, entries of the table of pages.
type Sizes = [u64; 3];

/// What each array holds, for messages, and bytes per element.
const ARRAYS: [(&str, u64); 3] = [
    ("the nodes of the meshes", size_of::<Node>() as u64),
    ("the groups of the meshes", size_of::<Group>() as u64),
    ("the page tables of the meshes", size_of::<u32>() as u64),
];

/// A mesh on the device.
#[derive(Debug)]
struct Mesh {
    dag: Arc<Dag>,
    placement: Placement,
    /// The first word of each page.
    starts: Vec<u32>,
    /// How many of them stay: all, or root pages.
    stay: usize,
    /// Where it is streamed: what was there when pages were last brought.
    streamed: Option<Arc<Pages>>,
}

/// All meshes on the device.
#[derive(Debug, Default)]
pub struct Meshes {
    /// By the numbers of their ids.
    resident: FxHashMap<u64, Mesh>,
    buffers: Vec<Buffer>,
    used: Sizes,
    room: Sizes,
    pages: PageArrays,
    /// Bytes that were written to all arrays but those of pages, ever.
    bytes: u64,
}

/// The pages that stay on the device as long as the mesh does.
fn staying<'a>(mesh: &'a Arc<Dag>, resident: &Resident) -> &'a [PageEntry] {
    let table = mesh.table();
    if resident.streams(mesh) { &table[..mesh.root_pages()] } else { table }
}

fn sizes(mesh: &Dag) -> Sizes {
    [mesh.nodes.len(), mesh.groups.len(), mesh.pages.table.len()].map(|n| n as u64)
}

/// A node as kernels read it.
fn node(of: &model::Node) -> Node {
    let model::Node {
        center,
        extent,
        lod_sphere,
        max_parent_error,
        min_own_error,
        first,
        count,
        is_leaf,
        ..
    } = *of;
    Node {
        center,
        first,
        extent,
        count,
        is_leaf,
        lod_sphere,
        max_parent_error,
        min_own_error,
        unused: [0; 2],
    }
}

/// A group as kernels read it.
fn group(of: &model::Group) -> Group {
    let model::Group { lod_sphere, error, first, count, center, extent, min_own_error, .. } = *of;
    Group { lod_sphere, center, error, extent, min_own_error, first: first.0, count, unused: [0; 2] }
}

/// Each once.
fn distinct<'a>(meshes: impl Iterator<Item = &'a Arc<Dag>>) -> Vec<&'a Arc<Dag>> {
    let mut seen = FxHashSet::default();
    meshes.filter(|mesh| seen.insert(mesh.id.number())).collect()
}

/// What all shapes of a mesh have in common, by number.
pub(super) fn topology(mesh: &Dag) -> Option<u64> {
    mesh.topology.as_ref().map(|topology| topology.number())
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
    /// Makes sure that all of `meshes` are there, of those that are streamed all but the pages that come and go. Where there
    /// is no room, only these stay.
    pub fn upload<'a>(
        &mut self,
        context: &Context,
        meshes: impl Iterator<Item = &'a Arc<Dag>>,
        resident: &Resident,
    ) -> Result<()> {
        let meshes = distinct(meshes);
        for (before, mesh) in self.successors(&meshes) {
            self.reshape(context, before, mesh)?;
        }
        self.make_room(context, &meshes, resident)?;
        let is_new = |mesh: &&&Arc<Dag>| !self.resident.contains_key(&mesh.id.number());
        let new: Vec<&Arc<Dag>> = meshes.iter().filter(is_new).copied().collect();
        let needed = new.iter().fold(self.used, |total, mesh| sum(total, sizes(mesh)));
        if (0..ARRAYS.len()).any(|k| needed[k] > self.room[k]) {
            self.rearrange(context, &meshes)?;
        }
        for mesh in new {
            let (staying, pages) = (staying(mesh, resident), resident.pages(mesh));
            let mut starts = self.pages.append(context, staying, |page| mesh.page_of(pages, page))?;
            starts.resize(mesh.pages.table.len(), ABSENT);
            // None of its other pages is there yet.
            let none = || Arc::new(Pages::absent(Arc::clone(&mesh.pages.table), mesh.layout()));
            let streamed = resident.streams(mesh).then(none);
            self.append(context, Arc::clone(mesh), starts, staying.len(), streamed)?;
        }
        Ok(())
    }

    /// Of the meshes that are not there those whose place another shape leaves to them, which none of `meshes` has; each with
    /// the number of that shape.
    fn successors<'a>(&self, meshes: &[&'a Arc<Dag>]) -> Vec<(u64, &'a Arc<Dag>)> {
        let is_new = |mesh: &&&Arc<Dag>| !self.resident.contains_key(&mesh.id.number());
        let new: Vec<(u64, &Arc<Dag>)> =
            meshes.iter().filter(is_new).filter_map(|mesh| Some((topology(mesh)?, *mesh))).collect();
        if new.is_empty() {
            return Vec::new();
        }
        let stay: FxHashSet<u64> = meshes.iter().map(|mesh| mesh.id.number()).collect();
        let mut left: FxHashMap<u64, Vec<u64>> = FxHashMap::default();
        for (number, mesh) in self.resident.iter().filter(|(number, _)| !stay.contains(number)) {
            if let Some(topology) = topology(&mesh.dag) {
                left.entry(topology).or_default().push(*number);
            }
        }
        new.into_iter().filter_map(|(topology, mesh)| Some((left.get_mut(&topology)?.pop()?, mesh))).collect()
    }

    /// Whether each mesh is there, or finds a place that another shape leaves to it: then no buffer is replaced.
    pub fn have_places<'a>(&self, meshes: impl Iterator<Item = &'a Arc<Dag>>) -> bool {
        let meshes = distinct(meshes);
        let new = meshes.iter().filter(|mesh| !self.resident.contains_key(&mesh.id.number()));
        self.successors(&meshes).len() == new.count()
    }

    /// Puts a mesh in the place of another of its shapes.
    fn reshape(&mut self, context: &Context, before: u64, dag: &Arc<Dag>) -> Result<()> {
        let Some(mesh) = self.resident.remove(&before) else { return Ok(()) };
        let Placement { first_node, first_group, .. } = mesh.placement;
        let nodes: Vec<Node> = dag.nodes.iter().map(node).collect();
        let groups: Vec<Group> = dag.groups.iter().map(group).collect();
        let data: [(u32, &[u8]); 2] =
            [(first_node, bytemuck::cast_slice(&nodes)), (first_group, bytemuck::cast_slice(&groups))];
        for (k, (first, data)) in data.into_iter().enumerate() {
            self.write(context, k, first.into(), data)?;
        }
        for first in (0..mesh.starts.len()).step_by(PAGES_AT_ONCE) {
            let numbers = first..(first + PAGES_AT_ONCE).min(mesh.starts.len());
            let pages: Vec<_> =
                numbers.clone().into_par_iter().map(|page| dag.page_of(&dag.pages, page)).collect();
            let parts = numbers.zip(&pages).flat_map(|(page, words)| {
                let start = u64::from(mesh.starts[page]);
                let clusters = dag.table()[page].clusters as usize;
                let ranges = shape_ranges(words, dag.layout(), clusters);
                ranges.map(move |range| (start + range.start as u64, &words[range]))
            });
            self.pages.rewrite(context, parts)?;
        }
        self.resident.insert(dag.id.number(), Mesh { dag: Arc::clone(dag), ..mesh });
        Ok(())
    }

    /// Writes elements from `first` on to an array that is none of pages.
    fn write(&mut self, context: &Context, array: usize, first: u64, data: &[u8]) -> Result<()> {
        let (what, bytes) = ARRAYS[array];
        self.bytes += data.len() as u64;
        context.write(what, &self.buffers[array], first * bytes, data)
    }

    /// Bytes that were written, ever.
    pub fn bytes(&self) -> u64 {
        self.bytes + self.pages.bytes
    }

    /// Makes sure that there is room for the pages of these meshes, of streamed ones for as many as the pool has at most, so
    /// that no frame waits for more when pages come. Where there is not, there is nothing else any more.
    fn make_room(&mut self, context: &Context, meshes: &[&Arc<Dag>], resident: &Resident) -> Result<()> {
        let is_new = |mesh: &&&Arc<Dag>| !self.resident.contains_key(&mesh.id.number());
        let new = meshes.iter().filter(is_new).map(|mesh| staying(mesh, resident));
        let all = meshes.iter().map(|mesh| staying(mesh, resident));
        let alone = PageArrays::default().words_with(context, all);
        let fit = PageArrays::places_beside(context, alone);
        let places =
            |times: usize| (times * resident.total()).min(resident.most()).min(fit).max(resident.held());
        if !self.pages.has_room(self.pages.words_with(context, new), places(1)) {
            // The old ones go first.
            *self = Self { bytes: self.bytes(), ..Self::default() };
            let mut places = places(2);
            self.pages = loop {
                match PageArrays::new(context, alone, places) {
                    // The pages that there are now may do with less memory.
                    Err(_) if places > resident.held() => places = (places / 2).max(resident.held()),
                    made => break made?,
                }
            };
        }
        Ok(())
    }

    /// Makes all arrays but those of pages anew, with room for as much again as `meshes` take where the device allows. Of
    /// what is there these stay.
    fn rearrange(&mut self, context: &Context, meshes: &[&Arc<Dag>]) -> Result<()> {
        let mut known = std::mem::take(&mut self.resident);
        let needed = meshes.iter().fold(Sizes::default(), |total, mesh| sum(total, sizes(mesh)));
        // The old ones go first.
        self.buffers.clear();
        for ((what, bytes), needed) in ARRAYS.into_iter().zip(needed) {
            let room = (2 * needed).min(context.largest_array() / bytes).max(needed);
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
            self.buffers.push(context.buffer(what, room * bytes, usage)?);
        }
        self.room = std::array::from_fn(|k| self.buffers[k].size() / ARRAYS[k].1);
        self.used = Sizes::default();
        for mesh in meshes {
            if let Some(Mesh { dag, starts, stay, streamed, .. }) = known.remove(&mesh.id.number()) {
                self.append(context, dag, starts, stay, streamed)?;
            }
        }
        for Mesh { starts, stay, .. } in known.into_values() {
            let come = starts.into_iter().skip(stay).filter(|start| *start != ABSENT);
            come.for_each(|start| self.pages.clear(start));
        }
        Ok(())
    }

    /// Appends a mesh to all arrays but those of pages.
    fn append(
        &mut self,
        context: &Context,
        dag: Arc<Dag>,
        starts: Vec<u32>,
        stay: usize,
        streamed: Option<Arc<Pages>>,
    ) -> Result<()> {
        let [first_node, first_group, first_page] = self.used.map(|first| first as u32);
        let mut nodes: Vec<Node> = dag.nodes.iter().map(node).collect();
        let mut groups: Vec<Group> = dag.groups.iter().map(group).collect();
        if streamed.is_some() {
            // What is too coarse may have to be drawn in place of what is not there.
            nodes.iter_mut().for_each(|node| node.min_own_error = SOURCE_ERROR);
            groups.iter_mut().for_each(|group| group.min_own_error = SOURCE_ERROR);
        }
        let data: [&[u8]; 3] =
            [bytemuck::cast_slice(&nodes), bytemuck::cast_slice(&groups), bytemuck::cast_slice(&starts)];
        for k in 0..ARRAYS.len() {
            self.write(context, k, self.used[k], data[k])?;
        }
        drop((nodes, groups));
        self.used = sum(self.used, sizes(&dag));
        let placement = Placement { first_node, first_group, first_page, depth: depth(&dag) };
        self.resident.insert(dag.id.number(), Mesh { dag, placement, starts, stay, streamed });
        Ok(())
    }

    /// Whether there are more pages of streamed meshes than places for them.
    pub fn lacks_places(&self, resident: &Resident) -> bool {
        !self.pages.has_room(0, resident.held())
    }

    /// Brings what is there of the streamed meshes up to date.
    pub fn stream(&mut self, context: &Context, resident: &Resident) -> Result<()> {
        let mut changed = Vec::new();
        for (address, Mesh { dag, starts, stay, streamed, .. }) in &mut self.resident {
            let Some(known) = streamed else { continue };
            let pages = resident.pages(dag);
            if Arc::ptr_eq(known, pages) {
                continue;
            }
            // Of a mesh that no scene has any more, nothing is there.
            let streams = resident.streams(dag);
            for (page, start) in starts.iter_mut().enumerate().skip(*stay) {
                if *start != ABSENT && !(streams && pages.holds(page)) {
                    self.pages.clear(std::mem::replace(start, ABSENT));
                }
            }
            *known = Arc::clone(pages);
            if streams {
                changed.push(*address);
            }
        }
        // What left has made room for what comes.
        for address in changed {
            let Some(Mesh { starts, streamed: Some(pages), placement, .. }) = self.resident.get_mut(&address)
            else {
                continue;
            };
            for (page, start) in starts.iter_mut().enumerate() {
                if *start == ABSENT && pages.holds(page) {
                    *start = self.pages.place(context, pages.page(page))?;
                }
            }
            let (what, bytes) = ARRAYS[2];
            let at = u64::from(placement.first_page) * bytes;
            self.bytes += size_of_val(&**starts) as u64;
            context.write(what, &self.buffers[2], at, bytemuck::cast_slice(starts))?;
        }
        Ok(())
    }

    /// Entries of the tables of pages.
    pub fn page_count(&self) -> u32 {
        self.used[2] as u32
    }

    /// What was asked for, by entries of the tables of pages: how much, as the bits of a positive number, or zero.
    pub fn needs(&self, wanted: &[u32]) -> Needs {
        let mut needs = Needs::default();
        for mesh in self.resident.values().filter(|mesh| mesh.streamed.is_some()) {
            let own = wanted.iter().skip(mesh.placement.first_page as usize).take(mesh.dag.pages.table.len());
            for (page, bits) in own.enumerate().filter(|(_, bits)| **bits != 0) {
                needs.add(&mesh.dag, Request { page: page as u32, pixels: f32::from_bits(*bits) });
            }
        }
        needs
    }

    /// Where a mesh that was uploaded lies.
    pub fn placement(&self, mesh: &Arc<Dag>) -> Option<Placement> {
        self.resident.get(&mesh.id.number()).map(|mesh| mesh.placement)
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

    /// What kernels bind of the arrays of pages; the first again where there are fewer.
    pub fn pages(&self) -> [BoundBuffer<'_>; PAGE_ARRAYS] {
        self.pages.arrays()
    }

    /// Whether pages lie in several arrays.
    pub fn split(&self) -> bool {
        self.pages.split()
    }
}
