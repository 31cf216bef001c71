//! Meshes on the device: uploaded once, one after the other in arrays of nodes, groups, pages and a table of pages. What
//! pages take may be more than a device binds as one array; they then lie in several. Pages of streamed meshes come and
//! go, in places of one size.

use std::sync::Arc;

use rustc_hash::FxHashMap;
use wgpu::{Buffer, BufferUsages};

use super::context::{Context, unavailable};
use super::shaders::PAGE_ARRAYS;
use crate::error::{Error, Result};
use crate::limits::PAGE_MAX_BYTES;
use crate::model::{Dag, Group, Node, Pages};
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

/// Words of a place for a page of a streamed mesh.
const PLACE_WORDS: u64 = PAGE_MAX_BYTES as u64 / WORD;
/// Places at first, in large pools.
const FIRST_PLACES: usize = 64;
/// Places when these do not do. Smaller pools are made as a whole.
const NEXT_PLACES: usize = 512;
/// What the table has for a page that is not there.
pub const ABSENT: u32 = u32::MAX;

/// Bytes of a word of a page.
const WORD: u64 = size_of::<u32>() as u64;

/// A mesh on the device.
#[derive(Debug)]
struct Mesh {
    dag: Arc<Dag>,
    placement: Placement,
    /// Where it is streamed: what was there when pages were last brought, and the place of each of those.
    streamed: Option<(Arc<Pages>, Vec<u32>)>,
}

/// All meshes on the device.
#[derive(Debug, Default)]
pub struct Meshes {
    /// By address, which is stable while the mesh is held.
    resident: FxHashMap<usize, Mesh>,
    /// Places for pages of streamed meshes, in front of all words.
    places: usize,
    /// Those of them that are empty.
    free: Vec<u32>,
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

/// How many places to make. What is there moves when there are more, so that this is seldom.
fn places_for(resident: &Resident) -> usize {
    let (held, most) = (resident.held(), resident.most());
    match held {
        0 => 0,
        _ if most <= NEXT_PLACES => most,
        1..=FIRST_PLACES => FIRST_PLACES,
        _ => (4 * held).next_power_of_two().clamp(NEXT_PLACES, most),
    }
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
    /// Makes sure that all of `meshes` are there, of those that are streamed all but the pages. Where there is no room,
    /// only these stay.
    pub fn upload<'a>(
        &mut self,
        context: &Context,
        meshes: impl Iterator<Item = &'a Arc<Dag>> + Clone,
        resident: &Resident,
    ) -> Result<()> {
        let mut new = self.missing(meshes.clone());
        let (needed, words) = self.needed(&new, resident);
        if self.lacks_places(resident)
            || words > self.room_words
            || (0..ARRAYS.len()).any(|k| needed[k] > self.room[k])
        {
            let places = places_for(resident);
            let used_words = places as u64 * PLACE_WORDS;
            let free = (0..places as u32).rev().collect();
            *self = Self { array_bits: context.array_bits(), places, free, used_words, ..Self::default() };
            new = self.missing(meshes);
            let (needed, words) = self.needed(&new, resident);
            self.allocate(context, needed, words)?;
        }
        for mesh in new {
            self.append(context, mesh, resident)?;
        }
        Ok(())
    }

    /// Whether there are more pages of streamed meshes than places for them.
    pub fn lacks_places(&self, resident: &Resident) -> bool {
        resident.held() > self.places
    }

    /// Brings what is there of the streamed meshes up to date.
    pub fn stream(&mut self, context: &Context, resident: &Resident) -> Result<()> {
        let mut changed = Vec::new();
        for mesh in self.resident.values_mut() {
            let Some((known, places)) = &mut mesh.streamed else { continue };
            let pages = resident.pages(&mesh.dag);
            if Arc::ptr_eq(known, pages) {
                continue;
            }
            // Of a mesh that no scene has any more, nothing is there.
            let holds = |page| resident.streams(&mesh.dag) && pages.holds(page);
            for (page, place) in places.iter_mut().enumerate().filter(|(_, place)| **place != ABSENT) {
                if !holds(page) {
                    self.free.push(std::mem::replace(place, ABSENT));
                }
            }
            *known = Arc::clone(pages);
            if resident.streams(&mesh.dag) {
                changed.push(address(&mesh.dag));
            }
        }
        for address in changed {
            let Some(Mesh { streamed: Some((pages, places)), placement, .. }) =
                self.resident.get_mut(&address)
            else {
                continue;
            };
            for (page, place) in places.iter_mut().enumerate() {
                if *place != ABSENT || !pages.holds(page) {
                    continue;
                }
                let free = self.free.pop();
                *place = free.ok_or_else(|| Error::Invariant("no place for a page is free".to_owned()))?;
                let at = u64::from(*place) * PLACE_WORDS;
                write_page(context, &self.pages, self.array_bits, at, pages.page(page))?;
            }
            // The places of an array of words bound them.
            let start = |place: &u32| if *place == ABSENT { ABSENT } else { place * PLACE_WORDS as u32 };
            let starts: Vec<u32> = places.iter().map(start).collect();
            let at = u64::from(placement.first_page) * WORD;
            context.write(ARRAYS[2].0, &self.buffers[2], at, bytemuck::cast_slice(&starts))?;
        }
        Ok(())
    }

    /// What the arrays hold once these are there.
    fn needed(&self, new: &[&Arc<Dag>], resident: &Resident) -> (Sizes, u64) {
        let sizes = new.iter().fold(self.used, |total, mesh| sum(total, sizes(mesh)));
        let whole = new.iter().filter(|mesh| !resident.streams(mesh));
        let words = whole.fold(self.used_words, |at, mesh| layout(mesh, at, self.array_bits).1);
        (sizes, words)
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

    fn append(&mut self, context: &Context, mesh: &Arc<Dag>, resident: &Resident) -> Result<()> {
        let [first_node, first_group, first_page] = self.used;
        let pages = mesh.pages.table.len();
        let streamed = resident.streams(mesh);
        let (offsets, end) = if streamed {
            (vec![ABSENT; pages], self.used_words)
        } else {
            let (starts, end) = layout(mesh, self.used_words, self.array_bits);
            for (page, at) in starts.iter().enumerate() {
                write_page(context, &self.pages, self.array_bits, *at, mesh.pages.page(page))?;
            }
            // The room of the arrays of words bounds them.
            (starts.into_iter().map(|at| at as u32).collect(), end)
        };
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
            depth: depth(mesh),
        };
        self.used = sum(self.used, sizes(mesh));
        self.used_words = end;
        // None of its pages is there yet.
        let none =
            || (Arc::new(Pages::absent(Arc::clone(&mesh.pages.table), mesh.layout())), vec![ABSENT; pages]);
        let streamed = streamed.then(none);
        self.resident.insert(address(mesh), Mesh { dag: Arc::clone(mesh), placement, streamed });
        Ok(())
    }

    /// Where a mesh that was uploaded lies.
    pub fn placement(&self, mesh: &Arc<Dag>) -> Option<Placement> {
        self.resident.get(&address(mesh)).map(|mesh| mesh.placement)
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

/// Writes a page from word `at` of the arrays of pages on.
fn write_page(context: &Context, arrays: &[Buffer], array_bits: u32, at: u64, words: &[u32]) -> Result<()> {
    let (array, word) = (at >> array_bits, at & ((1 << array_bits) - 1));
    context.write(PAGES, &arrays[array as usize], word * WORD, bytemuck::cast_slice(words))
}
