//! Geometry without meshes: spheres, boxes, halving, packing of directions, projection of errors.

pub mod aabb;
pub mod bounds;
pub mod median;
pub mod morton;
pub mod octahedral;
pub mod pair;
pub mod project;
pub mod sphere;
pub mod triangle;

pub use aabb::Aabb;
pub use bounds::{Ball, Bounds};
pub use pair::Pair;
pub use project::{LodView, singular_value_bound};
pub use sphere::Sphere;
