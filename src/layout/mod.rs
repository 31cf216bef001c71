//! Where groups lie: their order, their pages, the hierarchy over them, and the names of
//! their vertices. Building lays a mesh out, and so does rounding,
//! which leaves pages room for more.

mod hierarchy;
mod names;
mod order;
mod pages;

pub use hierarchy::hierarchy;
pub use names::{by_first_use, renamed_rows};
pub use order::spatial_order;
pub use pages::{GroupSize, Paging, paginate};
