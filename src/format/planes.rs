//! Arrays of numbers as bytes: split into planes, from the lowest byte of every number to the highest that any of them
//! needs, and each plane coded by itself, so that bytes of one kind meet one table of the entropy coder.

use zstd::bulk::{Compressor, Decompressor};

use crate::error::{Error, Result};

/// Level of zstd. The highest, 19, saves 2 % more (`benchmarks/rust/format.rs`).
pub const ZSTD_LEVEL: i32 = 9;

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

/// The bits of signed numbers so that small ones have few: 0, −1, 1, −2, …
pub fn zigzag(difference: u32) -> u32 {
    let signed = difference.cast_signed();
    (signed << 1 ^ signed >> 31).cast_unsigned()
}

/// The inverse of [`zigzag`].
pub fn unzigzag(code: u32) -> u32 {
    code >> 1 ^ (code & 1).wrapping_neg()
}

/// Appends arrays to bytes.
pub struct Writer {
    /// What was written.
    pub bytes: Vec<u8>,
    zstd: Option<Compressor<'static>>,
    plane: Vec<u8>,
}

fn failed(error: std::io::Error) -> Error {
    Error::Invariant(format!("zstd: {error}"))
}

impl Writer {
    /// A writer of its own for each thread, with zstd at a level or without.
    pub fn new(level: Option<i32>) -> Result<Self> {
        let zstd = level.map(Compressor::new).transpose().map_err(failed)?;
        Ok(Self { bytes: Vec::new(), zstd, plane: Vec::new() })
    }

    /// One plane; nothing for no bytes.
    pub fn bytes(&mut self, values: &[u8]) -> Result<()> {
        let Some(first) = values.first() else { return Ok(()) };
        let coded;
        let (mode, data) = if values.iter().all(|v| v == first) {
            (CONSTANT, &values[..1])
        } else if let Some(zstd) = &mut self.zstd {
            coded = zstd.compress(values).map_err(failed)?;
            if coded.len() < values.len() { (ZSTD, &coded[..]) } else { (RAW, values) }
        } else {
            (RAW, values)
        };
        let head = (data.len() as u32) << MODE_BITS | mode;
        self.bytes.extend_from_slice(&head.to_le_bytes()[..HEAD_BYTES]);
        self.bytes.extend_from_slice(data);
        Ok(())
    }

    /// The number of planes, then the planes.
    pub fn words(&mut self, values: &[u32]) -> Result<()> {
        let Some(all) = values.iter().copied().reduce(|a, b| a | b) else { return Ok(()) };
        let planes = (u32::BITS - all.leading_zeros()).div_ceil(8);
        self.bytes.push(planes as u8);
        let mut plane = std::mem::take(&mut self.plane);
        for p in 0..planes {
            plane.clear();
            plane.extend(values.iter().map(|v| (v >> (8 * p)) as u8));
            self.bytes(&plane)?;
        }
        self.plane = plane;
        Ok(())
    }
}

/// What is wrong with coded bytes.
pub type Fault = &'static str;
/// What reading coded bytes gives.
pub type Read<T> = std::result::Result<T, Fault>;

/// Takes arrays from bytes. What they are long is known to the caller, so that no number in the bytes decides what is
/// allocated.
pub struct Reader<'a> {
    bytes: &'a [u8],
    zstd: &'a mut Decompressor<'static>,
}

impl<'a> Reader<'a> {
    /// A reader of `bytes`.
    pub fn new(bytes: &'a [u8], zstd: &'a mut Decompressor<'static>) -> Self {
        Self { bytes, zstd }
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

    /// A plane of so many bytes.
    pub fn bytes(&mut self, count: usize, out: &mut Vec<u8>) -> Read<()> {
        out.clear();
        if count == 0 {
            return Ok(());
        }
        let head = self.take(HEAD_BYTES)?;
        let head = u32::from_le_bytes([head[0], head[1], head[2], 0]);
        let data = self.take((head >> MODE_BITS) as usize)?;
        match head & ((1 << MODE_BITS) - 1) {
            RAW if data.len() == count => out.extend_from_slice(data),
            CONSTANT if data.len() == 1 => out.resize(count, data[0]),
            ZSTD => {
                out.reserve(count);
                let written =
                    self.zstd.decompress_to_buffer(data, out).map_err(|_| "a plane is no zstd frame")?;
                if written != count {
                    return Err("a plane has another length than it should");
                }
            }
            _ => return Err("a plane of an unknown kind or length"),
        }
        Ok(())
    }

    /// So many numbers.
    pub fn words(&mut self, count: usize, plane: &mut Vec<u8>, out: &mut Vec<u32>) -> Read<()> {
        out.clear();
        if count == 0 {
            return Ok(());
        }
        out.resize(count, 0);
        let planes = self.take(1)?[0];
        if planes > 4 {
            return Err("a number has more than four bytes");
        }
        for p in 0..u32::from(planes) {
            self.bytes(count, plane)?;
            out.iter_mut().zip(&*plane).for_each(|(word, byte)| *word |= u32::from(*byte) << (8 * p));
        }
        Ok(())
    }
}
