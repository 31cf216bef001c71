//! The order of identities: that in which pages first use them, which files code in next to no bits (`format/page.rs`).

/// Not seen yet.
const UNSEEN: u32 = u32::MAX;

/// New numbers for vertices, in the order of their first use, and how many are in use.
pub fn by_first_use(uses: impl Iterator<Item = u32>, vertices: usize) -> (Vec<u32>, u32) {
    let mut names = vec![UNSEEN; vertices];
    let mut count = 0;
    for v in uses {
        let name = &mut names[v as usize];
        if *name == UNSEEN {
            *name = count;
            count += 1;
        }
    }
    (names, count)
}

/// Rows of `width` words of those vertices that are in use, by their new numbers.
pub fn renamed_rows(words: &[u32], width: usize, names: &[u32], count: u32) -> Vec<u32> {
    let mut out = vec![0; count as usize * width];
    for (row, name) in words.chunks_exact(width).zip(names).filter(|(_, name)| **name != UNSEEN) {
        out[*name as usize * width..][..width].copy_from_slice(row);
    }
    out
}
