//! Geometry without meshes: spheres, boxes, halving, packing of directions, projection of errors.

pub mod aabb;
pub mod affine;
pub mod bounds;
pub mod double_single;
pub mod median;
pub mod morton;
pub mod octahedral;
pub mod project;
pub mod sphere;
pub mod triangle;

pub use aabb::Aabb;
pub use bounds::{Ball, Bounds};
pub use double_single::DoubleSingle;
pub use project::{LodView, singular_value_bound};
pub use sphere::Sphere;
