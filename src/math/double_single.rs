//! Numbers as sums of two f32, some 46 bits: what shaders without f64 can do as well, operation for operation
//! (`shaders/shared/pair.wgsl`).
//!
//! Dekker, "A floating-point technique for extending the available precision", Numerische Mathematik 18, 1971.

/// The sum of two numbers, of which the second is below the rounding of the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DoubleSingle {
    /// The number rounded to f32.
    pub high: f32,
    /// The rest.
    pub low: f32,
}

/// Splits the 24 bits of a number in halves.
pub const SPLITTER: f32 = 4097.0;

fn split(a: f32) -> (f32, f32) {
    let c = SPLITTER * a;
    let high = c - (c - a);
    (high, a - high)
}

impl DoubleSingle {
    /// a + b, exactly.
    pub fn sum(a: f32, b: f32) -> Self {
        let high = a + b;
        let rest = high - a;
        Self { high, low: (a - (high - rest)) + (b - rest) }
    }

    /// a · b, exactly.
    pub fn product(a: f32, b: f32) -> Self {
        let high = a * b;
        let ((ah, al), (bh, bl)) = (split(a), split(b));
        Self { high, low: ((ah * bh - high) + ah * bl + al * bh) + al * bl }
    }

    /// The sum of two.
    pub fn plus(self, other: Self) -> Self {
        let s = Self::sum(self.high, other.high);
        Self::sum(s.high, s.low + (self.low + other.low))
    }

    /// The difference of two.
    pub fn minus(self, other: Self) -> Self {
        self.plus(Self { high: -other.high, low: -other.low })
    }

    /// The product with a number.
    pub fn times(self, factor: f32) -> Self {
        let p = Self::product(self.high, factor);
        Self::sum(p.high, p.low + self.low * factor)
    }

    /// The quotient of two, rounded to f32.
    pub fn over(self, divisor: Self) -> f32 {
        let quotient = self.high / divisor.high;
        let rest = self.minus(divisor.times(quotient));
        quotient + rest.high / divisor.high
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_have_twice_the_digits() {
        let mut seed = 7u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((seed >> 8) as f32 / 8_388_608.0 - 1.0) * 10f32.powi((seed >> 3) as i32 % 4)
        };
        let wide = |p: DoubleSingle| f64::from(p.high) + f64::from(p.low);
        for _ in 0..20_000 {
            let (a, b, c, d) = (random(), random(), random(), random());
            assert_eq!(wide(DoubleSingle::product(a, b)), f64::from(a) * f64::from(b));
            let (x, y) = (DoubleSingle::product(a, b), DoubleSingle::product(c, d));
            let size = wide(x).abs().max(wide(y).abs());
            let tiny = size / f64::from(1u32 << 22).powi(2);
            assert!((wide(x.minus(y)) - (wide(x) - wide(y))).abs() <= tiny);
            assert!((wide(x.times(c)) - wide(x) * f64::from(c)).abs() <= tiny * f64::from(c).abs());
            let quotient = x.over(y);
            assert!((f64::from(quotient) - wide(x) / wide(y)).abs() <= f64::from(quotient).abs() * 1.0e-7);
        }
    }
}
