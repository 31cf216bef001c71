//! Distances between surfaces.

pub mod bvh;
pub mod closest;
mod cover;
pub mod distance;
pub mod hausdorff;
pub mod overlay;
pub mod piece;
pub mod tree;
pub mod triangle;

pub use bvh::Bvh;
pub use distance::{DistanceOptions, MeshView, closest_points, surface_distance};
pub use hausdorff::{BoundOptions, Surface, SurfaceBound, hausdorff_upper, outwards};
pub use tree::TriangleTree;
