//! The shadow maps of a view's lights as shaders read them: records of the lights, and a table from what a page is called to
//! the slot of the pool where it lies, by open addressing. `shaders/shared/shadow_pages.wgsl` looks pages up in it.

use bytemuck::Zeroable;
use wgpu::{Buffer, BufferUsages};

use super::context::Context;
use super::kernel::bindings;
use crate::error::Result;
use crate::gpu_types::ShadowLight;
use crate::limits::{SHADOW_FACE_BITS, SHADOW_LEVEL_BITS};
use crate::scene::palette::hash;

bindings! {
    /// What kernels bind that look up shadow maps.
    ShadowBindings { shadow_table: Read, shadow_pages: Read }
}

/// Words of an entry.
type Quad = [u32; 4];

/// A page of a light's map, as the view names it, and where it lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShadowEntry {
    /// Of a cube.
    pub face: u8,
    /// The level.
    pub level: i16,
    /// Pages right of the level's anchor and down, and slabs up.
    pub at: [i32; 3],
    /// Slot of the pool.
    pub slot: u32,
}

/// A light of a view, and the pages of its map that may be looked up.
#[derive(Clone, Debug)]
pub struct ShadowMapEntries {
    /// How the view looks it up; where its lists lie is filled in.
    pub light: ShadowLight,
    /// Of a map without an end, where the camera is in each level.
    pub anchors: Vec<[f32; 3]>,
    /// Points of a disk of radius 1, to which rays go.
    pub points: Vec<[f32; 2]>,
    /// The pages, each once.
    pub pages: Vec<ShadowEntry>,
}

/// Face and level as one number.
fn tag(face: u8, level: i16) -> u32 {
    let level = (i32::from(level) + (1 << (SHADOW_LEVEL_BITS - 1))) as u32;
    debug_assert!(u32::from(face) < 1 << SHADOW_FACE_BITS && level < 1 << SHADOW_LEVEL_BITS);
    u32::from(face) | level << SHADOW_FACE_BITS
}

/// Where the search for a page begins in every table, `shadow_hash` of shaders.
pub fn shadow_hash(entry: &ShadowEntry) -> u32 {
    let [x, y, z] = entry.at.map(|v| v as u32);
    hash([x, y, z << 16 ^ tag(entry.face, entry.level)])
}

/// A table of pages: a power of two of entries, at most half of them full.
fn pages(entries: &[ShadowEntry]) -> Vec<Quad> {
    let mut table = vec![[0; 4]; (2 * entries.len()).max(2).next_power_of_two()];
    let mask = table.len() - 1;
    for entry in entries {
        let mut number = shadow_hash(entry) as usize & mask;
        while table[number][3] != 0 {
            number = (number + 1) & mask;
        }
        let [x, y, z] = entry.at.map(|v| v as u32);
        let tag = tag(entry.face, entry.level);
        table[number] = [x, y, z, (entry.slot + 1) << (SHADOW_FACE_BITS + SHADOW_LEVEL_BITS) | tag];
    }
    table
}

/// All of it: how many lights there are; the record of each; then anchors, points of lights, and tables of pages. None of a
/// light that throws no shadow.
pub fn shadow_table(lights: &[Option<ShadowMapEntries>]) -> Vec<Quad> {
    let mut records = vec![ShadowLight::zeroed(); lights.len()];
    let mut lists: Vec<Quad> = Vec::new();
    let first = 1 + size_of_val(&records[..]) / size_of::<Quad>();
    // Most lights have as many rays, and so the same points.
    let mut known: Vec<(&[[f32; 2]], u32)> = Vec::new();
    for (record, light) in records.iter_mut().zip(lights) {
        let Some(ShadowMapEntries { light, anchors, points, pages: entries }) = light else { continue };
        let mut put = |list: &mut dyn Iterator<Item = Quad>| {
            let at = first + lists.len();
            lists.extend(list);
            at as u32
        };
        let anchors = put(&mut anchors.iter().map(|[x, y, z]| [x.to_bits(), y.to_bits(), z.to_bits(), 0]));
        let same = known.iter().find(|(own, _)| *own == &points[..]).map(|(_, at)| *at);
        let at = same.unwrap_or_else(|| {
            let word = |pair: &[[f32; 2]], k: usize| pair.get(k / 2).map_or(0, |at| at[k % 2].to_bits());
            put(&mut points.chunks(2).map(|pair| std::array::from_fn(|k| word(pair, k))))
        });
        known.push((points, at));
        let table = pages(entries);
        let mask = table.len() as u32 - 1;
        let table = put(&mut table.into_iter());
        *record = ShadowLight { samples: points.len() as u32, points: at, anchors, table, mask, ..*light };
    }
    let head = [lights.len() as u32, 0, 0, 0];
    [&[head][..], bytemuck::cast_slice(&records), &lists].concat()
}

/// The table of a view on a device.
#[derive(Debug)]
pub struct ShadowTable {
    buffer: Buffer,
}

impl ShadowTable {
    const WHAT: &str = "the table of shadow maps";

    /// Without lights.
    pub fn new(context: &Context) -> Result<Self> {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        Ok(Self { buffer: context.buffer(Self::WHAT, size_of::<Quad>() as u64, usage)? })
    }

    /// Writes what [`shadow_table`] made, before what is submitted next.
    pub fn write(&mut self, context: &Context, table: &[Quad]) -> Result<()> {
        let bytes = size_of_val(table) as u64;
        if self.buffer.size() < bytes {
            self.buffer = context.buffer(Self::WHAT, bytes.next_power_of_two(), self.buffer.usage())?;
        }
        context.write(Self::WHAT, &self.buffer, 0, bytemuck::cast_slice(table))
    }

    /// Where it lies.
    pub fn buffer(&self) -> &Buffer {
        &self.buffer
    }
}
