//! The renderer: a list of stages, the facade that runs them, and the frame that they leave.

mod assemblies;
#[cfg(feature = "gpu")]
mod bisect;
#[cfg(feature = "gpu")]
mod device;
#[cfg(feature = "gpu")]
mod device_shadows;
pub mod frame;
mod frame_shadows;
mod history;
mod layers;
mod motion;
mod pass;
mod queue;
pub mod renderer;
#[cfg(feature = "gpu")]
mod shadow_records;
mod shadows;
pub mod stats;
mod streaming;
#[cfg(feature = "gpu")]
mod undrawn;
mod visibility_buffer;

pub use crate::stages::Stage;
pub use crate::views::{ViewDesc, ViewKind};
#[cfg(feature = "gpu")]
pub use device::{instance_transform, view_record};
pub use frame::{Frame, ImageView};
pub use renderer::{Backend, Renderer};
#[cfg(feature = "gpu")]
pub use shadow_records::shadow_map_entries;
pub use stats::{AssemblyStats, FrameStats, ShadowStats, StageStats};
