//! Building: weld → clusterize → loop { group → lock shared borders → simplify → split } → layout.
//!
//! The scheme is that of Karis, Stubbe and Wihlidal, "Nanite: A Deep Dive", SIGGRAPH Advances in Real-Time
//! Rendering, 2021; the shape of the loop follows `clusterlod.h` of meshoptimizer.

pub mod assemble;
pub mod attribute_error;
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
pub mod order;
pub mod partition;
pub mod reference;
pub mod relax;
pub mod silhouette;
pub mod simplify;
pub mod store;

use crate::config::BuildOptions;
use crate::error::{Error, Result};
use crate::mesh::{SourceMesh, weld};
use crate::model::{BuildReport, Dag};

pub use check::{CheckReport, check};

/// Told how far a build is; may stop it. Called from worker threads, a few hundred times per build.
pub trait Progress: Sync {
    /// `done` of `total` units of work. Returning false cancels: the build ends with [`Error::Cancelled`].
    fn update(&self, done: u64, total: u64) -> bool;
}

/// No progress, no cancellation.
pub struct Silent;

impl Progress for Silent {
    fn update(&self, _: u64, _: u64) -> bool {
        true
    }
}

/// Builds the cluster DAG of a mesh. The result does not depend on the number of threads.
pub fn build(source: &SourceMesh<'_>, options: &BuildOptions, progress: &dyn Progress) -> Result<Dag> {
    options.validate()?;
    if options.threads == 0 {
        return run(source, options, progress);
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(options.threads)
        .build()
        .map_err(|e| Error::argument("threads", e.to_string()))?;
    pool.install(|| run(source, options, progress))
}

fn run(source: &SourceMesh<'_>, options: &BuildOptions, progress: &dyn Progress) -> Result<Dag> {
    let mut report = BuildReport::default();
    let mesh = weld(source, options.crease_angle, &mut report)?;
    let graph = dag::grow(mesh, options, progress, &mut report)?;
    // What is laid out comes on top of what was grown.
    memory::give_back(graph.source_faces);
    Ok(assemble::assemble(graph, report))
}
