//! Morton (Z-order) codes.

use super::Aabb;

/// 63-bit Morton code of a point inside `bounds`: 21 bits per axis.
pub fn code(point: [f32; 3], bounds: &Aabb) -> u64 {
    let spread = |x: u64| {
        let mut x = x & 0x1f_ffff;
        x = (x | x << 32) & 0x1f_0000_0000_ffff;
        x = (x | x << 16) & 0x1f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    (0..3)
        .map(|k| {
            let extent = f64::from(bounds.max[k]) - f64::from(bounds.min[k]);
            let t =
                if extent > 0.0 { (f64::from(point[k]) - f64::from(bounds.min[k])) / extent } else { 0.0 };
            spread((t.clamp(0.0, 1.0) * 2_097_151.0) as u64) << k
        })
        .fold(0, |a, b| a | b)
}
