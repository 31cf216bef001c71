//! The `.nanite` file. Callers see whole meshes; sections, checksums and coded pages stay behind this module.
//! `docs/format.md` specifies it for other readers.
//!
//! | bytes | what |
//! |---|---|
//! | 0..8 | magic |
//! | 8..12 | version |
//! | 12..16 | number of sections |
//! | 16..20 | CRC-32 of the section table |
//! | 20..24 | CRC-32 of bytes 0..20 |
//! | 24.. | section table: 32 bytes each: kind, CRC-32, offset, length, zero |
//! | … | sections, each on a 64-byte boundary; coded pages come last |
//!
//! All numbers are little-endian. Section kinds: see [`file::Kind`].

pub mod columns;
pub mod decode;
pub mod encode;
pub mod file;
pub mod info;
pub mod input;
pub mod page;
pub mod page_decode;
pub mod page_encode;
pub mod planes;
pub mod quantize;
pub mod stored;
pub mod topology;
pub mod validate;

pub use decode::{FIRST_READ, from_bytes};
pub use encode::to_bytes;
pub use file::{save, save_by_way_of};
pub use info::{FileInfo, file_info, input_info};
pub use quantize::{FINE_PART, Precision, quantize};
pub use stored::{Stored, open, open_input};
