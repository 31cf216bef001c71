//! The `.nanite` file. Callers see whole meshes; sections, checksums and later pages stay behind this module.
//!
//! | bytes | what |
//! |---|---|
//! | 0..8 | magic |
//! | 8..12 | version |
//! | 12..16 | number of sections |
//! | 16..20 | CRC-32 of the section table |
//! | 20..24 | CRC-32 of bytes 0..20 |
//! | 24.. | section table: 32 bytes each: kind, CRC-32, offset, length, zero |
//! | … | sections, each on a 64-byte boundary |
//!
//! All numbers are little-endian. Section kinds: see [`file::Kind`].

pub mod decode;
pub mod encode;
pub mod file;
pub mod validate;

pub use decode::from_bytes;
pub use encode::to_bytes;
pub use file::{open, save};
