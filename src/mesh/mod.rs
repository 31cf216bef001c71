//! From the caller's arrays to a clean indexed mesh: validation, framing, welding, mending, normals.

pub mod attributes;
pub mod edges;
pub mod frame;
pub mod hash;
pub mod source;
pub mod validate;
pub mod weld;

pub use source::{Positions, SourceMesh};
pub use weld::{WeldedMesh, weld};
