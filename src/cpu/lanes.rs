//! Eight floats side by side. Plain loops that compilers turn into vector instructions; every operation is
//! one IEEE operation per lane, so results do not depend on which instructions those are.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Number of lanes.
pub const LANES: usize = 8;

/// One expression per lane. A loop, not a closure: closures do not always inline where vectors are widest.
macro_rules! lanes {
    ($i:ident => $value:expr) => {{
        let mut out = [0.0f32; LANES];
        for $i in 0..LANES {
            out[$i] = $value;
        }
        Lanes(out)
    }};
}

/// Eight floats.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub struct Lanes(pub [f32; LANES]);

impl Lanes {
    /// The same value in every lane.
    #[inline(always)]
    pub fn splat(v: f32) -> Self {
        Self([v; LANES])
    }

    /// Square roots.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        lanes!(i => self.0[i].sqrt())
    }

    /// Whether all are in one octave: [2ⁿ, 2ⁿ⁺¹) for some n.
    #[inline(always)]
    pub fn in_one_octave(self) -> bool {
        let first = self.0[0].to_bits() >> 23;
        let mut other = 0;
        for lane in 1..LANES {
            other |= (self.0[lane].to_bits() >> 23) ^ first;
        }
        other == 0
    }

    /// The least and the largest; any where they do not compare.
    #[inline(always)]
    pub fn range(self) -> (f32, f32) {
        let (mut low, mut high) = (self.0[0], self.0[0]);
        for lane in 1..LANES {
            low = if self.0[lane] < low { self.0[lane] } else { low };
            high = if self.0[lane] > high { self.0[lane] } else { high };
        }
        (low, high)
    }

    /// The next whole numbers below.
    #[inline(always)]
    pub fn floor(self) -> Self {
        lanes!(i => self.0[i].floor())
    }

    /// Absolute values.
    #[inline(always)]
    pub fn abs(self) -> Self {
        lanes!(i => self.0[i].abs())
    }

    /// The larger of each pair; the second where they do not compare.
    #[inline(always)]
    pub fn max(self, other: f32) -> Self {
        lanes!(i => if self.0[i] > other { self.0[i] } else { other })
    }

    /// The smaller of each pair; the second where they do not compare.
    #[inline(always)]
    pub fn min(self, other: f32) -> Self {
        lanes!(i => if self.0[i] < other { self.0[i] } else { other })
    }

    /// Lanes of `yes` where this is negative, of `no` elsewhere.
    #[inline(always)]
    pub fn where_negative(self, yes: Self, no: Self) -> Self {
        lanes!(i => if self.0[i] < 0.0 { yes.0[i] } else { no.0[i] })
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                lanes!(i => self.0[i] $op other.0[i])
            }
        }
        impl $trait<f32> for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: f32) -> Self {
                lanes!(i => self.0[i] $op other)
            }
        }
    };
}
operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);

impl Neg for Lanes {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        lanes!(i => -self.0[i])
    }
}

/// Eight vectors.
pub type Vec3x8 = [Lanes; 3];

/// How far vectors reach along one and the same.
#[inline(always)]
pub fn along(axis: &[f32; 3], v: &Vec3x8) -> Lanes {
    v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2]
}

/// Dot products.
#[inline(always)]
pub fn dot(a: &Vec3x8, b: &Vec3x8) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Unit vectors; zero vectors become +Z.
#[inline(always)]
pub fn normalize(v: &Vec3x8) -> Vec3x8 {
    let length = dot(v, v).sqrt();
    let inverse = Lanes::splat(1.0) / length;
    // Not finite where the length is 0, and there v is 0 too.
    let ok = length - f32::MIN_POSITIVE;
    let scaled = [v[0] * inverse, v[1] * inverse, v[2] * inverse];
    [
        ok.where_negative(Lanes::splat(0.0), scaled[0]),
        ok.where_negative(Lanes::splat(0.0), scaled[1]),
        ok.where_negative(Lanes::splat(1.0), scaled[2]),
    ]
}

/// The same vector in every lane.
#[inline(always)]
pub fn splat3(v: [f32; 3]) -> Vec3x8 {
    [Lanes::splat(v[0]), Lanes::splat(v[1]), Lanes::splat(v[2])]
}

/// Weighted sums of three vectors.
#[inline(always)]
pub fn blend(weights: &Vec3x8, v: &[Vec3x8; 3]) -> Vec3x8 {
    [
        weights[0] * v[0][0] + weights[1] * v[1][0] + weights[2] * v[2][0],
        weights[0] * v[0][1] + weights[1] * v[1][1] + weights[2] * v[2][1],
        weights[0] * v[0][2] + weights[1] * v[1][2] + weights[2] * v[2][2],
    ]
}

/// Differences.
#[inline(always)]
pub fn minus(a: &Vec3x8, b: &Vec3x8) -> Vec3x8 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Cross products.
#[inline(always)]
pub fn cross(a: &Vec3x8, b: &Vec3x8) -> Vec3x8 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// One matrix applied to eight vectors.
#[inline(always)]
pub fn apply(m: &[[f32; 3]; 3], v: &Vec3x8) -> Vec3x8 {
    [
        v[0] * m[0][0] + v[1] * m[0][1] + v[2] * m[0][2],
        v[0] * m[1][0] + v[1] * m[1][1] + v[2] * m[1][2],
        v[0] * m[2][0] + v[1] * m[2][1] + v[2] * m[2][2],
    ]
}
