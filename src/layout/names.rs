//! The order of identities: that in which pages first use them, which files code in next to no bits (`format/page.rs`).

/// Not seen yet.
const UNSEEN: u32 = u32::MAX;

/// New numbers for vertices, in the order of their first use.
#[derive(Debug)]
pub struct FirstUse {
    names: Vec<u32>,
    count: u32,
}

impl FirstUse {
    /// Of so many vertices, none of which is used yet.
    pub fn new(vertices: usize) -> Self {
        Self { names: vec![UNSEEN; vertices], count: 0 }
    }

    /// Uses a vertex.
    #[inline]
    pub fn add(&mut self, v: u32) {
        let name = &mut self.names[v as usize];
        if *name == UNSEEN {
            *name = self.count;
            self.count += 1;
        }
    }

    /// The numbers, and how many vertices are in use.
    pub fn finish(self) -> (Vec<u32>, u32) {
        (self.names, self.count)
    }
}

/// Rows of `width` words of those vertices that are in use, by their new numbers.
pub fn renamed_rows(words: &[u32], width: usize, names: &[u32], count: u32) -> Vec<u32> {
    let mut out = vec![0; count as usize * width];
    for (row, name) in words.chunks_exact(width).zip(names).filter(|(_, name)| **name != UNSEEN) {
        out[*name as usize * width..][..width].copy_from_slice(row);
    }
    out
}
