//! The power 1/2.2, in bytes.

/// Bytes, and what is above all.
const STEPS: usize = 257;

/// round(255 · c^(1/2.2)), exactly: a table of the 255 values of c where the result steps, entered by the
/// leading bits of c.
#[derive(Debug)]
pub struct Gamma {
    steps: [f32; STEPS],
    first: Vec<u8>,
}

impl Gamma {
    /// Below this everything rounds to 0 or 1.
    const LOW: u32 = 0x3680_0000; // 2⁻¹⁸
    const SHIFT: u32 = 16;
    const ONE: u32 = 0x3f80_0000;

    /// The table, made once.
    pub fn get() -> &'static Self {
        static TABLE: std::sync::OnceLock<Gamma> = std::sync::OnceLock::new();
        TABLE.get_or_init(|| {
            let mut steps = [f32::INFINITY; STEPS];
            for (k, step) in steps.iter_mut().enumerate().take(STEPS - 1) {
                *step = ((k as f64 - 0.5).max(0.0) / 255.0).powf(2.2) as f32;
            }
            let first = (0..=(Self::ONE - Self::LOW) >> Self::SHIFT).map(|i| {
                let c = if i == 0 { 0.0 } else { f32::from_bits(Self::LOW + (i << Self::SHIFT)) };
                (steps[1..256].partition_point(|s| *s <= c)) as u8
            });
            let first = first.collect();
            Self { steps, first }
        })
    }

    /// The least value of each byte; the last is above all.
    pub fn steps(&self) -> &[f32] {
        &self.steps
    }

    /// The byte of a value.
    #[inline]
    pub fn encode(&self, c: f32) -> u8 {
        // NaN (a light at the surface) becomes 0.
        let c = if c > 0.0 { c.min(1.0) } else { 0.0 };
        let entry = c.to_bits().saturating_sub(Self::LOW) >> Self::SHIFT;
        let level = self.first[entry as usize];
        // An entry spans 1/128 of its value, less than a step of the result: there is one to take at most.
        level + u8::from(self.steps[usize::from(level) + 1] <= c)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gamma_table_equals_the_power() {
        let gamma = Gamma::get();
        let mut c = 0.0f32;
        while c < 1.2 {
            let exact = f64::from(c.min(1.0)).powf(1.0 / 2.2) * 255.0;
            let got = f64::from(gamma.encode(c));
            assert!((got - exact).abs() <= 0.5 + 1e-4, "{c}: {got} for {exact}");
            c = if c < 1e-6 { c + 1e-8 } else { c * 1.000_37 };
        }
        for (c, byte) in [(f32::NAN, 0), (-1.0, 0), (f32::INFINITY, 255), (1.0, 255), (0.0, 0)] {
            assert_eq!(gamma.encode(c), byte);
        }
    }
}
