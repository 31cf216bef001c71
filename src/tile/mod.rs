//! Tiles: uniform cuts of a mesh, level after level, each clipped at the planes of the boxes of a tree, so that a viewer that
//! knows nothing of groups can load and replace them box by box.
//!
//! Boxes are halved. A tile has what a cut for one error has inside of its box. Two tiles that meet in a plane have the same
//! vertices there: a point where an edge crosses a plane depends on the edge and the plane alone, and where the boxes on
//! one side are halved again, all tiles along the plane have a vertex where the surface crosses that halving.

mod clip;
mod extract;
mod plan;

pub use extract::{Piece, extract};
pub use plan::{Crossing, Layout, Plan, Tile, plan};
