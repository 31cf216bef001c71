//! Eight floats side by side. Plain loops that compilers turn into vector instructions; every operation is
//! one IEEE operation per lane, so results do not depend on which instructions those are.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Number of lanes.
pub const LANES: usize = 8;

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

    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = [0.0; LANES];
        for i in 0..LANES {
            out[i] = f(self.0[i], other.0[i]);
        }
        Self(out)
    }

    /// Applies a function to every lane.
    #[inline(always)]
    pub fn map(self, f: impl Fn(f32) -> f32) -> Self {
        let mut out = [0.0; LANES];
        for i in 0..LANES {
            out[i] = f(self.0[i]);
        }
        Self(out)
    }

    /// Square roots.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        self.map(f32::sqrt)
    }

    /// Absolute values.
    #[inline(always)]
    pub fn abs(self) -> Self {
        self.map(f32::abs)
    }

    /// The larger of each pair; the second where they do not compare.
    #[inline(always)]
    pub fn max(self, other: f32) -> Self {
        self.map(|a| if a > other { a } else { other })
    }

    /// The smaller of each pair; the second where they do not compare.
    #[inline(always)]
    pub fn min(self, other: f32) -> Self {
        self.map(|a| if a < other { a } else { other })
    }

    /// Lanes of `yes` where this is negative, of `no` elsewhere.
    #[inline(always)]
    pub fn where_negative(self, yes: Self, no: Self) -> Self {
        let mut out = [0.0; LANES];
        for i in 0..LANES {
            out[i] = if self.0[i] < 0.0 { yes.0[i] } else { no.0[i] };
        }
        Self(out)
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.zip(other, |a, b| a $op b)
            }
        }
        impl $trait<f32> for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: f32) -> Self {
                self.map(|a| a $op other)
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
        self.map(|a| -a)
    }
}

/// Eight vectors.
pub type Vec3x8 = [Lanes; 3];

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

/// Cross products.
#[inline(always)]
pub fn cross(a: &Vec3x8, b: &Vec3x8) -> Vec3x8 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// One matrix applied to eight vectors.
#[inline(always)]
pub fn apply(m: &[[f32; 3]; 3], v: &Vec3x8) -> Vec3x8 {
    let row = |r: &[f32; 3]| v[0] * r[0] + v[1] * r[1] + v[2] * r[2];
    [row(&m[0]), row(&m[1]), row(&m[2])]
}
