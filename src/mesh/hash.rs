//! A table that numbers equal rows alike: open addressing over row indices, in order of first appearance.

use std::hash::Hasher;
use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;
use rustc_hash::FxHasher;

/// Rows from which on the work is shared between threads.
const PARALLEL_ROWS: usize = 1 << 15;
/// Rows a thread distributes at a time.
const CHUNK_ROWS: usize = 1 << 16;
/// Rows of a shard, about: few enough that its table stays in cache.
const SHARD_ROWS: usize = 1 << 14;
/// Bits that choose a shard, at most: a chunk has several rows for each.
const SHARD_BITS: u32 = 10;

/// For each row of `words` (rows of `stride` words), the index of the first row equal to it.
pub fn first_equal(words: &[u32], stride: usize) -> Vec<u32> {
    first_equal_of(&[(words, stride)])
}

/// The same where a row is made of a row of each of several tables of (words, stride).
pub fn first_equal_of(tables: &[(&[u32], usize)]) -> Vec<u32> {
    let count = tables.first().map_or(0, |(words, stride)| words.len() / stride);
    let rows = Rows(tables);
    if count < PARALLEL_ROWS {
        let mut first: Vec<u32> = (0..count as u32).collect();
        let all = (0..count as u32).map(|row| Tagged { row, tag: tag(rows.hash(row)) });
        rows.repeats(count, all, |i, of| first[i as usize] = of);
        return first;
    }
    // Equal rows have equal hashes and so come to the same shard, each shard in the order of the rows.
    let bits = (count / SHARD_ROWS).next_power_of_two().trailing_zeros().min(SHARD_BITS);
    let starts: Vec<usize> = (0..count).step_by(CHUNK_ROWS).collect();
    let distributed = |start| Chunk::new(&rows, start..(start + CHUNK_ROWS).min(count), bits);
    let chunks: Vec<Chunk> = starts.into_par_iter().map(distributed).collect();
    let first: Vec<AtomicU32> = (0..count as u32).into_par_iter().map(AtomicU32::new).collect();
    (0..1 << bits).into_par_iter().for_each(|shard| {
        let of_shard = chunks.iter().map(|c| c.shard(shard));
        let count = of_shard.clone().map(<[_]>::len).sum();
        // No two shards have a row in common.
        let tell = |i: u32, of| first[i as usize].store(of, Ordering::Relaxed);
        rows.repeats(count, of_shard.flatten().copied(), tell);
    });
    first.into_iter().map(AtomicU32::into_inner).collect()
}

/// A row and part of its hash: rows of different tags are not looked at.
#[derive(Clone, Copy)]
struct Tagged {
    tag: u32,
    row: u32,
}

/// The part of a hash that chooses no shard.
fn tag(hash: u64) -> u32 {
    (hash << SHARD_BITS >> 32) as u32
}

/// Consecutive rows by the shard they belong to.
struct Chunk {
    rows: Vec<Tagged>,
    /// Where each shard starts in `rows`; one more entry than shards.
    starts: Vec<u32>,
}

impl Chunk {
    fn new(rows: &Rows<'_>, range: std::ops::Range<usize>, bits: u32) -> Self {
        let shard = |hash: u64| (hash >> (64 - bits)) as usize;
        let hashes: Vec<u64> = range.clone().map(|i| rows.hash(i as u32)).collect();
        // Counted two places ahead, so that filling leaves the starts where they belong.
        let mut starts = vec![0u32; (1 << bits) + 2];
        hashes.iter().for_each(|hash| starts[shard(*hash) + 2] += 1);
        for i in 2..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut out = vec![Tagged { tag: 0, row: 0 }; hashes.len()];
        for (hash, row) in hashes.iter().zip(range.start as u32..) {
            let at = &mut starts[shard(*hash) + 1];
            out[*at as usize] = Tagged { tag: tag(*hash), row };
            *at += 1;
        }
        Self { rows: out, starts }
    }

    fn shard(&self, shard: usize) -> &[Tagged] {
        &self.rows[self.starts[shard] as usize..self.starts[shard + 1] as usize]
    }
}

struct Rows<'a>(&'a [(&'a [u32], usize)]);

impl Rows<'_> {
    /// A row, in a part from each table.
    fn row(&self, i: u32) -> impl Iterator<Item = &[u32]> {
        self.0.iter().map(move |(words, stride)| &words[i as usize * stride..][..*stride])
    }

    fn hash(&self, i: u32) -> u64 {
        let mut hasher = FxHasher::default();
        self.row(i).flatten().for_each(|w| hasher.write_u32(*w));
        // Low bits of the tag choose a slot, high ones of the hash a shard: neither may follow from the other.
        hasher.finish().wrapping_mul(0x9e37_79b9_7f4a_7c15)
    }

    /// Tells each of `count` rows, in order, that is equal to an earlier one.
    fn repeats(&self, count: usize, rows: impl Iterator<Item = Tagged>, mut tell: impl FnMut(u32, u32)) {
        const FREE: Tagged = Tagged { tag: 0, row: u32::MAX };
        let mask = (count * 2).next_power_of_two().max(16) - 1;
        let mut table = vec![FREE; mask + 1];
        for new in rows {
            let mut slot = new.tag as usize & mask;
            loop {
                let known = table[slot];
                if known.row == FREE.row {
                    table[slot] = new;
                    break;
                }
                if known.tag == new.tag && self.row(known.row).eq(self.row(new.row)) {
                    tell(new.row, known.row);
                    break;
                }
                slot = (slot + 1) & mask;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_work_finds_what_one_thread_finds() {
        let words: Vec<u32> = (0..6 * PARALLEL_ROWS as u32).map(|i| (i / 3 * 7919) % 30_011 * 17).collect();
        let mut expected = vec![0; words.len() / 3];
        let mut known = std::collections::BTreeMap::new();
        for (i, row) in words.chunks(3).enumerate() {
            expected[i] = *known.entry(row).or_insert(i as u32);
        }
        assert!(known.len() < expected.len());
        assert_eq!(first_equal(&words, 3), expected);
        assert_eq!(first_equal(&words[..300], 3), expected[..100]);
        assert!(first_equal(&[], 3).is_empty());
    }
}
