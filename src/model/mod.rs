//! The cluster DAG as plain data: what building writes, and what cutting, culling, raster and files read.
//!
//! Nothing here computes anything beyond addressing; the one exception is [`rule`], the rule of the cut.

pub mod channel;
pub mod cluster;
pub mod colors;
pub mod dag;
mod geometry;
pub mod hierarchy;
pub mod loader;
pub mod materials;
pub mod packing;
pub mod page;
pub mod pose;
mod primitive;
pub mod reading;
pub mod report;
pub mod retry;
pub mod rule;
pub mod sink;
pub mod skin;
pub mod source;
pub mod waves;
pub mod window;
pub mod words;
pub mod workers;

pub use channel::{Channel, ChannelInfo, ChannelType};
pub use cluster::{AttributeLayout, ClusterAddress, ClusterGeometry, ClusterRecord};
pub use colors::ColorFormat;
pub use dag::{CoordinateFrame, Dag, Grid, Group};
pub use geometry::GeometryId;
pub use hierarchy::Node;
pub use loader::{Arrival, LoadRequest, Loader};
pub use materials::{Blob, Materials};
pub use packing::Packing;
pub use page::{PageEntry, PageWords, Pages};
pub use pose::{Motion, Pose};
pub use primitive::{Primitive, StrokeSize};
pub use reading::{INTERRUPT_INTERVAL, InterruptCheck, UNINTERRUPTED, read_pages};
pub use report::{BuildReport, LevelReport, RebakedPart, StuckGroup, StuckReason, Weights};
pub use retry::{Clock, Retry};
pub use sink::{MemorySink, Outline, PageSink, dependencies};
pub use skin::Skin;
pub use source::{Answer, Cancelled, PageRequest, PageSource, Traffic, TrafficCounter};
pub use waves::{Wave, Waves};
pub use window::{WINDOW_PAGES, Window};
pub use words::Words;
pub use workers::Workers;
