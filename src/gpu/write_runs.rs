//! Runs of words → pages on the device: all that an update changes of meshes, in one dispatch for each array of pages.

use bytemuck::{Pod, Zeroable};
use wgpu::{Buffer, BufferSize, BufferUsages, ComputePassDescriptor};

use super::context::Context;
use super::kernel::{Bindings, BoundBuffer, Kernel, MAX_WORKGROUPS, bind, bindings};
use crate::error::Result;

/// What they are, for messages.
const WHAT: &str = "what meshes that move change";

bindings! {
    /// What `write_runs` binds.
    WriteRuns { runs: Read, words: Read, written: Write }
}

/// Runs of words → an array of pages.
pub const WRITE_RUNS: Kernel = Kernel::new("write_runs", &[WriteRuns::BINDINGS]);

/// A run of words as the kernel reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Run {
    from: u32,
    to: u32,
    count: u32,
    unused: u32,
}

/// Runs of words and where they go.
#[derive(Debug, Default)]
pub(super) struct Runs {
    runs: Vec<Run>,
    words: Vec<u32>,
}

impl Runs {
    /// Adds words that go to word `to` of the array.
    pub(super) fn push(&mut self, to: u64, words: &[u32]) {
        // No array has more words than that, and what goes there is no more.
        let (from, to, count) = (self.words.len() as u32, to as u32, words.len() as u32);
        self.runs.push(Run { from, to, count, unused: 0 });
        self.words.extend_from_slice(words);
    }

    /// Whether there are none.
    pub(super) fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// Bytes that go to the device.
    pub(super) fn bytes(&self) -> u64 {
        (size_of_val(&*self.runs) + size_of_val(&*self.words)) as u64
    }
}

/// Buffers that stay from update to update: of runs and of words.
#[derive(Debug, Default)]
pub(super) struct RunWriter {
    buffers: [Option<Buffer>; 2],
}

impl RunWriter {
    /// Writes runs to an array, before what is submitted next.
    pub(super) fn write(&mut self, context: &Context, array: BoundBuffer<'_>, runs: &Runs) -> Result<()> {
        let data: [&[u8]; 2] = [bytemuck::cast_slice(&runs.runs), bytemuck::cast_slice(&runs.words)];
        let mut bound = Vec::with_capacity(2);
        for (buffer, data) in self.buffers.iter_mut().zip(data) {
            let bytes = data.len() as u64;
            if buffer.as_ref().is_none_or(|known| known.size() < bytes) {
                // The old one goes first.
                *buffer = None;
                let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
                let room = (bytes + bytes / 2).next_multiple_of(16).min(context.largest_array());
                *buffer = Some(context.buffer(WHAT, room.max(bytes), usage)?);
            }
            let Some(buffer) = buffer else { continue };
            context.write(WHAT, buffer, 0, data)?;
            bound.push(BoundBuffer { buffer, offset: 0, size: BufferSize::new(bytes) });
        }
        let [own, words] = bound[..] else { return Ok(()) };
        let bound = bind!(WriteRuns { runs: own, words: words, written: array });
        let mut encoder = context.encoder(WHAT);
        {
            let descriptor = ComputePassDescriptor { label: Some(WHAT), timestamp_writes: None };
            let mut pass = encoder.begin_compute_pass(&descriptor);
            pass.set_pipeline(&context.pipeline(WRITE_RUNS, false));
            pass.set_bind_group(0, &context.bind(WRITE_RUNS, &bound.buffers()), &[]);
            let workgroups = runs.runs.len() as u32;
            pass.dispatch_workgroups(workgroups.min(MAX_WORKGROUPS), workgroups.div_ceil(MAX_WORKGROUPS), 1);
        }
        context.start(encoder)?;
        Ok(())
    }
}
