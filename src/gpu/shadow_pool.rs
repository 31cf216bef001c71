//! Pages of shadow maps on a device: slots of one buffer. A page keeps its slot for as long as anybody holds it; what frames
//! alone hold goes to the host's memory where its slot is wanted.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, Weak};

use rustc_hash::FxHashSet;
use wgpu::{Buffer, BufferUsages};

use super::context::{Context, lock};
use crate::error::Result;
use crate::limits::{SHADOW_PAGE_TEXELS, SHADOW_SLOT_WORDS};

/// What the buffer holds, for messages.
const WHAT: &str = "pages of shadow maps";
/// Bytes of a slot.
const SLOT_BYTES: u64 = 4 * SHADOW_SLOT_WORDS as u64;
/// Bytes of the keys of a page.
const KEY_BYTES: u64 = 4 * SHADOW_PAGE_TEXELS as u64;
/// Slots that there are at first.
const FIRST_SLOTS: usize = 64;

/// See the module's documentation.
#[derive(Debug)]
pub(super) struct ShadowPool {
    shared: Arc<Shared>,
    /// By slot, those that were handed out last.
    pages: Vec<Weak<DevicePage>>,
}

/// What pages know of their pool.
#[derive(Debug)]
struct Shared {
    context: Arc<Context>,
    buffer: Mutex<Buffer>,
    free: Mutex<Vec<u32>>,
}

/// A page of a shadow map that a device drew.
#[derive(Debug)]
pub struct DevicePage {
    shared: Arc<Shared>,
    place: Mutex<Place>,
    /// Triangles of the light's cut that were drawn.
    triangles: AtomicU32,
}

/// Where a page is.
#[derive(Debug)]
enum Place {
    /// In a slot of the pool.
    Slot(u32),
    /// In the host's memory: its keys.
    Host(Arc<[u32]>),
}

impl ShadowPool {
    pub(super) fn new(context: &Arc<Context>) -> Result<Self> {
        let (buffer, free) = (Mutex::new(Shared::room(context, 0)?), Mutex::default());
        let shared = Arc::new(Shared { context: Arc::clone(context), buffer, free });
        Ok(Self { shared, pages: Vec::new() })
    }

    /// Slots that a device has room for at most.
    pub(super) fn most(context: &Context) -> usize {
        (context.largest_array() / SLOT_BYTES) as usize
    }

    /// The buffer with all slots.
    pub(super) fn buffer(&self) -> Buffer {
        lock(&self.shared.buffer).clone()
    }

    /// Pages for so many, each in a slot. At most `most` slots are made; `kept` pages stay in theirs. What is in a slot is
    /// not known.
    pub(super) fn take(
        &mut self,
        count: usize,
        most: usize,
        kept: &[Arc<DevicePage>],
    ) -> Result<Vec<Arc<DevicePage>>> {
        if lock(&self.shared.free).len() < count {
            self.grow(count, most.min(Self::most(&self.shared.context)))?;
        }
        if lock(&self.shared.free).len() < count {
            self.free(kept)?;
        }
        let mut free = lock(&self.shared.free);
        let first = free.len().saturating_sub(count);
        let slots: Vec<u32> = free.drain(first..).rev().collect();
        drop(free);
        let page = |slot: u32| {
            let page = Arc::new(DevicePage {
                shared: Arc::clone(&self.shared),
                place: Mutex::new(Place::Slot(slot)),
                triangles: AtomicU32::new(0),
            });
            self.pages[slot as usize] = Arc::downgrade(&page);
            page
        };
        Ok(slots.into_iter().map(page).collect())
    }

    /// Makes room for so many more, if there may be as many.
    fn grow(&mut self, more: usize, most: usize) -> Result<()> {
        let now = self.pages.len();
        let wanted = (now + more).next_power_of_two().max(FIRST_SLOTS).min(most);
        if wanted <= now {
            return Ok(());
        }
        let Shared { context, buffer, free } = &*self.shared;
        let larger = Shared::room(context, wanted)?;
        let mut buffer = lock(buffer);
        let mut encoder = context.encoder(WHAT);
        encoder.copy_buffer_to_buffer(&buffer, 0, &larger, 0, now as u64 * SLOT_BYTES);
        context.start(encoder)?;
        *buffer = larger;
        // The first are taken first.
        let mut free = lock(free);
        free.splice(0..0, (now as u32..wanted as u32).rev());
        self.pages.resize(wanted, Weak::new());
        Ok(())
    }

    /// Takes their slots from all pages but those that are kept: frames have them from the host from then on.
    fn free(&mut self, kept: &[Arc<DevicePage>]) -> Result<()> {
        let kept: FxHashSet<u32> = kept.iter().filter_map(|page| page.slot()).collect();
        let held = self.pages.iter().filter_map(Weak::upgrade);
        let held: Vec<Arc<DevicePage>> =
            held.filter(|page| page.slot().is_some_and(|slot| !kept.contains(&slot))).collect();
        for (page, keys) in held.iter().zip(DevicePage::read(&held)?) {
            let before = std::mem::replace(&mut *lock(&page.place), Place::Host(keys));
            if let Place::Slot(slot) = before {
                lock(&self.shared.free).push(slot);
            }
        }
        Ok(())
    }
}

impl Shared {
    fn room(context: &Context, slots: usize) -> Result<Buffer> {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        context.buffer(WHAT, slots as u64 * SLOT_BYTES, usage)
    }
}

impl DevicePage {
    /// Its slot, if it is on the device.
    pub fn slot(&self) -> Option<u32> {
        match *lock(&self.place) {
            Place::Slot(slot) => Some(slot),
            Place::Host(_) => None,
        }
    }

    /// Triangles of the light's cut that were drawn.
    pub fn triangles(&self) -> u32 {
        self.triangles.load(Ordering::Relaxed)
    }

    /// Takes note of how many were drawn.
    pub(super) fn note(&self, triangles: u32) {
        self.triangles.store(triangles, Ordering::Relaxed);
    }

    /// The keys of pages, row by row.
    pub fn read(pages: &[Arc<Self>]) -> Result<Vec<Arc<[u32]>>> {
        let Some(Self { shared, .. }) = pages.first().map(|page| &**page) else { return Ok(Vec::new()) };
        let Shared { context, buffer, .. } = &**shared;
        let count = pages.iter().filter(|page| page.slot().is_some()).count() as u64;
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let staging = context.buffer(WHAT, count * KEY_BYTES, usage)?;
        let mut encoder = context.encoder("reading pages of shadow maps");
        let buffer = lock(buffer);
        let mut at = 0;
        for slot in pages.iter().filter_map(|page| page.slot()) {
            encoder.copy_buffer_to_buffer(&buffer, u64::from(slot) * SLOT_BYTES, &staging, at, KEY_BYTES);
            at += KEY_BYTES;
        }
        drop(buffer);
        let mut read: Vec<Arc<[u32]>> = Vec::new();
        if count > 0 {
            context.submit(encoder, &staging, count * KEY_BYTES, |staged| {
                let keys = staged.chunks_exact(KEY_BYTES as usize);
                read = keys.map(|keys| bytemuck::pod_collect_to_vec(keys).into()).collect();
            })?;
        }
        let mut read = read.into_iter();
        let keys = |page: &Arc<Self>| match &*lock(&page.place) {
            Place::Host(keys) => Some(Arc::clone(keys)),
            Place::Slot(_) => read.next(),
        };
        Ok(pages.iter().filter_map(keys).collect())
    }
}

impl Drop for DevicePage {
    fn drop(&mut self) {
        if let Some(slot) = self.slot() {
            lock(&self.shared.free).push(slot);
        }
    }
}
