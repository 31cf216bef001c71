//! Building: weld → clusterize → loop { group → lock shared borders → simplify → split } → layout.
//!
//! The scheme is that of Karis, Stubbe and Wihlidal, "Nanite: A Deep Dive", SIGGRAPH Advances in Real-Time
//! Rendering, 2021; the shape of the loop follows `clusterlod.h` of meshoptimizer.

pub mod assemble;
pub mod attribute_error;
pub mod bits;
pub mod check;
pub mod clusterize;
pub mod collapse;
pub mod content;
pub mod dag;
pub mod field;
#[cfg(feature = "metis")]
pub mod graph;
pub mod islands;
pub mod lock_borders;
pub mod memory;
#[cfg(feature = "metis")]
mod metis;
pub mod one_level;
pub mod order;
pub mod partition;
pub mod pose;
pub mod rebake;
pub mod reference;
pub mod relax;
mod rows;
pub mod silhouette;
pub mod simplify;
pub mod skin;
mod slabs;
pub mod source_labels;
pub mod store;
pub mod waves;
pub mod welding;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::config::BuildOptions;
use crate::error::Result;
use crate::mesh::{SourceMesh, weld};
use crate::model::{BuildReport, Dag, MemorySink, PageSink};
use crate::threads;

pub use check::{CheckReport, check};
pub use one_level::OneLevel;

/// Told how far a build is; may stop it. Called from worker threads, a few hundred times per build.
pub trait Progress: Sync {
    /// `done` of `total` units of work. Returning false cancels: the build ends with [`crate::Error::Cancelled`].
    fn update(&self, done: u64, total: u64) -> bool;
}

/// No progress, no cancellation.
pub struct Silent;

impl Progress for Silent {
    fn update(&self, _: u64, _: u64) -> bool {
        true
    }
}

/// Counts work and passes it on; remembers a wish to stop.
pub struct Meter<'a> {
    progress: &'a dyn Progress,
    done: AtomicU64,
    total: u64,
    cancelled: AtomicBool,
}

impl<'a> Meter<'a> {
    /// Of so many units of work.
    pub fn new(progress: &'a dyn Progress, total: u64) -> Self {
        Self { progress, done: AtomicU64::new(0), total, cancelled: AtomicBool::new(false) }
    }

    /// So much more is done; false once the work is to stop.
    pub fn advance(&self, by: usize) -> bool {
        if self.cancelled.load(Ordering::Relaxed) {
            return false;
        }
        let done = self.done.fetch_add(by as u64, Ordering::Relaxed) + by as u64;
        let goes_on = self.progress.update(done.min(self.total), self.total);
        self.cancelled.fetch_or(!goes_on, Ordering::Relaxed);
        goes_on
    }
}

/// Builds the cluster DAG of a mesh. The result does not depend on the number of threads.
pub fn build(source: &SourceMesh<'_>, options: &BuildOptions, progress: &dyn Progress) -> Result<Dag> {
    build_into(source, options, progress, MemorySink::default())
}

/// The same with its pages going to a sink.
pub fn build_into<S: PageSink<Output: Send> + Send>(
    source: &SourceMesh<'_>,
    options: &BuildOptions,
    progress: &dyn Progress,
    sink: S,
) -> Result<S::Output> {
    options.validate()?;
    threads::install(options.threads, || run(source, options, progress, sink))?
}

fn run<S: PageSink>(
    source: &SourceMesh<'_>,
    options: &BuildOptions,
    progress: &dyn Progress,
    sink: S,
) -> Result<S::Output> {
    let mut report = BuildReport::default();
    let mesh = weld(source, options.crease_angle, &mut report)?;
    let graph = dag::grow(mesh, options, progress, &mut report)?;
    // What is laid out comes on top of what was grown.
    memory::trim_heap(graph.source_faces);
    assemble::assemble(graph, report, sink)
}
