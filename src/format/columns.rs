//! Vertex data as differences from predictions: a vertex is predicted from three earlier ones of its cluster, which
//! `topology.rs` names (parallelogram prediction).

use super::planes::{unzigzag, zigzag};
use crate::math::octahedral::NORMAL_BITS;
use crate::model::packing::ordered;

/// Up to four numbers of a vertex, zeros behind. All loops go over four, which is one register.
pub type Row = [u32; 4];

/// Rows as the coder sees them: how they are predicted, and what is written of them.
pub trait Column {
    /// What is expected at p + q − r.
    fn predict(&self, p: Row, q: Row, r: Row) -> Row;
    /// A small number for a value near what was expected.
    fn code(&self, value: u32, expected: u32) -> u32;
    /// The value of a number.
    fn value(&self, code: u32, expected: u32) -> u32;
}

/// Integers in two's complement, completed to a parallelogram.
pub struct Whole;

impl Column for Whole {
    #[inline(always)]
    fn predict(&self, p: Row, q: Row, r: Row) -> Row {
        std::array::from_fn(|k| p[k].wrapping_add(q[k]).wrapping_sub(r[k]))
    }

    #[inline(always)]
    fn code(&self, value: u32, expected: u32) -> u32 {
        zigzag(value.wrapping_sub(expected))
    }

    #[inline(always)]
    fn value(&self, code: u32, expected: u32) -> u32 {
        expected.wrapping_add(unzigzag(code))
    }
}

/// Bits of f32, completed to a parallelogram, as numbers in the order of the values.
pub struct Float;

impl Column for Float {
    #[inline(always)]
    fn predict(&self, p: Row, q: Row, r: Row) -> Row {
        let [p, q, r] = [p, q, r].map(|row| row.map(f32::from_bits));
        std::array::from_fn(|k| (p[k] + q[k] - r[k]).to_bits())
    }

    #[inline(always)]
    fn code(&self, value: u32, expected: u32) -> u32 {
        zigzag(ordered(value).wrapping_sub(ordered(expected)))
    }

    #[inline(always)]
    fn value(&self, code: u32, expected: u32) -> u32 {
        ordered(ordered(expected).wrapping_add(unzigzag(code)))
    }
}

/// Octahedral coordinates of so many bits, sign-extended; the mean of two is expected, and differences wrap around.
pub struct Normal {
    /// Bits of a coordinate.
    pub bits: u32,
}

impl Normal {
    #[inline(always)]
    fn wrap(&self, t: u32) -> u32 {
        let unused = 2 * NORMAL_BITS - self.bits;
        ((t << unused).cast_signed() >> unused).cast_unsigned()
    }
}

impl Column for Normal {
    #[inline(always)]
    fn predict(&self, p: Row, q: Row, _: Row) -> Row {
        std::array::from_fn(|k| (p[k].wrapping_add(q[k]).cast_signed() >> 1).cast_unsigned())
    }

    #[inline(always)]
    fn code(&self, value: u32, expected: u32) -> u32 {
        zigzag(self.wrap(value.wrapping_sub(expected)))
    }

    #[inline(always)]
    fn value(&self, code: u32, expected: u32) -> u32 {
        self.wrap(expected.wrapping_add(unzigzag(code)))
    }
}

/// Bytes, each as its difference from that of one vertex.
pub struct Color;

impl Column for Color {
    #[inline(always)]
    fn predict(&self, p: Row, _: Row, _: Row) -> Row {
        p
    }

    #[inline(always)]
    fn code(&self, value: u32, expected: u32) -> u32 {
        value.wrapping_sub(expected) & 0xff
    }

    #[inline(always)]
    fn value(&self, code: u32, expected: u32) -> u32 {
        expected.wrapping_add(code) & 0xff
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_come_back() {
        let floats = [0.0f32, -0.0, 1.0, -1.0, 0.1, f32::MIN_POSITIVE, -3.0e-39, f32::MAX, f32::MIN];
        let mut order: Vec<_> = floats.iter().map(|x| (*x, ordered(x.to_bits()))).collect();
        order.sort_by_key(|x| x.1.cast_signed());
        assert!(order.is_sorted_by(|a, b| a.0 <= b.0));
        for a in floats.map(f32::to_bits).into_iter().chain([u32::MAX, 0x8000_8001, 7]) {
            for b in floats.map(f32::to_bits) {
                assert_eq!(Float.value(Float.code(a, b), b), a);
                assert_eq!(Whole.value(Whole.code(a, b), b), a);
                let (a, b) = (a & 0xff, b & 0xff);
                assert_eq!(Color.value(Color.code(a, b), b), a);
            }
        }
        let normal = Normal { bits: 10 };
        for (a, b) in [(-511i32, 511i32), (0, -3), (511, -511)] {
            let (a, b) = (a.cast_unsigned(), b.cast_unsigned());
            assert_eq!(normal.value(normal.code(a, b), b), a);
        }
    }
}
