//! The layout of groups: their order, their pages, the hierarchy over them, and the numbers of their vertices.
//! Building lays a mesh out. Quantizing does so again, since pages then hold more.

mod hierarchy;
mod names;
mod order;
mod pages;

pub use hierarchy::hierarchy;
pub use names::{FirstUse, renamed_rows};
pub use order::spatial_order;
pub use pages::{GroupSize, Paging, paginate};
