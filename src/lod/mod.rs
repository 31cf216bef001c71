//! Cuts: for an error, a triangle budget or a view. Walking the hierarchy, so that cost follows the cut.

pub mod extract;
pub mod select;

pub use extract::{CutArrays, extract};
pub use select::{FaceBudget, cut_error, select};
