//! Unit vectors in 32 bits: octahedral map, 16 signed bits per axis.
//!
//! Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", JCGT 3(2), 2014.
//! The largest angular error is √6 half steps over the shortest vector of the map, 6.5e-5 rad.

/// Steps of a coordinate from 0 to 1.
pub const OCTAHEDRAL_STEPS: f32 = 32767.0;

fn sign(x: f32) -> f32 {
    if x < 0.0 { -1.0 } else { 1.0 }
}

/// Packs a direction of any length; zero or non-finite input packs +Z.
pub fn encode(v: [f32; 3]) -> u32 {
    let norm = v[0].abs() + v[1].abs() + v[2].abs();
    let [mut x, mut y] = if norm > 0.0 && norm.is_finite() { [v[0] / norm, v[1] / norm] } else { [0.0, 0.0] };
    if v[2] < 0.0 {
        [x, y] = [(1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)];
    }
    // A cast truncates in one instruction; `round` is a call on most targets.
    let snorm = |t: f32| (t.clamp(-1.0, 1.0) * OCTAHEDRAL_STEPS + 0.5f32.copysign(t)) as i16 as u16;
    u32::from(snorm(x)) | u32::from(snorm(y)) << 16
}

/// Unpacks to a unit vector.
pub fn decode(packed: u32) -> [f32; 3] {
    let v = direction(packed);
    let inv = 1.0 / (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|c| c * inv)
}

/// Unpacks to a vector of some length between a half and one.
#[inline(always)]
pub fn direction(packed: u32) -> [f32; 3] {
    let x = f32::from(packed as u16 as i16) / OCTAHEDRAL_STEPS;
    let y = f32::from((packed >> 16) as u16 as i16) / OCTAHEDRAL_STEPS;
    let z = 1.0 - x.abs() - y.abs();
    let t = (-z).max(0.0);
    [x - sign(x) * t, y - sign(y) * t, z]
}

/// Bits of a coordinate in a packed direction.
pub const NORMAL_BITS: u32 = 16;

/// Largest value of a signed coordinate of so many bits.
fn largest(bits: u32) -> i32 {
    (1 << (bits - 1)) - 1
}

/// Both coordinates of a packed direction rounded to `bits` bits, and sign-extended.
pub fn narrow(packed: u32, bits: u32) -> [i32; 2] {
    let (most, scale) = (largest(bits), largest(NORMAL_BITS));
    [packed as u16 as i16, (packed >> NORMAL_BITS) as u16 as i16].map(|t| {
        let t = i32::from(t);
        if bits == NORMAL_BITS { t } else { (2 * t * most + scale * t.signum()) / (2 * scale) }
    })
}

/// The coordinate of a packed direction for one of `bits` bits; the inverse of [`narrow`].
pub fn widen(t: i32, bits: u32) -> u16 {
    let (most, scale) = (largest(bits), largest(NORMAL_BITS));
    let wide =
        if bits == NORMAL_BITS { t } else { (2 * t.max(-most) * scale + most * t.signum()) / (2 * most) };
    wide as i16 as u16
}

/// An upper bound, radians, of the angle between a direction and what [`narrow`] and [`widen`] make of its packed form.
pub fn angle_of_bits(bits: u32) -> f64 {
    if bits == NORMAL_BITS {
        return 0.0;
    }
    // Both coordinates move by half a step, and by half a step of the packed form on the way back. On the octahedron
    // that is √6 times as long at most, and it is at least 1/√3 from the centre.
    let half = 0.5 / f64::from(largest(bits)) + 0.5 / f64::from(largest(NORMAL_BITS));
    (half * 6f64.sqrt() * 3f64.sqrt()).asin() * (1.0 + 1.0e-6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_trip_stays_within_the_stated_angle() {
        for i in 0..20_000 {
            let (a, z) = (i as f32 * 2.399_963, 1.0 - 2.0 * (i as f32 + 0.5) / 20_000.0);
            let r = (1.0 - z * z).sqrt();
            let v = [r * a.cos(), r * a.sin(), z];
            let w = decode(encode(v));
            let cross = [v[1] * w[2] - v[2] * w[1], v[2] * w[0] - v[0] * w[2], v[0] * w[1] - v[1] * w[0]];
            let angle = (cross[0].powi(2) + cross[1].powi(2) + cross[2].powi(2)).sqrt();
            assert!(angle < 6.6e-5, "{v:?} -> {w:?}: {angle}");
        }
        assert_eq!(decode(encode([0.0; 3])), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn fewer_bits_stay_within_the_stated_angle_and_come_back() {
        for bits in [6, 8, 10, 12, 16] {
            let mut worst = 0f64;
            for i in 0..200_000 {
                let (a, z) = (i as f32 * 2.399_963, 1.0 - 2.0 * (i as f32 + 0.5) / 200_000.0);
                let r = (1.0 - z * z).sqrt();
                let packed = encode([r * a.cos(), r * a.sin(), z]);
                let coarse = narrow(packed, bits);
                let [x, y] = coarse.map(|t| u32::from(widen(t, bits)));
                let again = x | y << NORMAL_BITS;
                assert_eq!(narrow(again, bits), coarse);
                let (v, w) = (decode(packed).map(f64::from), decode(again).map(f64::from));
                let d = [v[0] - w[0], v[1] - w[1], v[2] - w[2]];
                worst = worst.max(2.0 * (0.5 * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()).asin());
            }
            let stated = angle_of_bits(bits);
            assert!(worst <= stated + 1.0e-6 && stated < 1.3 * worst + 1.0e-6, "{bits}: {worst} of {stated}");
        }
        assert!([0x8000_8000, 0x8001_7fff, 0].iter().all(|p| {
            let [x, y] = narrow(*p, NORMAL_BITS).map(|t| u32::from(widen(t, NORMAL_BITS)));
            x | y << NORMAL_BITS == *p
        }));
    }
}
