//! Cuts: for an error, a triangle budget or a view. Walking the hierarchy, so that cost follows the cut.

pub mod extract;
pub mod select;

pub use extract::{CutArrays, channel_rows, extract, extract_numbered};
pub use select::{
    Beside, FaceBudget, attribute_error_with, cut_attribute_error, cut_error, error_with, load, select,
};
