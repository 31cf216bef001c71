//! Pictures that textures show, with smaller versions of them for the distance, all made in linear light.

use std::sync::{Arc, OnceLock};

use half::f16;
use rayon::prelude::*;

use crate::config::Transfer;
use crate::error::{Error, Result};
use crate::threads::once;

/// Longest side of an image, pixels.
pub const MAX_IMAGE_SIDE: u32 = 1 << 15;

/// How a texel lies in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TexelFormat {
    /// A word: red lowest, then green, blue and alpha, each in 255ths.
    Linear8,
    /// The same where colours, but not alpha, are sRGB.
    Srgb8,
    /// Two words of two halves, linear.
    Half,
    /// As [`TexelFormat::Srgb8`], but filtered as it is, and decoded then.
    Encoded8,
}

impl TexelFormat {
    /// Words of a texel.
    pub fn words(self) -> usize {
        if self == Self::Half { 2 } else { 1 }
    }
}

/// What an image is made of, rows from the top, one to four channels: grey, grey and alpha, RGB, RGBA.
#[derive(Clone, Copy, Debug)]
pub enum Pixels<'a> {
    /// 255ths.
    Bytes(&'a [u8]),
    /// 65,535ths.
    Words(&'a [u16]),
    /// As they are.
    Floats(&'a [f32]),
}

/// An image with all its levels, each half as wide and high as the one before, rounded down, to a single texel.
#[derive(Debug)]
pub struct Image {
    width: u32,
    height: u32,
    format: TexelFormat,
    /// Where each level starts in `words`.
    starts: Vec<usize>,
    opaque: bool,
    words: Vec<u32>,
    encoded: OnceLock<Arc<Self>>,
}

type Texel = [f32; 4];

impl Image {
    /// An image and its levels. Of `srgb` ones, numbers that stand for colours are sRGB; floats are always linear.
    pub fn new(pixels: Pixels<'_>, width: u32, height: u32, channels: usize, srgb: bool) -> Result<Self> {
        let wrong = |message: String| Err(Error::argument("pixels", message));
        if width == 0 || height == 0 || width.max(height) > MAX_IMAGE_SIDE {
            return wrong(format!("sides must be 1 to {MAX_IMAGE_SIDE}, not {width} x {height}"));
        }
        let (count, found) = (width as usize * height as usize, pixels.len());
        if !(1..=4).contains(&channels) || found != count * channels {
            return wrong(format!("{found} numbers are no {width} x {height} pixels of {channels} channels"));
        }
        if let Pixels::Floats(values) = pixels
            && let Some(at) = values.iter().position(|v| !v.is_finite())
        {
            return wrong(format!("number {at} is {}", values[at]));
        }
        let format = match pixels {
            Pixels::Bytes(_) if srgb => TexelFormat::Srgb8,
            Pixels::Bytes(_) => TexelFormat::Linear8,
            _ => TexelFormat::Half,
        };
        let transfer = if srgb { Transfer::Srgb } else { Transfer::Linear };
        let opaque = !channels.is_multiple_of(2)
            || match pixels {
                Pixels::Bytes(values) => values.chunks(channels).all(|c| c[channels - 1] == u8::MAX),
                Pixels::Words(values) => values.chunks(channels).all(|c| c[channels - 1] == u16::MAX),
                Pixels::Floats(values) => values.chunks(channels).all(|c| c[channels - 1] >= 1.0),
            };
        let words = Vec::with_capacity(count * 3 / 2);
        let mut image =
            Self { width, height, format, starts: vec![0], opaque, words, encoded: OnceLock::new() };
        // Bytes stay what they are.
        match pixels {
            Pixels::Bytes(bytes) => image.words.par_extend((0..count).into_par_iter().map(|at| {
                let texel = expanded(channels, |c| bytes[at * channels + c], u8::MAX);
                u32::from_le_bytes(texel)
            })),
            Pixels::Words(words) => {
                let unit = |word: u16| f32::from(word) / 65535.0;
                let light = |word: u16| transfer.decode(f64::from(word) / 65535.0) as f32;
                image.words.par_extend((0..count).into_par_iter().flat_map_iter(|at| {
                    let [r, g, b, a] = expanded(channels, |c| words[at * channels + c], u16::MAX);
                    halves([light(r), light(g), light(b), unit(a)])
                }));
            }
            Pixels::Floats(floats) => {
                image.words.par_extend(
                    (0..count)
                        .into_par_iter()
                        .flat_map_iter(|at| halves(expanded(channels, |c| floats[at * channels + c], 1.0))),
                );
            }
        }
        image.add_levels();
        Ok(image)
    }

    /// As OpenGL has it where nobody tells it of sRGB: of [`TexelFormat::Srgb8`], what is filtered and averaged for levels are
    /// the numbers as they are encoded. Made when first asked for.
    pub fn encoded(self: &Arc<Self>) -> &Arc<Self> {
        if self.format != TexelFormat::Srgb8 {
            return self;
        }
        once(&self.encoded, || {
            let end = self.starts.get(1).copied().unwrap_or(self.words.len());
            let words = self.words[..end].to_vec();
            let Self { width, height, opaque, .. } = **self;
            let (format, encoded) = (TexelFormat::Encoded8, OnceLock::new());
            let mut image = Self { width, height, format, starts: vec![0], opaque, words, encoded };
            image.add_levels();
            Arc::new(image)
        })
    }

    /// A square of so many levels, of which each has its own number everywhere.
    #[cfg(test)]
    pub(crate) fn of_numbered_levels(levels: u32) -> Self {
        let side = 1 << (levels - 1);
        let mut image =
            Self::new(Pixels::Floats(&vec![0.0; side * side]), side as u32, side as u32, 1, false).unwrap();
        for level in 0..levels {
            let end = image.starts.get(level as usize + 1).copied().unwrap_or(image.words.len());
            let start = image.offset(level);
            for texel in image.words[start..end].chunks_exact_mut(2) {
                texel.copy_from_slice(&halves([level as f32, 0.0, 0.0, 1.0]));
            }
        }
        image
    }

    /// Width, texels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, texels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// How a texel lies in memory.
    pub fn format(&self) -> TexelFormat {
        self.format
    }

    /// How many levels there are.
    pub fn levels(&self) -> u32 {
        self.starts.len() as u32
    }

    /// Whether alpha is 1 everywhere.
    pub fn opaque(&self) -> bool {
        self.opaque
    }

    /// The texels of all levels, the whole image first, rows from the top.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// Columns and rows of a level.
    #[inline]
    pub fn size(&self, level: u32) -> [u32; 2] {
        [(self.width >> level).max(1), (self.height >> level).max(1)]
    }

    /// Where a level starts, words.
    #[inline]
    pub fn offset(&self, level: u32) -> usize {
        self.starts[level as usize]
    }

    /// A texel in linear light, unless it is decoded later.
    #[inline(always)]
    pub fn texel(&self, start: usize, at: usize) -> Texel {
        match self.format {
            TexelFormat::Linear8 | TexelFormat::Encoded8 => {
                self.words[start + at].to_le_bytes().map(|byte| f32::from(byte) * UNIT)
            }
            TexelFormat::Srgb8 => {
                let [r, g, b, a] = self.words[start + at].to_le_bytes();
                let table = srgb_table();
                let light = |byte: u8| table[usize::from(byte)];
                [light(r), light(g), light(b), f32::from(a) * UNIT]
            }
            TexelFormat::Half => {
                let [rg, ba] = [self.words[start + 2 * at], self.words[start + 2 * at + 1]];
                let half = |word: u32, shift: u32| f16::from_bits((word >> shift) as u16).to_f32();
                [half(rg, 0), half(rg, 16), half(ba, 0), half(ba, 16)]
            }
        }
    }

    /// Makes all levels after the first: means of what is under each texel, by how much of it is.
    fn add_levels(&mut self) {
        let mut size = [self.width, self.height];
        while size != [1, 1] {
            let next = size.map(|side| (side / 2).max(1));
            let taps = [Taps::new(size[0], next[0]), Taps::new(size[1], next[1])];
            let (image, start) = (&*self, self.offset(self.levels() - 1));
            let row = |y: u32| -> Vec<u32> {
                let means = (0..next[0]).map(|x| image.mean(start, size[0] as usize, &taps, [x, y]));
                means.flat_map(|mean| image.word_of(mean)).collect()
            };
            let words: Vec<Vec<u32>> = (0..next[1]).into_par_iter().map(row).collect();
            self.starts.push(self.words.len());
            self.words.extend(words.iter().flatten());
            size = next;
        }
    }

    /// The mean of what is under a texel of the next level, of a level so wide.
    fn mean(&self, start: usize, width: usize, [columns, rows]: &[Taps; 2], [x, y]: [u32; 2]) -> Texel {
        let mut mean = [0.0f32; 4];
        for (row, of_row) in rows.of(y) {
            for (column, of_column) in columns.of(x) {
                let texel = self.texel(start, row * width + column);
                (0..4).for_each(|k| mean[k] += texel[k] * (of_row * of_column));
            }
        }
        mean
    }

    fn word_of(&self, texel: Texel) -> impl Iterator<Item = u32> + use<> {
        let byte = |c: f32| (c * 255.0 + 0.5) as u8;
        let [r, g, b, a] = texel;
        let (words, count) = match self.format {
            TexelFormat::Linear8 | TexelFormat::Encoded8 => ([u32::from_le_bytes(texel.map(byte)), 0], 1),
            TexelFormat::Srgb8 => {
                let encoder = Transfer::Srgb.encoder();
                let [r, g, b] = [r, g, b].map(|c| encoder.encode(c));
                ([u32::from_le_bytes([r, g, b, byte(a)]), 0], 1)
            }
            TexelFormat::Half => (halves(texel), 2),
        };
        words.into_iter().take(count)
    }
}

impl Pixels<'_> {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Bytes(values) => values.len(),
            Self::Words(values) => values.len(),
            Self::Floats(values) => values.len(),
        }
    }
}

/// What a byte counts.
const UNIT: f32 = 1.0 / 255.0;

/// The light of bytes that are sRGB.
pub fn srgb_table() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    once(&TABLE, || std::array::from_fn(|byte| Transfer::Srgb.light(byte as u8)))
}

/// The light of a number that is sRGB, between those of two bytes.
pub fn srgb_light(v: f32) -> f32 {
    let at = v * 255.0;
    let byte = (at as usize).min(254);
    let [below, above] = [srgb_table()[byte], srgb_table()[byte + 1]];
    below + (above - below) * (at - byte as f32)
}

/// Four numbers of one to four channels.
fn expanded<T: Copy>(channels: usize, channel: impl Fn(usize) -> T, opaque: T) -> [T; 4] {
    let grey = channels < 3;
    let color = |k: usize| channel(if grey { 0 } else { k });
    let alpha = if channels.is_multiple_of(2) { channel(channels - 1) } else { opaque };
    [color(0), color(1), color(2), alpha]
}

/// Four numbers in halves, the largest for what is larger. Those so small that a half would lose bits are 0, as devices may
/// read them.
fn halves(texel: Texel) -> [u32; 2] {
    let [r, g, b, a] = texel.map(|v| {
        let v = f16::from_f32(v.clamp(f16::MIN.to_f32(), f16::MAX.to_f32()));
        u32::from(if v.is_normal() { v.to_bits() } else { 0 })
    });
    [r | g << 16, b | a << 16]
}

/// Along one side: which texels are under each of another size, and how much of it each is.
pub(super) struct Taps {
    from: u32,
    to: u32,
}

impl Taps {
    pub(super) fn new(from: u32, to: u32) -> Self {
        Self { from, to }
    }

    /// Texels under texel `at`, and their parts, which sum to 1.
    pub(super) fn of(&self, at: u32) -> impl Iterator<Item = (usize, f32)> + Clone + use<> {
        let Self { from, to } = *self;
        // In units of 1/to of a texel.
        let (low, high) = (at * from, (at + 1) * from);
        (low / to..high.div_ceil(to)).map(move |texel| {
            let covered = high.min((texel + 1) * to) - low.max(texel * to);
            (texel as usize, covered as f32 / from as f32)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_keep_the_mean_of_the_light() {
        for (width, height) in [(8, 8), (7, 5), (1, 9), (13, 1), (1, 1)] {
            let count = (width * height) as usize;
            let pixels: Vec<f32> = (0..count).map(|i| ((i * 37) % 11) as f32 / 7.0).collect();
            let image = Image::new(Pixels::Floats(&pixels), width, height, 1, false).unwrap();
            let last = image.levels() - 1;
            assert_eq!(image.size(last), [1, 1]);
            assert_eq!(image.words().len(), image.offset(last) + 2);
            let mean = pixels.iter().sum::<f32>() / count as f32;
            let [r, g, b, a] = image.texel(image.offset(last), 0);
            assert!((r - mean).abs() < 4e-3 * mean.max(0.1), "{width} x {height}: {r} for {mean}");
            assert_eq!((g, b, a), (r, r, 1.0));
        }
    }

    #[test]
    fn colours_are_averaged_as_light() {
        // Black and white in sRGB: half the light is 188, not 128.
        let image = Image::new(Pixels::Bytes(&[0, 255]), 2, 1, 1, true).unwrap();
        assert_eq!(image.words()[2].to_le_bytes(), [188, 188, 188, 255]);
        let image = Image::new(Pixels::Bytes(&[0, 255]), 2, 1, 1, false).unwrap();
        assert_eq!(image.words()[2].to_le_bytes(), [128, 128, 128, 255]);
        let image = Image::new(Pixels::Bytes(&[10, 0, 10, 255]), 2, 1, 2, true).unwrap();
        assert_eq!(image.words()[2].to_le_bytes(), [10, 10, 10, 128]);
    }

    #[test]
    fn what_is_no_image_is_refused() {
        let floats = [1.0, f32::NAN];
        assert!(Image::new(Pixels::Floats(&floats), 2, 1, 1, false).is_err());
        assert!(Image::new(Pixels::Bytes(&[]), 0, 3, 1, false).is_err());
        assert!(Image::new(Pixels::Bytes(&[0; 5]), 2, 1, 3, false).is_err());
        let large = Image::new(Pixels::Floats(&[1e9, -1e9, 1e-9]), 1, 1, 3, false).unwrap();
        assert_eq!(large.texel(0, 0), [65504.0, -65504.0, 0.0, 1.0]);
    }
}
