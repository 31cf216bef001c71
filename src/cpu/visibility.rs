//! The visibility buffer while rasterizers write: words and keys, filled by atomic maximum. What they mean is in
//! [`crate::views::visibility`].

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use rayon::prelude::*;

use crate::views::{decode, payload};

/// Where rasterizers write. One implementation keeps the nearest, another counts.
pub trait Sink: Sync {
    /// Offers a word to a pixel.
    fn put(&self, pixel: usize, word: u64);
}

/// Keeps the largest word of every pixel, or the largest key.
pub struct Nearest<'a, C>(pub &'a [C]);

impl<C: Cell> Sink for Nearest<'_, C> {
    #[inline(always)]
    fn put(&self, pixel: usize, word: u64) {
        self.0[pixel].raise(word);
    }
}

/// A pixel while rasterizers write.
pub trait Cell: Sync {
    /// Takes what it holds of a word where that is larger.
    fn raise(&self, word: u64);
}

impl Cell for AtomicU64 {
    #[inline(always)]
    fn raise(&self, word: u64) {
        let mut current = self.load(Ordering::Relaxed);
        while word > current {
            match self.compare_exchange_weak(current, word, Ordering::Relaxed, Ordering::Relaxed) {
                Ok(_) => break,
                Err(now) => current = now,
            }
        }
    }
}

impl Cell for AtomicU32 {
    #[inline(always)]
    fn raise(&self, word: u64) {
        let key = (word >> 32) as u32;
        if key > self.load(Ordering::Relaxed) {
            self.fetch_max(key, Ordering::Relaxed);
        }
    }
}

/// What a visibility buffer has for a pixel: a word, or its key alone. Background is the default.
pub trait Pixel: Copy + Default + PartialEq + Send + Sync {
    /// The same while rasterizers write.
    type Cell: Cell;

    /// The depth key.
    fn key(self) -> u32;

    /// The visible cluster that it shows, where it says.
    fn visible(self) -> Option<u32>;

    /// Views exclusively held pixels as atomics.
    fn cells(pixels: &mut [Self]) -> &[Self::Cell];

    /// Gives every covered pixel the number its visible cluster has in another list: `numbers[old] = new`.
    fn renumber(pixels: &mut [Self], numbers: &[u32]);
}

impl Pixel for u64 {
    type Cell = AtomicU64;

    #[inline(always)]
    fn key(self) -> u32 {
        (self >> 32) as u32
    }

    #[inline(always)]
    fn visible(self) -> Option<u32> {
        decode(self).map(|hit| hit.visible)
    }

    fn cells(pixels: &mut [Self]) -> &[AtomicU64] {
        const { assert!(align_of::<AtomicU64>() == align_of::<u64>()) };
        // SAFETY: AtomicU64 has the size and, asserted above, the alignment of u64; the exclusive borrow is held
        // for as long as the result lives.
        unsafe { &*(std::ptr::from_mut(pixels) as *const [AtomicU64]) }
    }

    fn renumber(pixels: &mut [Self], numbers: &[u32]) {
        pixels.par_chunks_mut(1 << 14).for_each(|chunk| {
            for word in chunk {
                if let Some(hit) = decode(*word) {
                    let low = payload(numbers[hit.visible as usize] as usize) - hit.triangle;
                    *word = *word >> 32 << 32 | u64::from(low);
                }
            }
        });
    }
}

impl Pixel for u32 {
    type Cell = AtomicU32;

    #[inline(always)]
    fn key(self) -> u32 {
        self
    }

    /// A key says none.
    fn visible(self) -> Option<u32> {
        None
    }

    fn cells(pixels: &mut [Self]) -> &[AtomicU32] {
        const { assert!(align_of::<AtomicU32>() == align_of::<u32>()) };
        // SAFETY: as for words.
        unsafe { &*(std::ptr::from_mut(pixels) as *const [AtomicU32]) }
    }

    /// A key says no number.
    fn renumber(_pixels: &mut [Self], _numbers: &[u32]) {}
}

/// Counts the triangles that cover every pixel, hidden or not.
pub struct Counter<'a>(pub &'a [AtomicU32]);

impl Sink for Counter<'_> {
    #[inline(always)]
    fn put(&self, pixel: usize, _word: u64) {
        self.0[pixel].fetch_add(1, Ordering::Relaxed);
    }
}

/// How many pixels show anything.
pub fn covered<P: Pixel>(pixels: &[P]) -> u64 {
    let nothing = P::default();
    pixels.par_chunks(1 << 14).map(|chunk| chunk.iter().filter(|p| **p != nothing).count() as u64).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::MAX_VISIBLE;
    use crate::views::Hit;

    #[test]
    fn words_decode_to_what_was_put() {
        let mut words = vec![0u64; 2];
        {
            let sink = Nearest(u64::cells(&mut words));
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
        u64::renumber(&mut words[..1], &numbers);
        assert_eq!(decode(words[0]), Some(Hit { key: 42, visible: 1_000_000, triangle: 2 }));
    }
    #[test]
    fn keys_are_the_high_halves_of_words() {
        let (mut words, mut keys) = ([0u64; 3], [0u32; 3]);
        for (pixel, word) in [(0, 5 << 32 | 9), (0, 7 << 32 | 2), (0, 6 << 32 | 99), (2, u64::MAX), (2, 1)] {
            Nearest(u64::cells(&mut words)).put(pixel, word);
            Nearest(u32::cells(&mut keys)).put(pixel, word);
        }
        assert_eq!((keys, words.map(Pixel::key)), ([7, 0, u32::MAX], [7, 0, u32::MAX]));
        assert_eq!((covered(&keys), covered(&words)), (2, 2));
        u32::renumber(&mut keys, &[]);
        assert_eq!(keys, [7, 0, u32::MAX]);
    }
}
