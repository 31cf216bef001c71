//! From the caller's arrays to a clean indexed mesh: validation, framing, welding, mending, normals.

pub mod attributes;
pub mod channels;
pub mod creases;
pub mod edges;
pub mod frame;
pub mod hash;
pub mod materials;
pub mod sides;
pub mod skin;
pub mod source;
pub mod stars;
pub mod validate;
pub mod weld;

pub use channels::Channels;
pub use source::{Colors, Positions, SourceChannel, SourceMesh};
pub use stars::Stars;
pub use weld::{WeldedMesh, weld, weld_in};
