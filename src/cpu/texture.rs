//! A texture at a place: `shaders/shared/texture.wgsl` does the same operations in the same order.
//!
//! A pixel's footprint on the image is taken for an ellipse with the two screen derivatives as axes. As many samples as it is
//! times longer than wide lie along the longer axis, each of the level in which a texel is as wide as the ellipse; so
//! graphics hardware does it, after McCormack, Perry, Farkas and Jouppi, "Feline: fast elliptical lines for anisotropic
//! texture mapping", SIGGRAPH 1999.

use crate::limits::{LOG2_BEND, LONGEST_FOOTPRINT};
use crate::scene::image::{TexelFormat, srgb_light};
use crate::scene::texture::{Mipmaps, Wrap};
use crate::scene::{Image, Texture};

/// Where a pixel lies on an image, in the image's sides from its upper left corner.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Its centre.
    pub at: [f32; 2],
    /// From there to the next pixel on the right, and to the one below.
    pub change: [[f32; 2]; 2],
}

impl Place {
    /// From UVs by the rows of [`Texture::rows`].
    #[inline(always)]
    pub fn new(rows: &[[f32; 3]; 2], uv: [f32; 2], change: [[f32; 2]; 2]) -> Self {
        let at = turned(rows, uv);
        Self { at: [at[0] + rows[0][2], at[1] + rows[1][2]], change: change.map(|d| turned(rows, d)) }
    }
}

/// A way between UVs as one on the image, by the rows of [`Texture::rows`].
#[inline(always)]
pub fn turned(rows: &[[f32; 3]; 2], d: [f32; 2]) -> [f32; 2] {
    rows.map(|[u, v, _]| u * d[0] + v * d[1])
}

impl Texture {
    /// What the pixel sees of it, linear RGBA, where it shows `image`. Always inlined, with all that it calls, so that it is
    /// compiled with the vectors of its caller, and rounding is an instruction.
    #[inline(always)]
    pub fn sample(&self, image: &Image, place: &Place) -> [f32; 4] {
        let Place { at, change: [right, below] } = place;
        let size = [image.width() as f32, image.height() as f32];
        let length = |d: &[f32; 2]| {
            let (x, y) = (d[0] * size[0], d[1] * size[1]);
            between(x * x + y * y, 0.0, LONGEST_FOOTPRINT)
        };
        let (a, b) = (length(right), length(below));
        let (axis, long, short) = if a >= b { (right, a, b) } else { (below, b, a) };
        let (mut count, mut lod) = (1, 0.0);
        if self.mipmaps != Mipmaps::Off {
            let most = self.anisotropy as f32;
            // Of ellipses that are wider than a texel.
            while (count as f32) < most && long > (count * count) as f32 * above(short, 1.0) {
                count += 1;
            }
            let width = above(long * (1.0 / (count * count) as f32), short);
            lod = between(0.5 * log2(width), 0.0, (image.levels() - 1) as f32);
        }
        let mut sum = [0.0; 4];
        for sample in 0..count {
            let along = (sample as f32 + 0.5) * (1.0 / count as f32) - 0.5;
            let texel = self.filtered(image, [at[0] + axis[0] * along, at[1] + axis[1] * along], lod);
            (0..4).for_each(|k| sum[k] += texel[k]);
        }
        let [r, g, b, a] = sum.map(|c| c * (1.0 / count as f32));
        match image.format() {
            TexelFormat::Encoded8 => [srgb_light(r), srgb_light(g), srgb_light(b), a],
            _ => [r, g, b, a],
        }
    }

    /// At a point, between levels.
    #[inline(always)]
    fn filtered(&self, image: &Image, at: [f32; 2], lod: f32) -> [f32; 4] {
        let (level, part) = match self.mipmaps {
            Mipmaps::Linear => (lod as u32, lod - (lod as u32) as f32),
            _ => ((lod + 0.5) as u32, 0.0),
        };
        let near = self.level(image, at, level);
        if part > 0.0 { blend(near, self.level(image, at, level + 1), part) } else { near }
    }

    /// At a point of a level.
    #[inline(always)]
    fn level(&self, image: &Image, at: [f32; 2], level: u32) -> [f32; 4] {
        let [width, height] = image.size(level);
        let (x, y) = (self.wrap[0].point(at[0]) * width as f32, self.wrap[1].point(at[1]) * height as f32);
        let rest = if self.linear { 0.5 } else { 0.0 };
        let (left, top) = ((x - rest).floor(), (y - rest).floor());
        let (i, j) = (left as i32, top as i32);
        let start = image.offset(level);
        let columns = [self.wrap[0].texel(i, width as i32), self.wrap[0].texel(i + 1, width as i32)];
        let row = |y: i32| self.wrap[1].texel(y, height as i32) as usize * width as usize;
        let (above, below) = (row(j), row(j + 1));
        let first = image.texel(start, above + columns[0] as usize);
        if !self.linear {
            return first;
        }
        let (x, y) = (x - rest - left, y - rest - top);
        let above = blend(first, image.texel(start, above + columns[1] as usize), x);
        let left = image.texel(start, below + columns[0] as usize);
        blend(above, blend(left, image.texel(start, below + columns[1] as usize), x), y)
    }
}

impl Wrap {
    /// A coordinate brought to where it has a period: 0 to 1, or to 2 for a mirror.
    #[inline(always)]
    fn point(self, at: f32) -> f32 {
        match self {
            Self::Repeat => between(at - at.floor(), 0.0, 1.0),
            Self::Mirror => between(at - 2.0 * (at * 0.5).floor(), 0.0, 2.0),
            Self::Clamp => between(at, 0.0, 1.0),
        }
    }

    /// The texel of a number up to one beyond its period.
    #[inline(always)]
    fn texel(self, at: i32, count: i32) -> i32 {
        match self {
            Self::Repeat if at < 0 => at + count,
            Self::Repeat if at >= count => at - count,
            Self::Mirror if at < 0 => -1 - at,
            Self::Mirror if at >= 2 * count => at - 2 * count,
            Self::Mirror if at >= count => 2 * count - 1 - at,
            Self::Clamp => at.clamp(0, count - 1),
            _ => at,
        }
    }
}

/// Between `low` and `high`; `low` for NaN.
#[inline(always)]
fn between(v: f32, low: f32, high: f32) -> f32 {
    let above = if v > low { v } else { low };
    if above < high { above } else { high }
}

/// The larger one.
#[inline(always)]
fn above(v: f32, low: f32) -> f32 {
    if v > low { v } else { low }
}

#[inline(always)]
fn blend(a: [f32; 4], b: [f32; 4], part: f32) -> [f32; 4] {
    std::array::from_fn(|k| a[k] + (b[k] - a[k]) * part)
}

/// The logarithm of a normal number, within 2.2e-5, the same on every device: the exponent, and a polynomial for the rest.
#[inline(always)]
fn log2(v: f32) -> f32 {
    let bits = v.to_bits();
    let exponent = (bits >> 23) as f32 - 127.0;
    let t = f32::from_bits(bits & 0x7f_ffff | 0x3f80_0000) - 1.0;
    let [cube, square, line, constant] = LOG2_BEND;
    let bend = ((cube * t + square) * t + line) * t + constant;
    exponent + (t + t * (1.0 - t) * bend)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::scene::image::Pixels;

    fn texture(values: &[f32], width: u32) -> Texture {
        let height = values.len() as u32 / width;
        Texture::new(Arc::new(Image::new(Pixels::Floats(values), width, height, 1, false).unwrap()))
    }

    #[test]
    fn logarithms() {
        for i in 0..10_000 {
            let v = (f64::from(i) / 300.0).exp2() as f32;
            assert!((f64::from(log2(v)) - f64::from(v).log2()).abs() < 2.5e-5, "{v}");
        }
    }

    #[test]
    fn the_ways_around_the_edges() {
        let values = [0.0, 1.0, 2.0, 3.0];
        let still = [[0.0; 2]; 2];
        let at = |wrap, s: f32| {
            let nearest = Texture { linear: false, wrap: [wrap; 2], ..texture(&values, 4) };
            nearest.sample(&nearest.image, &Place { at: [s, 0.5], change: still })[0]
        };
        for n in -9i32..9 {
            let s = (n as f32 + 0.5) / 4.0;
            assert_eq!(at(Wrap::Repeat, s), values[n.rem_euclid(4) as usize]);
            assert_eq!(at(Wrap::Clamp, s), values[n.clamp(0, 3) as usize]);
            let m = n.rem_euclid(8);
            assert_eq!(at(Wrap::Mirror, s), values[if m < 4 { m } else { 7 - m } as usize]);
        }
        let linear = Texture { wrap: [Wrap::Repeat; 2], ..texture(&values, 4) };
        assert_eq!(linear.sample(&linear.image, &Place { at: [0.25, 0.5], change: still })[0], 0.5);
        assert_eq!(linear.sample(&linear.image, &Place { at: [0.0, 0.5], change: still })[0], 1.5);
        for wild in [f32::NAN, f32::INFINITY, -1e30, 1e30] {
            let there =
                linear.sample(&linear.image, &Place { at: [wild, 0.3], change: [[wild, 0.0], [0.0, 1.0]] });
            assert!((0.0..=3.0).contains(&there[0]), "{wild}: {there:?}");
        }
    }

    #[test]
    fn levels_follow_the_footprint() {
        // A ramp along x, constant along y, so that levels tell themselves from their neighbours by steps.
        let values: Vec<f32> = (0..64 * 64).map(|i| if (i % 64) / 32 == 0 { 0.0 } else { 1.0 }).collect();
        let step = texture(&values, 64);
        let near = |change| step.sample(&step.image, &Place { at: [0.5 - 1.0 / 64.0, 0.5], change })[0];
        // One texel a pixel: a texel from the step nothing is to be seen of it. Sixteen: nearly half.
        let square = |texels: f32| [[texels / 64.0, 0.0], [0.0, texels / 64.0]];
        assert_eq!(near(square(1.0)), 0.0);
        assert!((near(square(16.0)) - 0.4375).abs() < 1e-3, "{}", near(square(16.0)));
        // Long along y alone: all detail along x stays.
        let tall = [[1.0 / 64.0, 0.0], [0.0, 8.0 / 64.0]];
        assert_eq!(near(tall), 0.0);
        // More than the samples reach.
        let taller = [[1.0 / 64.0, 0.0], [0.0, 64.0 / 64.0]];
        assert!(near(taller) > 0.1);
        assert_eq!(
            Texture { mipmaps: Mipmaps::Off, ..step.clone() }
                .sample(&step.image, &Place { at: [0.5 - 1.0 / 64.0, 0.5], change: square(16.0) })[0],
            0.0
        );
    }

    /// The level and the number of samples as the OpenGL extension EXT_texture_filter_anisotropic has them, in f64, of
    /// footprints no narrower than a texel; of narrower ones as many samples as reach from texel to texel.
    #[test]
    fn levels_are_those_of_the_extension() {
        let numbered = Arc::new(Image::of_numbered_levels(10));
        let side = f64::from(numbered.width());
        let mut seed = 1u64;
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 33) as f64 / f64::from(1u32 << 31)
        };
        for _ in 0..20_000 {
            let ways = [0, 1].map(|_| {
                let (angle, texels) = (random() * std::f64::consts::TAU, (random() * 14.0 - 3.0).exp2());
                [angle.cos() * texels / side, angle.sin() * texels / side].map(|d| d as f32)
            });
            let [a, b] = ways.map(|[x, y]| f64::from(x).hypot(f64::from(y)) * side);
            let (long, short) = (a.max(b), a.min(b));
            for most in [1, 2, 7, 16] {
                let count = (long / short.max(1.0)).ceil().clamp(1.0, f64::from(most));
                let expected = (long / count).max(short).log2().clamp(0.0, 9.0);
                let texture = Texture { anisotropy: most, ..Texture::new(Arc::clone(&numbered)) };
                let place = Place { at: [0.3, 0.6], change: ways };
                let found = f64::from(texture.sample(&numbered, &place)[0]);
                assert!((found - expected).abs() < 1e-4, "{long} x {short}, {most}: {found} for {expected}");
            }
        }
    }
}
