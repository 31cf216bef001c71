//! The visibility buffer: one 64-bit word per pixel, filled by atomic maximum.
//!
//! High 32 bits: the depth key, larger is nearer. Low 32 bits: the complement of
//! (1 + visible cluster) << 7 | triangle, so that of two triangles at exactly the same depth the one with the
//! smaller number wins, whatever the order of the threads. Background is 0.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

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

/// Where rasterizers write. One implementation keeps the nearest, another counts.
pub trait Sink: Sync {
    /// Offers a word to a pixel.
    fn put(&self, pixel: usize, word: u64);
}

/// Keeps the largest word of every pixel.
pub struct Nearest<'a>(pub &'a [AtomicU64]);

impl Sink for Nearest<'_> {
    #[inline(always)]
    fn put(&self, pixel: usize, word: u64) {
        let cell = &self.0[pixel];
        let mut current = cell.load(Ordering::Relaxed);
        while word > current {
            match cell.compare_exchange_weak(current, word, Ordering::Relaxed, Ordering::Relaxed) {
                Ok(_) => break,
                Err(now) => current = now,
            }
        }
    }
}

/// Counts the triangles that cover every pixel, hidden or not.
pub struct Counter<'a>(pub &'a [AtomicU32]);

impl Sink for Counter<'_> {
    #[inline(always)]
    fn put(&self, pixel: usize, _word: u64) {
        self.0[pixel].fetch_add(1, Ordering::Relaxed);
    }
}

/// Views exclusively held words as atomics.
pub fn as_atomic(words: &mut [u64]) -> &[AtomicU64] {
    const { assert!(align_of::<AtomicU64>() == align_of::<u64>()) };
    // SAFETY: AtomicU64 has the size and, asserted above, the alignment of u64; the exclusive borrow is held
    // for as long as the result lives.
    unsafe { &*(std::ptr::from_mut(words) as *const [AtomicU64]) }
}

/// How many pixels show anything.
pub fn covered(words: &[u64]) -> u64 {
    use rayon::prelude::*;
    words.par_chunks(1 << 14).map(|chunk| chunk.iter().filter(|word| **word != 0).count() as u64).sum()
}

/// Gives every covered pixel the number its visible cluster has in another list: `numbers[old] = new`.
pub fn renumber(words: &mut [u64], numbers: &[u32]) {
    use rayon::prelude::*;
    words.par_chunks_mut(1 << 14).for_each(|chunk| {
        for word in chunk {
            if let Some(hit) = decode(*word) {
                let low = payload(numbers[hit.visible as usize] as usize) - hit.triangle;
                *word = *word >> 32 << 32 | u64::from(low);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::MAX_VISIBLE;

    #[test]
    fn words_decode_to_what_was_put() {
        let mut words = vec![0u64; 2];
        {
            let sink = Nearest(as_atomic(&mut words));
            // A tie in depth: the smaller visible number, then the smaller triangle, wins in any order.
            for (visible, triangle) in [(7, 5), (3, 127), (3, 2), (3, 9), (4, 0)] {
                sink.put(0, 42 << 32 | u64::from(payload(visible) - triangle));
            }
            sink.put(1, 1 << 32 | u64::from(payload(MAX_VISIBLE - 1) - 127));
        }
        assert_eq!(decode(words[0]), Some(Hit { key: 42, visible: 3, triangle: 2 }));
        assert_eq!(decode(words[1]), Some(Hit { key: 1, visible: MAX_VISIBLE as u32 - 1, triangle: 127 }));
        assert_eq!(decode(0), None);
        let mut numbers = vec![0; MAX_VISIBLE];
        numbers[3] = 1_000_000;
        renumber(&mut words[..1], &numbers);
        assert_eq!(decode(words[0]), Some(Hit { key: 42, visible: 1_000_000, triangle: 2 }));
    }
}
