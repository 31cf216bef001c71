//! Streaming: of meshes whose pages lie in files, memory holds what the view needs.
//!
//! After each frame the renderer says which pages the frame needed and how much (`request.rs`); the pool decides what
//! is to be there (`pool.rs`), the loader of `model/` has it read and decoded, and before the next frame what has
//! arrived takes its place (`streamer.rs`). Both backends share all of it. `docs/streaming.md` follows a request from end
//! to end.

mod pool;
mod request;
mod resident;
mod streamer;

pub use pool::{Ask, Pool};
pub use request::{Needs, Request};
pub use resident::Resident;
pub use streamer::{Fault, StreamOptions, StreamStats, Streamer};
