//! A table that numbers equal rows alike: open addressing over row indices, in order of first appearance.

use std::hash::Hasher;

use rustc_hash::FxHasher;

/// For each row of `words` (rows of `stride` words), the index of the first row equal to it.
pub fn first_equal(words: &[u32], stride: usize) -> Vec<u32> {
    let count = words.len() / stride;
    let mask = (count * 2).next_power_of_two().max(16) - 1;
    let mut table = vec![u32::MAX; mask + 1];
    let row = |i: usize| &words[i * stride..][..stride];
    (0..count)
        .map(|i| {
            let mut hasher = FxHasher::default();
            row(i).iter().for_each(|w| hasher.write_u32(*w));
            let mut slot = hasher.finish() as usize & mask;
            loop {
                match table[slot] {
                    u32::MAX => {
                        table[slot] = i as u32;
                        return i as u32;
                    }
                    other if row(other as usize) == row(i) => return other,
                    _ => slot = (slot + 1) & mask,
                }
            }
        })
        .collect()
}
