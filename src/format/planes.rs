//! Arrays of numbers as bytes, split into layers of four bits, from the lowest bits of every number to the highest
//! that any of them needs. The low layers are incompressible noise and stay as they are. The other layers are
//! compressed together by zstd, so that bits of one kind share a table of the entropy coder.

use zstd::bulk::{Compressor, Decompressor};
use zstd::zstd_safe::CParameter;

use crate::error::{Error, Result};

/// Level of zstd. The highest, 19, saves 1 % more (`benchmarks/rust/format.rs`).
pub const ZSTD_LEVEL: i32 = 12;
/// Shorter repetitions are mostly chance, and slower to follow than to decode.
const LEAST_MATCH: u32 = 7;
/// zstd has to save one byte in so many, else bytes are copied: decompressing takes ten times as long as a copy.
const LEAST_SHARE: usize = 8;
/// And so many of a frame, which has tables to be set up.
const LEAST_OF_FRAME: usize = 256;

/// How the bytes of a plane are written: the low bits of its length.
const RAW: u32 = 0;
/// One byte, repeated.
const CONSTANT: u32 = 1;
/// One zstd frame.
const ZSTD: u32 = 2;
/// Bits of the above.
const MODE_BITS: u32 = 2;
/// Bytes of a plane's length and mode.
const HEAD_BYTES: usize = 3;
/// Bits that a layer has of each number; those of two numbers are one byte.
const LAYER_BITS: u32 = 4;
/// Layers of a number at most.
const MAX_LAYERS: usize = (u32::BITS / LAYER_BITS) as usize;
/// The low bits of a byte.
const LOW: u8 = (1 << LAYER_BITS) - 1;

/// The bits of signed numbers so that small ones have few: 0, −1, 1, −2, …
pub fn zigzag(difference: u32) -> u32 {
    let signed = difference.cast_signed();
    (signed << 1 ^ signed >> 31).cast_unsigned()
}

/// The inverse of [`zigzag`].
pub fn unzigzag(code: u32) -> u32 {
    code >> 1 ^ (code & 1).wrapping_neg()
}

/// Numbers of four bits, two to a byte from the lower bits up.
fn pairs(values: &[u8]) -> Vec<u8> {
    values.chunks(2).map(|pair| pair.iter().rev().fold(0, |byte, v| byte << LAYER_BITS | v)).collect()
}

/// Appends arrays to bytes.
pub struct Writer {
    /// What was written.
    pub bytes: Vec<u8>,
    zstd: Option<Compressor<'static>>,
}

fn failed(error: std::io::Error) -> Error {
    Error::Invariant(format!("zstd: {error}"))
}

impl Writer {
    /// A writer of its own for each thread, with zstd at a level or without.
    pub fn new(level: Option<i32>) -> Result<Self> {
        let mut zstd = level.map(Compressor::new).transpose().map_err(failed)?;
        if let Some(zstd) = &mut zstd {
            zstd.set_parameter(CParameter::MinMatch(LEAST_MATCH)).map_err(failed)?;
        }
        Ok(Self { bytes: Vec::new(), zstd })
    }

    /// The frame of values, where it saves enough, and so many bytes besides.
    fn frame(&mut self, values: &[u8], least: usize) -> Result<Option<Vec<u8>>> {
        let Some(zstd) = &mut self.zstd else { return Ok(None) };
        let coded = zstd.compress(values).map_err(failed)?;
        Ok((coded.len() + values.len() / LEAST_SHARE + least < values.len()).then_some(coded))
    }

    /// One plane; nothing for no bytes.
    pub fn bytes(&mut self, values: &[u8]) -> Result<()> {
        let Some(first) = values.first() else { return Ok(()) };
        let coded;
        let (mode, data) = if values.iter().all(|v| v == first) {
            (CONSTANT, &values[..1])
        } else {
            coded = self.frame(values, LEAST_OF_FRAME)?;
            coded.as_ref().map_or((RAW, values), |coded| (ZSTD, coded))
        };
        let head = (data.len() as u32) << MODE_BITS | mode;
        self.bytes.extend_from_slice(&head.to_le_bytes()[..HEAD_BYTES]);
        self.bytes.extend_from_slice(data);
        Ok(())
    }

    /// Rows of so many numbers, row by row: the number of layers, how many of the lowest are not coded, those, and one
    /// plane of all others.
    pub fn rows<const N: usize>(&mut self, rows: impl Iterator<Item = [u32; N]> + Clone) -> Result<()> {
        let Some(all) = rows.clone().flatten().reduce(|a, b| a | b) else { return Ok(()) };
        let layer = |l: u32| {
            let bits = rows.clone().flatten().map(|v| (v >> (LAYER_BITS * l)) as u8 & LOW);
            pairs(&bits.collect::<Vec<_>>())
        };
        let layers: Vec<Vec<u8>> =
            (0..(u32::BITS - all.leading_zeros()).div_ceil(LAYER_BITS)).map(layer).collect();
        let mut raw = 0;
        while raw < layers.len() && self.frame(&layers[raw], 0)?.is_none() {
            raw += 1;
        }
        self.bytes.extend([layers.len() as u8, raw as u8]);
        self.bytes.extend(layers[..raw].iter().flatten());
        self.bytes(&layers[raw..].concat())
    }

    /// Numbers of four bits, as one plane.
    pub fn symbols(&mut self, values: &[u8]) -> Result<()> {
        self.bytes(&pairs(values))
    }

    /// Numbers in a row as rows of one.
    pub fn words(&mut self, values: &[u32]) -> Result<()> {
        self.rows(values.iter().map(|v| [*v]))
    }
}

/// What is wrong with coded bytes.
pub type Fault = &'static str;
/// What reading coded bytes gives.
pub type Read<T> = std::result::Result<T, Fault>;

/// What taking arrays needs, used again from page to page.
pub struct Tools {
    zstd: Decompressor<'static>,
    /// What two numbers are a byte of.
    packed: Vec<u8>,
}

impl Tools {
    /// Those of one thread.
    pub fn new() -> Result<Self> {
        Ok(Self { zstd: Decompressor::new().map_err(failed)?, packed: Vec::new() })
    }
}

/// Takes arrays from bytes. What they are long is known to the caller, so that no number in the bytes decides what is
/// allocated.
pub struct Reader<'a> {
    bytes: &'a [u8],
    tools: &'a mut Tools,
}

impl<'a> Reader<'a> {
    /// A reader of `bytes`.
    pub fn new(bytes: &'a [u8], tools: &'a mut Tools) -> Self {
        Self { bytes, tools }
    }

    /// What is left.
    pub fn rest(&self) -> &'a [u8] {
        self.bytes
    }

    fn take(&mut self, count: usize) -> Read<&'a [u8]> {
        let (head, rest) = self.bytes.split_at_checked(count).ok_or("the coded bytes end too early")?;
        self.bytes = rest;
        Ok(head)
    }

    /// A plane, as long as `out` is.
    pub fn bytes(&mut self, out: &mut [u8]) -> Read<()> {
        if out.is_empty() {
            return Ok(());
        }
        let head = self.take(HEAD_BYTES)?;
        let head = u32::from_le_bytes([head[0], head[1], head[2], 0]);
        let data = self.take((head >> MODE_BITS) as usize)?;
        match head & ((1 << MODE_BITS) - 1) {
            RAW if data.len() == out.len() => out.copy_from_slice(data),
            CONSTANT if data.len() == 1 => out.fill(data[0]),
            ZSTD => {
                let written = self
                    .tools
                    .zstd
                    .decompress_to_buffer(data, out)
                    .map_err(|_| "a plane is no zstd frame")?;
                if written != out.len() {
                    return Err("a plane has another length than it should");
                }
            }
            _ => return Err("a plane of an unknown kind or length"),
        }
        Ok(())
    }

    /// So many numbers as bytes: all first bytes, all second ones, and so on at the start of `out`, which grows where it
    /// has to and ends with [`SLACK`] more bytes; how many bytes a number has.
    pub fn planes(&mut self, count: usize, out: &mut Vec<u8>) -> Read<usize> {
        if count == 0 {
            return Ok(0);
        }
        let head = self.take(2)?;
        let (layers, raw) = (usize::from(head[0]), usize::from(head[1]));
        if layers > MAX_LAYERS || raw > layers {
            return Err("a number has more than 32 bits");
        }
        let (width, length) = (layers.div_ceil(2), count.div_ceil(2));
        grow(out, width * count + SLACK);
        let raw = self.take(raw * length)?;
        let mut packed = std::mem::take(&mut self.tools.packed);
        // And one of zeros, for an odd number of them.
        grow(&mut packed, (layers + 1) * length);
        let (own, zeros) = packed[..(layers + 1) * length].split_at_mut(layers * length);
        own[..raw.len()].copy_from_slice(raw);
        self.bytes(&mut own[raw.len()..])?;
        zeros.fill(0);
        for (p, both) in packed.chunks_exact(2 * length).take(width).enumerate() {
            let (low, high) = both.split_at(length);
            // One too many where the count is odd: the next plane begins there, or what may be anything.
            let pairs = out[p * count..][..2 * length].chunks_exact_mut(2);
            for ((pair, low), high) in pairs.zip(low).zip(high) {
                pair[0] = low & LOW | high << LAYER_BITS;
                pair[1] = low >> LAYER_BITS | high & !LOW;
            }
        }
        self.tools.packed = packed;
        Ok(width)
    }

    /// So many numbers of four bits, at the start of `out`.
    pub fn symbols(&mut self, count: usize, out: &mut Vec<u8>) -> Read<()> {
        let length = count.div_ceil(2);
        grow(out, 2 * length);
        let mut packed = std::mem::take(&mut self.tools.packed);
        grow(&mut packed, length);
        self.bytes(&mut packed[..length])?;
        for (pair, both) in out.chunks_exact_mut(2).zip(&packed[..length]) {
            [pair[0], pair[1]] = [both & LOW, both >> LAYER_BITS];
        }
        self.tools.packed = packed;
        Ok(())
    }

    /// As many numbers as `out` is long.
    pub fn words(&mut self, bytes: &mut Vec<u8>, out: &mut [u32]) -> Read<()> {
        let width = self.planes(out.len(), bytes)?;
        out.fill(0);
        for (p, plane) in bytes.chunks_exact(out.len().max(1)).take(width).enumerate() {
            out.iter_mut().zip(plane).for_each(|(word, byte)| *word |= u32::from(*byte) << (8 * p));
        }
        Ok(())
    }
}

/// Bytes behind planes that may be read with them.
pub const SLACK: usize = 4;

/// Makes a buffer long enough; what it held before stays, whatever it is.
pub fn grow(buffer: &mut Vec<u8>, length: usize) {
    if buffer.len() < length {
        buffer.resize(length, 0);
    }
}
