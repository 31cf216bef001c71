//! Virtual shadow maps: what both backends share about them. A light has one map or six, each a projection fixed to the
//! light and not to the camera; a map has levels of texels, and a level pages, which are drawn where a view needs them and
//! kept. docs/shadows.md derives how far a receiver is moved before it looks one up.
//!
//! Fernando et al., "Adaptive Shadow Maps", SIGGRAPH 2001; Lefohn, Sengupta and Owens, "Resolution-matched shadow maps",
//! ACM TOG 26(4), 2007. Pages of 128 × 128 texels, cached, as Unreal 5 has them.

pub mod cache;
pub mod cascades;
pub mod grid;
pub mod map;
pub mod page;
pub mod receiver;
pub mod soft;

pub use cache::ShadowCache;
pub use cascades::{Cascades, Splits};
pub use grid::Grid;
pub use map::{Block, PageKey, ShadowMap};
pub use page::ShadowPage;
pub use receiver::{LightView, Lookup, Receiver};
pub use soft::Lamp;
