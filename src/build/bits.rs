//! A bit for each identity.

/// A set of identities.
#[derive(Clone, Debug)]
pub struct Bits(Vec<u64>);

impl Bits {
    /// An empty set of so many.
    pub fn new(count: usize) -> Self {
        Self(vec![0; count.div_ceil(64)])
    }

    /// Puts one in; whether it was not there before.
    pub fn set(&mut self, id: u32) -> bool {
        let (word, bit) = (&mut self.0[id as usize / 64], 1 << (id % 64));
        let new = *word & bit == 0;
        *word |= bit;
        new
    }

    /// Whether one is there.
    pub fn has(&self, id: u32) -> bool {
        self.0.get(id as usize / 64).is_some_and(|word| word >> (id % 64) & 1 == 1)
    }

    /// How many are there.
    pub fn count(&self) -> u64 {
        self.0.iter().map(|word| u64::from(word.count_ones())).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bit_is_set_once() {
        let mut bits = Bits::new(130);
        assert!([0, 63, 64, 129].iter().all(|id| bits.set(*id)));
        assert!(!bits.set(64) && bits.has(129) && !bits.has(1) && !bits.has(500));
        assert_eq!(bits.count(), 4);
    }
}
