//! Virtualized geometry: a mesh of any size becomes a cluster LOD DAG from which any view, any error or any
//! triangle budget is a cheap, watertight cut, and a renderer whose cost follows the pixels.
//!
//! The map of the modules, their dependencies and the data flow is in `ARCHITECTURE.md`.

pub mod build;
pub mod config;
pub mod cpu;
pub mod decimate;
pub mod displace;
pub mod error;
pub mod external;
pub mod finish;
pub mod format;
#[cfg(all(feature = "gpu", not(feature = "internals")))]
mod gpu;
#[cfg(all(feature = "gpu", feature = "internals"))]
pub mod gpu;
pub mod gpu_types;
pub mod layout;
pub mod limits;
pub mod lod;
pub mod math;
pub mod measure;
pub mod mesh;
pub mod model;
pub mod processor;
#[cfg(feature = "python")]
mod python;
pub mod read;
pub mod render;
pub mod scene;
pub mod shadow;
pub mod stages;
pub mod stream;
pub mod threads;
pub mod tile;
pub mod views;

pub use error::{Error, Result};
