//! What a build in blocks did, as a build in memory reports it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::block::{Common, Summary};
use crate::build::content::weights;
use crate::mesh::SourceMesh;
use crate::model::{BuildReport, LevelReport};

/// How much a source has.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Input {
    /// Its faces.
    pub faces: u64,
    /// Its vertices.
    pub vertices: u64,
    /// Vertices that no face with an area uses.
    pub unreferenced: u64,
}

impl Input {
    /// Counts a source, of which faces use some vertices.
    pub fn of(source: &SourceMesh<'_>, used: &[bool]) -> Self {
        Self {
            faces: source.faces.len() as u64,
            vertices: source.positions.len() as u64,
            unreferenced: used.iter().filter(|used| !**used).count() as u64,
        }
    }
}

/// What all blocks did.
pub fn report(input: &Input, made: &[&Summary], common: &Common<'_>) -> BuildReport {
    let scale = common.frame.scale;
    let mut report = BuildReport {
        input_faces: input.faces,
        input_vertices: input.vertices,
        unreferenced_vertices: input.unreferenced,
        computed_normals: common.computed_normals,
        weights: weights(common.options),
        preserve_area: common.options.preserve_area,
        ..BuildReport::default()
    };
    let mut crowded: BTreeMap<u32, u64> = BTreeMap::new();
    for made in made {
        report.degenerate_faces += made.mended.degenerate_faces;
        report.duplicate_faces += made.mended.duplicate_faces;
        report.border_edges += made.mended.border_edges;
        made.mended.crowded.iter().for_each(|(faces, uses)| *crowded.entry(*faces).or_default() += uses);
        report.mended_normals += made.report.mended_normals;
        report.stuck.extend(made.report.stuck.iter().cloned());
        for (level, counts) in (made.levels.start as usize..).zip(&made.report.levels) {
            if report.levels.len() <= level {
                report.levels.resize(level + 1, LevelReport::default());
            }
            let all = &mut report.levels[level];
            all.clusters += counts.clusters;
            all.triangles += counts.triangles;
            all.groups += counts.groups;
            all.retried += counts.retried;
            all.steps.iter_mut().zip(counts.steps).for_each(|(all, steps)| *all += steps);
            all.max_error = all.max_error.max(counts.max_error * scale);
            all.max_attribute_error = all.max_attribute_error.max(counts.max_attribute_error * scale);
        }
    }
    report.non_manifold_edges = crowded.iter().map(|(faces, uses)| uses / u64::from(*faces)).sum();
    report
}
