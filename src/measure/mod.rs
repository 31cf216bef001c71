//! Distances between surfaces.

pub mod deviation;
pub mod tree;
pub mod triangle;

pub use deviation::deviation;
pub use tree::TriangleTree;
