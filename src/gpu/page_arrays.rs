//! Arrays of pages on the device: in front the pages that stay, one after the other, which are those of meshes in memory
//! and root pages; behind them places of one size for the others of streamed meshes, which come and go. Where all of it is
//! more than a device binds as one array, it lies in several.
//!
//! All places that a pool has are made at once, so that no frame waits for more of them. Of the arrays only what has been
//! written to is bound: wgpu clears what is bound, and a device that gives memory when it is first touched gives none for
//! the rest.

use wgpu::{Buffer, BufferSize, BufferUsages};

use super::context::{Context, mib, unavailable};
use super::kernel::BoundBuffer;
use super::shaders::PAGE_ARRAYS;
use super::write_runs::{RunWriter, Runs};
use crate::error::{Error, Result};
use crate::gpu_types::QUAD;
use crate::limits::PAGE_MAX_BYTES;
use crate::model::PageEntry;

/// What pages hold, for messages.
const WHAT: &str = "the clusters of the meshes";
/// Bytes of a word of a page.
const WORD: u64 = size_of::<u32>() as u64;
/// Words of a place. Arrays are multiples of it, so that no place lies in two.
const PLACE_WORDS: u64 = PAGE_MAX_BYTES as u64 / WORD;

/// See the module's documentation.
#[derive(Debug, Default)]
pub(super) struct PageArrays {
    /// All but the last of 2^`bits` words.
    arrays: Vec<Buffer>,
    bits: u32,
    /// Words given to pages that stay, and words that there are for them. Places begin behind these.
    used: u64,
    room: u64,
    places: u64,
    /// Empty places, the next one last.
    free: Vec<u64>,
    /// Words in front that have been written to.
    written: u64,
    /// Bytes that were written, ever.
    pub(super) bytes: u64,
    writer: RunWriter,
}

/// Where each page goes from word `at` on, so that none lies in two arrays of 2^`bits` words; and the first word behind
/// them.
fn layout(pages: &[PageEntry], mut at: u64, bits: u32) -> (Vec<u64>, u64) {
    let mut offsets = Vec::with_capacity(pages.len());
    for page in pages {
        let words = u64::from(page.words);
        if at >> bits != (at + words.max(1) - 1) >> bits {
            at = ((at >> bits) + 1) << bits;
        }
        offsets.push(at);
        at = (at + words).next_multiple_of(QUAD.into());
    }
    (offsets, at)
}

/// Words that all arrays of a device hold together.
fn most_words(context: &Context) -> u64 {
    (PAGE_ARRAYS as u64) << context.array_bits()
}

impl PageArrays {
    /// Words that are given away once the pages of these meshes follow what is there already.
    pub(super) fn words_with<'a>(
        &self,
        context: &Context,
        meshes: impl Iterator<Item = &'a [PageEntry]>,
    ) -> u64 {
        meshes.fold(self.used, |at, pages| layout(pages, at, context.array_bits()).1)
    }

    /// How many places a device has beside so many words of pages that stay.
    pub(super) fn places_beside(context: &Context, words: u64) -> usize {
        (most_words(context).saturating_sub(words) / PLACE_WORDS) as usize
    }

    /// Arrays with so many places and room for so many words of pages that stay, and where the device allows for as many
    /// words again.
    pub(super) fn new(context: &Context, words: u64, places: usize) -> Result<Self> {
        let (bits, array) = (context.array_bits(), 1 << context.array_bits());
        let place_words = places as u64 * PLACE_WORDS;
        let least = words.next_multiple_of(PLACE_WORDS) + place_words;
        if least > most_words(context) {
            return Err(unavailable(format!(
                "{WHAT} take {} MiB, and {} gives {PAGE_ARRAYS} arrays of at most {} MiB",
                mib(least * WORD),
                context.name(),
                mib(array * WORD)
            )));
        }
        // No array for the room alone.
        let all = (least + words.next_multiple_of(PLACE_WORDS)).min(least.next_multiple_of(array));
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let part = |first| context.buffer(WHAT, array.min(all - first) * WORD, usage);
        let arrays = (0..all.max(1)).step_by(array as usize).map(part).collect::<Result<_>>()?;
        let free = (0..places as u64).rev().collect();
        let (room, places) = (all - place_words, places as u64);
        Ok(Self { arrays, bits, room, places, free, ..Self::default() })
    }

    /// Whether there is room for so many words of pages that stay and for so many places.
    pub(super) fn has_room(&self, words: u64, places: usize) -> bool {
        !self.arrays.is_empty() && words <= self.room && places as u64 <= self.places
    }

    /// Appends pages that stay, of which `words` has the words. Returns where each starts.
    pub(super) fn append<W: AsRef<[u32]>>(
        &mut self,
        context: &Context,
        pages: &[PageEntry],
        words: impl Fn(usize) -> W,
    ) -> Result<Vec<u32>> {
        let (starts, end) = layout(pages, self.used, self.bits);
        for (page, at) in starts.iter().enumerate() {
            self.write(context, *at, words(page).as_ref())?;
        }
        (self.used, self.written) = (end, self.written.max(end));
        // What all arrays hold bounds them.
        Ok(starts.into_iter().map(|at| at as u32).collect())
    }

    /// Puts a page in an empty place. Returns where it starts.
    pub(super) fn place(&mut self, context: &Context, words: &[u32]) -> Result<u32> {
        let free = self.free.pop();
        let place = free.ok_or_else(|| Error::Invariant("no place for a page is free".to_owned()))?;
        let at = self.room + place * PLACE_WORDS;
        self.write(context, at, words)?;
        self.written = self.written.max(at + PLACE_WORDS);
        Ok(at as u32)
    }

    /// Empties the place of the page that starts there.
    pub(super) fn clear(&mut self, start: u32) {
        self.free.push((u64::from(start) - self.room) / PLACE_WORDS);
    }

    /// Writes runs of words, each of which belongs to a page that is there, from a word on.
    pub(super) fn rewrite<'a>(
        &mut self,
        context: &Context,
        parts: impl Iterator<Item = (u64, &'a [u32])>,
    ) -> Result<()> {
        let mut runs: [Runs; PAGE_ARRAYS] = Default::default();
        for (at, words) in parts {
            runs[(at >> self.bits) as usize].push(at & ((1 << self.bits) - 1), words);
        }
        let mut writer = std::mem::take(&mut self.writer);
        for (runs, array) in runs.iter().zip(self.arrays()).filter(|(runs, _)| !runs.is_empty()) {
            writer.write(context, array, runs)?;
        }
        self.writer = writer;
        self.bytes += runs.iter().map(Runs::bytes).sum::<u64>();
        Ok(())
    }

    fn write(&mut self, context: &Context, at: u64, words: &[u32]) -> Result<()> {
        self.bytes += size_of_val(words) as u64;
        let (array, word) = (at >> self.bits, at & ((1 << self.bits) - 1));
        context.write(WHAT, &self.arrays[array as usize], word * WORD, bytemuck::cast_slice(words))
    }

    /// What kernels bind of the arrays: what has been written to. The first again where there are fewer.
    pub(super) fn arrays(&self) -> [BoundBuffer<'_>; PAGE_ARRAYS] {
        std::array::from_fn(|k| {
            let number = if k < self.arrays.len() { k } else { 0 };
            let buffer = &self.arrays[number];
            let words = self.written.saturating_sub((number as u64) << self.bits).max(QUAD.into());
            BoundBuffer { buffer, offset: 0, size: BufferSize::new((words * WORD).min(buffer.size())) }
        })
    }

    /// Whether there are several.
    pub(super) fn split(&self) -> bool {
        self.arrays.len() > 1
    }
}
