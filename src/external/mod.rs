//! Builds larger than memory. The source is put into blocks on disk, small enough to grow their levels in memory; what blocks
//! share stays. What is left of them, a sixteenth or less, is put into other blocks with other borders, stage by stage, until
//! one is left. Groups that have grown lie on disk, until all are laid out as a build in memory does.

pub mod assemble;
pub mod block;
pub mod cells;
pub mod lists;
pub mod page_file;
pub mod source;
pub mod spool;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

use crate::build::content::weights;
use crate::build::memory::trim_heap;
use crate::build::{Meter, Progress};
use crate::config::{BuildOptions, Levels};
use crate::error::{Error, Result};
use crate::math::Aabb;
use crate::mesh::{SourceMesh, attributes, frame, validate};
use crate::model::{BuildReport, Dag, LevelReport};
use crate::threads;

use self::assemble::{Stages, assemble, too_many};
use self::block::{Common, Made, Taken, of_left, of_source};
use self::cells::{Blocks, Cells};
use self::source::distribute;
use self::spool::SpoolReader;

/// Bytes that building in memory takes for each triangle, about.
pub const BYTES_PER_TRIANGLE: u64 = 700;
/// Fewer triangles are no block.
const LEAST_TRIANGLES: u64 = 4096;
/// By how much of its side the grid of each stage is shifted against the one before: the golden ratio repeats nothing soon.
const SHIFT: f64 = 0.618_033_988_749_895;
/// Where a stage leaves more than this part of what it was given, the next takes larger blocks.
const STALLED: f64 = 0.7;

/// Builds a mesh with about so many bytes of memory; what does not fit lies in `folder`, pages of the mesh included, which has
/// to stay for as long as the mesh.
pub fn build(
    source: &SourceMesh<'_>,
    options: &BuildOptions,
    memory: u64,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Dag> {
    options.validate()?;
    threads::install(options.threads, || run(source, options, memory, folder, progress))?
}

fn run(
    source: &SourceMesh<'_>,
    options: &BuildOptions,
    memory: u64,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Dag> {
    if !source.channels.is_empty() {
        return Err(Error::argument("channels", "not supported in builds with a memory limit"));
    }
    if options.preserve_area || options.levels == Levels::One {
        let message = "areas are preserved, and one level is built, in memory alone";
        return Err(Error::argument("memory", message));
    }
    validate::validate(source)?;
    let meter = Meter::new(progress, 2 * source.faces.len() as u64);
    let frame = frame::with_rounding(frame::of(source.positions), source.positions);
    let place = |v: usize| frame::internal(&frame, source.positions.get(v));
    let box_of = |v: usize| Aabb::of_points([&place(v)]);
    let around = (0..source.positions.len()).into_par_iter().map(box_of);
    let around = around.reduce(|| Aabb::EMPTY, |a, b| a.union(&b));
    let layout = attributes::layout(source);
    let common = Common {
        frame,
        layout,
        stride: attributes::stride(layout),
        source_faces: source.faces.len(),
        computed_normals: source.normals.is_none(),
        options,
    };
    let mut most = (memory / BYTES_PER_TRIANGLE).max(LEAST_TRIANGLES);
    let blocks = distribute(source, &frame, &Cells::new(&around, 0.0), most, folder)?;
    let (mut made, mut starts): (Vec<Made>, Vec<usize>) = (Vec::new(), vec![0]);
    for block in 0..blocks.count {
        let path = folder.join(format!("stage0-{block:06}"));
        made.push(of_source(source, &blocks, block, &common, path, &meter)?);
        trim_heap(common.source_faces);
    }
    let bounds = made.iter().fold(Aabb::EMPTY, |all, made| all.union(&made.bounds));
    let mut before = made.iter().map(|made| made.mended.faces).sum::<u64>();
    if before == 0 {
        return Err(Error::EmptyMesh("no face is left once faces without area are dropped".into()));
    }
    let mut first_group = first_groups(&made)?;
    loop {
        let stage = starts[starts.len() - 1]..made.len();
        let left = |made: &Made| made.left.iter().map(|left| u64::from(left.triangles)).sum::<u64>();
        let triangles: u64 = made[stage.clone()].iter().map(left).sum();
        if triangles == 0 {
            break;
        }
        if triangles as f64 > STALLED * before as f64 {
            most *= 2;
        }
        before = triangles;
        let level = made[stage.clone()].iter().map(|made| made.levels.end).max().unwrap_or(0);
        let taken = share_out(&made, stage.clone(), &bounds, starts.len(), most);
        let readers: Vec<SpoolReader> =
            made.iter().map(|made| SpoolReader::new(&made.path, layout, common.stride)).collect();
        let fixed = shared(&taken, &readers)?;
        starts.push(made.len());
        let is_last = taken.len() == 1;
        for (block, (taken, fixed)) in taken.iter().zip(fixed).enumerate() {
            let path = folder.join(format!("stage{}-{block:06}", starts.len() - 1));
            let part = (!is_last).then_some((fixed, triangles));
            made.push(of_left(taken, &readers, &first_group, part, level, &common, path, &meter)?);
            trim_heap(common.source_faces);
        }
        first_group = first_groups(&made)?;
    }
    let report = report(source, &made, &common);
    let faces = made.iter().map(|made| made.mended.faces).sum();
    let stages = Stages { made: &made, starts: &starts, first_group: &first_group, common: &common };
    assemble(&stages, bounds, faces, report, folder)
}

/// The number of the first group of each block.
fn first_groups(made: &[Made]) -> Result<Vec<u32>> {
    let mut next = 0u32;
    let first = |made: &Made| {
        let first = next;
        let end = next.checked_add(made.groups.len() as u32).filter(|end| *end < 1 << 31);
        next = end.ok_or_else(|| too_many("groups"))?;
        Ok(first)
    };
    made.iter().map(first).collect()
}

/// Puts what the blocks of a stage left into those of the next, by the centres of clusters.
fn share_out(made: &[Made], stage: Range<usize>, bounds: &Aabb, next: usize, most: u64) -> Vec<Vec<Taken>> {
    let cells = Cells::new(bounds, (next as f64 * SHIFT).fract());
    let all = stage.flat_map(|block| made[block].left.iter().map(move |left| (block as u32, left)));
    let placed: Vec<(u32, u32, &block::LeftEntry)> =
        all.map(|(block, left)| (cells.of(left.bounds.center().map(f64::from)), block, left)).collect();
    let mut counts = vec![0; Cells::COUNT];
    placed.iter().for_each(|(cell, _, left)| counts[*cell as usize] += u64::from(left.triangles));
    let blocks = Blocks::new(&counts, most);
    let mut out = vec![Vec::new(); blocks.count];
    for (cell, block, left) in placed {
        out[blocks.of(cell) as usize].push(Taken { block, place: left.place });
    }
    out
}

/// For each block the positions that others have, too.
fn shared(taken: &[Vec<Taken>], readers: &[SpoolReader]) -> Result<Vec<FxHashSet<[u32; 3]>>> {
    let mut owners: FxHashMap<[u32; 3], u32> = FxHashMap::default();
    let mut out = vec![FxHashSet::default(); taken.len()];
    for (block, taken) in (0..).zip(taken) {
        for Taken { block: from, place } in taken {
            for p in readers[*from as usize].read(*place)?.store.positions {
                let bits = p.map(f32::to_bits);
                let owner = *owners.entry(bits).or_insert(block);
                if owner != block {
                    out[owner as usize].insert(bits);
                    out[block as usize].insert(bits);
                }
            }
        }
    }
    Ok(out)
}

/// What all blocks did.
fn report(source: &SourceMesh<'_>, made: &[Made], common: &Common<'_>) -> BuildReport {
    let scale = common.frame.scale;
    let mut report = BuildReport {
        input_faces: source.faces.len() as u64,
        input_vertices: source.positions.len() as u64,
        computed_normals: common.computed_normals,
        weights: weights(common.options),
        ..BuildReport::default()
    };
    let mut used = vec![false; source.positions.len()];
    source.faces.iter().flatten().for_each(|v| used[*v as usize] = true);
    report.unreferenced_vertices = used.iter().filter(|used| !**used).count() as u64;
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
