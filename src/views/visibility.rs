//! What a pixel of a visibility buffer says, and the visible cluster list that it numbers.
//!
//! A word has 64 bits. High 32 bits: the depth key, larger is nearer. Low 32 bits: the complement of
//! (1 + visible cluster) << 7 | triangle, so that of two triangles at exactly the same depth the one with the
//! smaller number wins, whatever the order of the threads. Background is 0.
//!
//! Where depth is all that is asked for, a pixel has the high half alone: half the memory, and no numbers to keep.

use crate::limits::TRIANGLE_BITS;
use crate::model::ClusterAddress;

/// A cluster that is drawn: an entry of the frame's visible list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Visible {
    /// Index in the frame's list of instances.
    pub instance: u32,
    /// The cluster.
    pub cluster: ClusterAddress,
}

/// What a pixel shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hit {
    /// Depth key.
    pub key: u32,
    /// Index in the frame's visible list.
    pub visible: u32,
    /// Triangle inside the cluster.
    pub triangle: u32,
}

/// The low half of a word for triangle 0 of a visible cluster; triangle t is this minus t.
#[inline]
pub fn payload(visible: usize) -> u32 {
    !((visible as u32 + 1) << TRIANGLE_BITS)
}

/// Decodes a word; `None` is background.
#[inline]
pub fn decode(word: u64) -> Option<Hit> {
    if word == 0 {
        return None;
    }
    let low = !(word as u32);
    Some(Hit {
        key: (word >> 32) as u32,
        visible: (low >> TRIANGLE_BITS) - 1,
        triangle: low & ((1 << TRIANGLE_BITS) - 1),
    })
}
