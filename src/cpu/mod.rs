//! The CPU twin of every rendering stage: plain slices in and out, rayon inside.
//!
//! The order of the stages is in [`crate::stages`]. What several stages share: [`crate::views`] (an instance as seen
//! from a view), [`visibility`] (where rasterizers write), [`clip`] and [`triangle`]
//! (snapping and coverage), [`surface`] (from pixels back to surface points) on [`lanes`].

pub mod blend;
pub mod clip;
pub mod cluster_cull;
pub mod environment;
pub mod hzb;
pub mod instance_cull;
pub mod lanes;
pub mod material;
pub mod node_cull;
pub mod output;
pub mod peel;
pub mod raster_large;
pub mod raster_small;
pub mod shade;
pub mod shadow_cascades;
pub mod shadow_mark;
pub mod shadow_mask;
pub mod shadow_pages;
pub mod shadow_raster;
pub mod shadow_soft;
pub mod shadow_test;
pub mod stroke;
pub mod surface;
pub mod texture;
pub mod triangle;
pub mod visibility;
