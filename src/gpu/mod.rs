//! The GPU backend: the stages of [`crate::stages`] on a device of wgpu.
//!
//! Stage `x` is `src/gpu/x.rs`, which records it, and `shaders/x.wgsl`, which is the twin of `src/cpu/x.rs`. A frame is one
//! submission: every stage decides the indirect arguments of the next on the device. The host reads back the visible cluster
//! list and the counts of every list. Where a list was too short, it grows and the frame runs again. The visibility buffer is
//! read with them where the CPU makes something of it now, else when it first does. Shadows take two submissions more: the
//! host decides in between which pages of shadow maps are kept.
//!
//! [`context`] finds a device. [`meshes`] holds what is uploaded once, with its pages in `page_arrays`. `kernel` says what a
//! kernel is, each stage declares its own, [`kernels`] lists them, and [`shaders`] puts sources together. `request` is what a
//! caller asks and gets, `view_history` what a view keeps between frames, `passes` and `recorder` record the stages.
//! `raster_hardware` is another form of the two raster stages; `calibrate` measures whether it is faster. `shadow_pool` has
//! the pages of shadow maps, `shadow_table` where views find them. Files import each other in one direction, which a test
//! holds.

// What only tests and benchmarks reach is unused, and private, without them.
#![cfg_attr(not(feature = "internals"), allow(dead_code, unused_imports))]

mod bind_groups;
mod buffers;
mod calibrate;
mod cluster_cull;
pub mod context;
mod hzb;
mod instance_cull;
mod instances;
mod kernel;
pub mod kernels;
mod lights;
mod lists;
mod materials;
pub mod meshes;
mod node_cull;
mod occlusion;
mod output;
mod page_arrays;
mod passes;
mod pyramids;
mod raster;
mod raster_hardware;
mod raster_large;
mod raster_small;
mod recorder;
pub mod renderer;
mod request;
mod shade;
pub mod shaders;
mod shadow_mark;
mod shadow_pool;
mod shadow_raster;
pub mod shadow_table;
mod shadow_test;
mod surface;
mod times;
mod view_history;
mod write_runs;

pub use buffers::DeviceVisibility;
pub use context::Context;
pub use instances::SceneInstance;
pub use kernel::CullPass;
pub use renderer::DeviceRenderer;
pub use request::{Counted, Drawn, ViewRequest, Ways};
pub use shadow_mark::Column;
pub use shadow_pool::DevicePage;
pub use shadow_raster::{ShadowBlock, ShadowsDrawn};
// For benchmarks, which run kernels of their own on the same device.
#[cfg(feature = "internals")]
pub use wgpu;
