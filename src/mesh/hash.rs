//! A table that numbers equal rows alike: open addressing over row indices, in order of first appearance.

use std::hash::Hasher;

use rayon::prelude::*;
use rustc_hash::FxHasher;

/// Rows from which on the work is shared between threads.
const PARALLEL_ROWS: usize = 1 << 15;
/// Rows a thread distributes at a time.
const CHUNK_ROWS: usize = 1 << 16;
/// Tables the rows are distributed to: small enough to stay in cache.
const SHARDS: usize = 64;

/// For each row of `words` (rows of `stride` words), the index of the first row equal to it.
pub fn first_equal(words: &[u32], stride: usize) -> Vec<u32> {
    first_equal_of(&[(words, stride)])
}

/// The same where a row is made of a row of each of several tables of (words, stride).
pub fn first_equal_of(tables: &[(&[u32], usize)]) -> Vec<u32> {
    let count = tables.first().map_or(0, |(words, stride)| words.len() / stride);
    let rows = Rows(tables);
    let mut first: Vec<u32> = (0..count as u32).collect();
    if count < PARALLEL_ROWS {
        rows.repeats(count, 0..count as u32, |i, of| first[i as usize] = of);
        return first;
    }
    // Equal rows have equal hashes and so come to the same shard, each shard in the order of the rows.
    let starts: Vec<usize> = (0..count).step_by(CHUNK_ROWS).collect();
    let chunks: Vec<[Vec<u32>; SHARDS]> = starts
        .into_par_iter()
        .map(|start| {
            let mut shards = [(); SHARDS].map(|()| Vec::with_capacity(CHUNK_ROWS / SHARDS * 5 / 4));
            for i in start..(start + CHUNK_ROWS).min(count) {
                shards[(rows.hash(i as u32) >> 58) as usize].push(i as u32);
            }
            shards
        })
        .collect();
    let repeats: Vec<Vec<(u32, u32)>> = (0..SHARDS)
        .into_par_iter()
        .map(|shard| {
            let of_shard = chunks.iter().map(|c| &c[shard]);
            let mut repeats = Vec::new();
            rows.repeats(of_shard.clone().map(Vec::len).sum(), of_shard.flatten().copied(), |i, of| {
                repeats.push((i, of));
            });
            repeats
        })
        .collect();
    repeats.into_iter().flatten().for_each(|(i, of)| first[i as usize] = of);
    first
}

struct Rows<'a>(&'a [(&'a [u32], usize)]);

impl Rows<'_> {
    fn row(&self, i: u32) -> impl Iterator<Item = &u32> {
        self.0.iter().flat_map(move |(words, stride)| &words[i as usize * stride..][..*stride])
    }

    fn hash(&self, i: u32) -> u64 {
        let mut hasher = FxHasher::default();
        self.row(i).for_each(|w| hasher.write_u32(*w));
        // The low bits choose a slot, the high ones a shard: neither may follow from the other.
        hasher.finish().wrapping_mul(0x9e37_79b9_7f4a_7c15)
    }

    /// Tells each of `count` rows, in order, that is equal to an earlier one.
    fn repeats(&self, count: usize, rows: impl Iterator<Item = u32>, mut tell: impl FnMut(u32, u32)) {
        let mask = (count * 2).next_power_of_two().max(16) - 1;
        let mut table = vec![u32::MAX; mask + 1];
        for i in rows {
            let mut slot = (self.hash(i) >> 20) as usize & mask;
            loop {
                match table[slot] {
                    u32::MAX => {
                        table[slot] = i;
                        break;
                    }
                    other if self.row(other).eq(self.row(i)) => {
                        tell(i, other);
                        break;
                    }
                    _ => slot = (slot + 1) & mask,
                }
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
