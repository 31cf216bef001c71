//! Visibility buffer → the columns of pages of shadow maps that its pixels may look up, and between which heights receivers
//! are in each. The host makes pages of them.

use wgpu::{Buffer, BufferUsages, ComputePassDescriptor};

use super::bind_groups::BindGroups;
use super::buffers::Buffers;
use super::context::Context;
use super::kernel::{Bindings, Constant, Kernel, MAX_WORKGROUPS, WIDTH, bind, bindings};
use super::meshes::Meshes;
use super::shadow_table::ShadowTable;
use crate::error::Result;

bindings! {
    /// What `shadow_mark` binds.
    ShadowMark {
        view: Uniform, instances: Read, page_offsets: Read, pages: Read, pages_1: Read, pages_2: Read,
        pages_3: Read, visible: Read, words: Read, columns: Write, shadow_table: Read,
    }
}

/// Visibility buffer → columns of pages.
pub const SHADOW_MARK: Kernel = Kernel::new("shadow_mark", &[ShadowMark::BINDINGS])
    .constants([Constant::Number("SHADOW_BINDING", ShadowMark::BINDINGS.len() as u32 - 1)]);

/// Words before the tables of columns, and of an entry.
const HEAD: u64 = 4;
const WORDS: u64 = 3;
/// Entries of the table of a light at first, and at most.
const FIRST_ROOM: u32 = 1 << 12;
const MOST_ROOM: u32 = 1 << 18;

/// A column of pages of a light's map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// Level, row and column, see `column_bits` in `shaders/shadow_mark.wgsl`.
    pub bits: u32,
    /// Between which heights receivers are in it, along the light's axis.
    pub heights: [f32; 2],
}

/// What stays on a device between frames.
#[derive(Debug)]
pub(super) struct ShadowMarking {
    table: ShadowTable,
    room: u32,
    /// With room for so many words.
    columns: Option<(u64, Buffer, Buffer)>,
    bind_groups: BindGroups,
}

impl ShadowMarking {
    pub(super) fn new(context: &Context) -> Result<Self> {
        let table = ShadowTable::new(context)?;
        Ok(Self { table, room: FIRST_ROOM, columns: None, bind_groups: BindGroups::default() })
    }

    /// The columns of each light that the pixels of a view's picture may look up; none where they are more, or farther away,
    /// than tables have room for. `table` says how the view sees `lights` lights.
    pub(super) fn run(
        &mut self,
        context: &Context,
        meshes: &Meshes,
        (seen, buffers): (&Buffer, &Buffers),
        table: &[[u32; 4]],
        lights: usize,
    ) -> Result<Option<Vec<Vec<Column>>>> {
        self.table.write(context, table)?;
        loop {
            let words = HEAD + WORDS * u64::from(self.room) * lights as u64;
            if words * size_of::<u32>() as u64 > context.largest_array() {
                return Ok(None);
            }
            let found = self.submit(context, meshes, (seen, buffers), words)?;
            if found[0] == 0 {
                self.bind_groups.next_frame();
                let tables = found[HEAD as usize..].chunks_exact(WORDS as usize * self.room as usize);
                return Ok(Some(tables.map(columns).collect()));
            }
            if self.room == MOST_ROOM {
                return Ok(None);
            }
            self.room *= 2;
        }
    }

    /// Lets go of all buffers that are bound: some are to be replaced.
    pub(super) fn release(&mut self) {
        self.bind_groups.clear();
    }

    fn submit(
        &mut self,
        context: &Context,
        meshes: &Meshes,
        (seen, buffers): (&Buffer, &Buffers),
        words: u64,
    ) -> Result<Vec<u32>> {
        let bytes = words * size_of::<u32>() as u64;
        if self.columns.as_ref().is_none_or(|(room, ..)| *room != words) {
            self.columns = None;
            self.bind_groups.clear();
            let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
            let columns = context.buffer("columns of shadow pages", bytes, storage)?;
            let staged = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
            self.columns = Some((words, columns, context.buffer("what is read back", bytes, staged)?));
        }
        let Some((_, columns, staging)) = &self.columns else { return Ok(vec![1]) };
        let [pages, pages_1, pages_2, pages_3] = meshes.pages();
        let bound = bind!(ShadowMark {
            view: &buffers.view,
            instances: seen,
            page_offsets: meshes.page_offsets(),
            pages: pages,
            pages_1: pages_1,
            pages_2: pages_2,
            pages_3: pages_3,
            visible: &buffers.visible,
            words: &buffers.words,
            columns: columns,
            shadow_table: self.table.buffer(),
        });
        let mut encoder = context.encoder("marking shadow pages");
        encoder.clear_buffer(columns, 0, None);
        {
            let descriptor =
                ComputePassDescriptor { label: Some("marking shadow pages"), timestamp_writes: None };
            let mut pass = encoder.begin_compute_pass(&descriptor);
            pass.set_pipeline(&context.pipeline(SHADOW_MARK, meshes.split()));
            pass.set_bind_group(0, &self.bind_groups.get(context, SHADOW_MARK, &bound.buffers()), &[]);
            let workgroups = buffers.shape.pixels.div_ceil(u64::from(WIDTH)) as u32;
            pass.dispatch_workgroups(workgroups.min(MAX_WORKGROUPS), workgroups.div_ceil(MAX_WORKGROUPS), 1);
        }
        encoder.copy_buffer_to_buffer(columns, 0, staging, 0, bytes);
        let mut found = Vec::new();
        context.submit(encoder, staging, bytes, |read| found = bytemuck::pod_collect_to_vec(read))?;
        Ok(found)
    }
}

/// The columns in a table.
fn columns(table: &[u32]) -> Vec<Column> {
    let entries = table.as_chunks::<{ WORDS as usize }>().0.iter().filter(|entry| entry[0] != 0);
    let column = |[bits, least, most]: &[u32; WORDS as usize]| Column {
        bits: bits - 1,
        heights: [out_of_order(!least), out_of_order(*most)],
    };
    entries.map(column).collect()
}

/// The number that `in_order` of the shader gives these bits for.
fn out_of_order(bits: u32) -> f32 {
    f32::from_bits(if bits >> 31 == 0 { !bits } else { bits ^ 1 << 31 })
}
