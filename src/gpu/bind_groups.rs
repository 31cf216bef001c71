//! Bind groups of a view, kept from frame to frame: a frame binds much the same as the one before, and making a group
//! takes longer than recording the dispatch that uses it.

use std::sync::{Mutex, PoisonError};

use rustc_hash::FxHashMap;
use wgpu::{BindGroup, Buffer, BufferSize, ShaderStages};

use super::context::Context;
use super::kernel::{BindingLists, BoundBuffer, Kernel};

/// Frames that a group is kept for without being used. Lists alternate between two frames.
const KEPT_FRAMES: u64 = 2;

/// What a group binds. Kernels that bind the same share it.
#[derive(Debug, PartialEq, Eq, Hash)]
struct Key {
    bindings: BindingLists,
    visibility: ShaderStages,
    buffers: Vec<(Buffer, u64, Option<BufferSize>)>,
}

#[derive(Debug)]
struct Kept {
    group: BindGroup,
    /// The last frame that used it.
    used: u64,
}

/// See the module's documentation. Groups hold the buffers that they bind: whoever replaces these clears them.
#[derive(Debug, Default)]
pub(super) struct BindGroups {
    kept: Mutex<FxHashMap<Key, Kept>>,
    frame: u64,
}

#[expect(clippy::mutable_key_type, reason = "buffers compare and hash by identity, which does not change")]
impl BindGroups {
    /// The group of a kernel for these buffers.
    pub(super) fn get(&self, context: &Context, kernel: Kernel, bound: &[BoundBuffer<'_>]) -> BindGroup {
        let buffers = bound.iter().map(|b| (b.buffer.clone(), b.offset, b.size)).collect();
        let key = Key { bindings: kernel.bindings, visibility: kernel.visibility(), buffers };
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let new = || Kept { group: context.bind(kernel, bound), used: 0 };
        let known = kept.entry(key).or_insert_with(new);
        known.used = self.frame;
        known.group.clone()
    }

    /// A frame was drawn: groups go that were not used of late.
    pub(super) fn next_frame(&mut self) {
        let frame = self.frame;
        let kept = self.kept.get_mut().unwrap_or_else(PoisonError::into_inner);
        kept.retain(|_, kept| frame - kept.used < KEPT_FRAMES);
        self.frame += 1;
    }

    /// Forgets all, and with them the buffers that they bind.
    pub(super) fn clear(&mut self) {
        self.kept.get_mut().unwrap_or_else(PoisonError::into_inner).clear();
    }
}
