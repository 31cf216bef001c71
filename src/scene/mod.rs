//! What is drawn: instances of meshes with poses and materials, lights, cameras. Plain host data in f64;
//! nothing here knows how it is drawn.
//!
//! Conventions are OpenGL's and pyrender's: right-handed world, poses are object-to-world or camera-to-world
//! 4×4 matrices, a camera looks along its −Z with +Y up, a directional light shines along its −Z.

pub mod albedo;
pub mod assemblies;
pub mod camera;
pub mod environment;
pub mod image;
pub mod instances;
pub mod light;
pub mod lighting;
pub mod material;
pub mod palette;
pub mod placement;
pub mod pose;
pub mod prefilter;
pub mod samples;
mod slots;
pub mod texture;
pub mod transfer;

pub use assemblies::{Assembly, Dressed, Owners, Part, PartShape, Place};
pub use camera::{Camera, Projection, View};
pub use environment::{Environment, EnvironmentMap, Surroundings};
pub use image::Image;
pub use instances::{Instance, InstanceHandle, LightHandle, Scene};
pub use light::{Light, LightKind};
pub use lighting::{Falloff, Lighting, ShadeLight};
pub use material::{Material, Materials, Slot};
pub use slots::Handle;
pub use texture::Texture;
