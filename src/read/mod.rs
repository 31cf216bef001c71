//! Files of other programs, read by their grammars: bytes in, plain arrays out. What they mean, which property is a
//! colour and which file a texture, is decided in Python (`python/nanite_rs/_ply.py` and its neighbours).
//!
//! Definitions: PLY by Greg Turk's "The PLY Polygon File Format" with the type names and element kinds in use since;
//! STL by 3D Systems; OBJ by appendix B1 of Wavefront's Advanced Visualizer manual; OFF by Geomview's manual.
//!
//! No reader trusts a count: memory is asked for by what the file holds, never by what it promises.

pub mod obj;
pub mod off;
pub mod ply;
pub mod polygon;
pub mod stl;
mod text;

#[cfg(test)]
mod damage;

pub use text::name;

use crate::error::Error;

/// An error at a line, element or byte of a file.
fn fault(place: impl Into<String>, message: impl Into<String>) -> Error {
    Error::Source { place: place.into(), message: message.into() }
}
