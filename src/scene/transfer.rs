//! From linear light to what pictures hold, and back.

use std::sync::OnceLock;

use crate::config::Transfer;
use crate::threads::once;

impl Transfer {
    /// What a picture holds for light, both from 0 to 1.
    pub fn encode(self, c: f64) -> f64 {
        match self {
            Self::Gamma22 => c.powf(1.0 / 2.2),
            Self::Srgb if c <= 0.003_130_8 => 12.92 * c,
            Self::Srgb => 1.055 * c.powf(1.0 / 2.4) - 0.055,
            Self::Linear => c,
        }
    }

    /// The light of what a picture holds.
    pub fn decode(self, v: f64) -> f64 {
        match self {
            Self::Gamma22 => v.powf(2.2),
            Self::Srgb if v <= 0.040_45 => v / 12.92,
            Self::Srgb => ((v + 0.055) / 1.055).powf(2.4),
            Self::Linear => v,
        }
    }

    /// The exponent of a power close to [`Transfer::encode`].
    pub fn power(self) -> f32 {
        match self {
            Self::Gamma22 | Self::Srgb => 1.0 / 2.2,
            Self::Linear => 1.0,
        }
    }

    /// round(65535 · encode(c)).
    pub fn word(self, c: f32) -> u16 {
        (self.encode(f64::from(clamped(c))) * 65535.0).round() as u16
    }

    /// The light of a byte.
    pub fn light(self, byte: u8) -> f32 {
        self.decode(f64::from(byte) / 255.0) as f32
    }

    /// For bytes; made once.
    pub fn encoder(self) -> &'static Encoder {
        static ENCODERS: [OnceLock<Encoder>; 3] = [const { OnceLock::new() }; 3];
        once(&ENCODERS[self as usize], || Encoder::new(self))
    }
}

/// Between 0 and 1; NaN (a light at the surface) becomes 0.
#[inline]
fn clamped(c: f32) -> f32 {
    if c > 0.0 { c.min(1.0) } else { 0.0 }
}

/// Bytes, and what is above all.
pub const BYTE_STEPS: usize = 257;

/// round(255 · encode(c)), exactly: a table of the 255 values of c where the result steps, entered by the
/// leading bits of c.
#[derive(Debug)]
pub struct Encoder {
    steps: [f32; BYTE_STEPS],
    first: Vec<u8>,
}

impl Encoder {
    /// Below this everything rounds to 0 or 1.
    const LOW: u32 = 0x3680_0000; // 2⁻¹⁸
    const SHIFT: u32 = 15;
    const ONE: u32 = 0x3f80_0000;

    fn new(transfer: Transfer) -> Self {
        let mut steps = [f32::INFINITY; BYTE_STEPS];
        for (k, step) in steps.iter_mut().enumerate().take(BYTE_STEPS - 1) {
            *step = transfer.decode((k as f64 - 0.5).max(0.0) / 255.0) as f32;
        }
        let first = (0..=(Self::ONE - Self::LOW) >> Self::SHIFT).map(|i| {
            let c = if i == 0 { 0.0 } else { f32::from_bits(Self::LOW + (i << Self::SHIFT)) };
            (steps[1..256].partition_point(|s| *s <= c)) as u8
        });
        let first = first.collect();
        Self { steps, first }
    }

    /// The least value of each byte; the last is above all.
    pub fn steps(&self) -> &[f32] {
        &self.steps
    }

    /// The byte of a value.
    #[inline]
    pub fn encode(&self, c: f32) -> u8 {
        let c = clamped(c);
        let entry = c.to_bits().saturating_sub(Self::LOW) >> Self::SHIFT;
        let level = self.first[entry as usize];
        // An entry spans 1/256 of its value, less than a step of the result: there is one to take at most.
        level + u8::from(self.steps[usize::from(level) + 1] <= c)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Transfer; 3] = [Transfer::Gamma22, Transfer::Srgb, Transfer::Linear];

    #[test]
    fn bytes_are_the_curve_rounded() {
        for transfer in ALL {
            let encoder = transfer.encoder();
            let mut c = 0.0f32;
            while c < 1.2 {
                let exact = transfer.encode(f64::from(c.min(1.0))) * 255.0;
                let got = f64::from(encoder.encode(c));
                assert!((got - exact).abs() <= 0.5 + 1e-4, "{c}: {got} for {exact}");
                c = if c < 1e-6 { c + 1e-8 } else { c * 1.000_37 };
            }
            for (c, byte) in [(f32::NAN, 0), (-1.0, 0), (f32::INFINITY, 255), (1.0, 255), (0.0, 0)] {
                assert_eq!(encoder.encode(c), byte);
                assert_eq!(transfer.word(c), 257 * u16::from(byte));
            }
        }
    }

    #[test]
    fn bytes_come_back() {
        for transfer in ALL {
            for byte in 0..=255 {
                assert_eq!(transfer.encoder().encode(transfer.light(byte)), byte);
                assert_eq!(transfer.word(transfer.light(byte)), 257 * u16::from(byte));
            }
        }
        // IEC 61966-2-1: the two pieces meet, and the middle grey is at 0.214.
        assert!((Transfer::Srgb.encode(0.003_130_8) - 0.040_45).abs() < 1e-5);
        assert!((Transfer::Srgb.light(128) - 0.215_861).abs() < 1e-6);
    }
}
