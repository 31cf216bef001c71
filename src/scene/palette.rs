//! Colours of debug views: one for each thing from a hash of its numbers, and a ramp over counts and levels. The constants
//! are those of `output.wgsl`, too.

/// Where hashes start, and what their words are multiplied by (MurmurHash3's finalizer, Austin Appleby).
pub const HASH_SEED: u32 = 0x9e37_79b9;
/// See [`HASH_SEED`].
pub const HASH_FACTORS: [u32; 2] = [0x85eb_ca6b, 0xc2b2_ae35];
/// The least value and saturation of a hue, and by how much they vary.
pub const HUE_VALUE: [f32; 2] = [0.7, 0.3];
/// See [`HUE_VALUE`].
pub const HUE_SATURATION: [f32; 2] = [0.45, 0.4];
/// Sixths of the circle of hues that the ramp goes through, its darkest channel, and by how much channels vary.
pub const RAMP_SIXTHS: f32 = 4.2;
/// See [`RAMP_SIXTHS`].
pub const RAMP_VALUE: [f32; 2] = [0.12, 0.85];
/// Levels at which the ramp ends.
pub const RAMP_LEVELS: f32 = 14.0;
/// How bright what is seen edge-on is, and how much is added for what faces the eye.
pub const FACING: [f32; 2] = [0.35, 0.65];

/// Random bits from numbers.
pub fn hash(words: [u32; 3]) -> u32 {
    words.iter().fold(HASH_SEED, |h, &w| {
        let mut x = (h ^ w).wrapping_mul(HASH_FACTORS[0]);
        x ^= x >> 15;
        x = x.wrapping_mul(HASH_FACTORS[1]);
        x ^ x >> 13
    })
}

/// A bright colour from random bits.
pub fn hue(bits: u32) -> [f32; 3] {
    let h = (bits & 0xffff) as f32 / 65536.0;
    let value = HUE_VALUE[0] + HUE_VALUE[1] * ((bits >> 16 & 0xff) as f32 / 255.0);
    let saturation = HUE_SATURATION[0] + HUE_SATURATION[1] * ((bits >> 24) as f32 / 255.0);
    [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|shift| {
        let t = ((h + shift).fract() * 6.0 - 3.0).abs() - 1.0;
        value * (1.0 - saturation * (1.0 - t.clamp(0.0, 1.0)))
    })
}

/// Red, orange, yellow, green, cyan, blue over 0 to 1.
pub fn ramp(t: f32) -> [f32; 3] {
    let h = t.clamp(0.0, 1.0) * RAMP_SIXTHS;
    let channel = |shift: f32| (((h + shift).rem_euclid(6.0) - 3.0).abs() - 1.0).clamp(0.0, 1.0);
    [channel(0.0), channel(4.0), channel(2.0)].map(|c| RAMP_VALUE[0] + RAMP_VALUE[1] * c)
}
