//! Builds larger than memory. The source is put into blocks on disk, small enough to grow their levels in memory; what blocks
//! share stays. What is left of them is put into other blocks with other borders, stage by stage, until one is left. Groups that
//! have grown lie on disk, until all are laid out as a build in memory does.

pub mod assemble;
pub mod block;
pub mod cells;
pub mod lists;
pub mod page_file;
pub mod report;
pub mod source;
pub mod spool;
pub mod work;

pub use self::work::{Work, memory_of};
