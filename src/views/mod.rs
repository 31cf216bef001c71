//! Views: what is asked for, and what both backends share about it: the constants of a view, instances as seen from it,
//! footprints, and how a pixel of a visibility buffer is read.

pub mod desc;
pub mod footprint;
pub mod histories;
pub mod instance_view;
pub mod screen;
pub mod stroke;
pub mod visibility;

pub use desc::{ViewDesc, ViewKind};
pub use footprint::{Footprint, Occluder};
pub use histories::Histories;
pub use instance_view::{ClusterBounds, InstanceView, mesh_bounds};
pub use screen::{Screen, homogeneous};
pub use stroke::Stroke;
pub use visibility::{Hit, Visible, decode, payload};
