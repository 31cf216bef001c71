//! One level at once: a mesh simplified to a number of triangles, without a DAG, pages or proofs.
//!
//! Rounds over blocks of the whole mesh, on all cores. A block is a part of space (`math::median`) whose points
//! that other blocks share are locked; the next round divides space elsewhere. With the best quality all blocks of
//! a round collapse up to one cost, which a sample gives, and the last blocks proceed together to the exact number.
//! This acts as one queue: flat parts are simplified first. Small meshes, and the last step with the fast quality,
//! are one piece. Nothing depends on the number of threads.

mod blocks;

use rayon::prelude::*;

use self::blocks::{compact, split};
use crate::build::collapse::Limit;
use crate::build::content::Content;
use crate::build::dag::{RELAX_REACH, merged};
use crate::build::relax::fit;
use crate::build::simplify::{Finished, Reduction, reduce, trace};
use crate::build::store::LocalMesh;
use crate::build::{Meter, Progress};
use crate::config::{BuildOptions, Quality};
use crate::error::{Error, Result};
use crate::lod::CutArrays;
use crate::math::median::Place;
use crate::mesh::edges::Edges;
use crate::mesh::{Channels, SourceMesh, WeldedMesh, hash, weld};
use crate::model::{AttributeLayout, BuildReport, Channel, CoordinateFrame};
use crate::threads;

/// Most triangles of a block.
const BLOCK: usize = 1 << 15;
/// The least part of the triangles that a round leaves: with our own collapses, and with meshoptimizer's, whose
/// order is the less exact the more a call removes.
const BEST_STEP: f64 = 0.1;
const FAST_STEP: f64 = 0.5;
/// Rounds stop at so many times the target; the last step reaches the exact number.
const ROOM: f64 = 1.1;
/// A round that misses its target by more than this part of it is repeated with an exact number.
const MISSED: f64 = 0.1;
/// A round that would remove at most this part is left out: the last step does it.
const NEAR: f64 = 0.2;
/// Limits of the cost in an exact round, as multiples of the sampled cost; the next one where that is too low.
const BEYOND: [f64; 3] = [1.5, 6.0, f64::INFINITY];
/// Up to so many triangles all blocks stay in memory and proceed step by step; above, each block gets a target of
/// its own.
const TOGETHER: usize = 1 << 20;
/// Blocks of the last step, and the least number of triangles of each.
const LAST_BLOCKS: usize = 8;
const SMALL: usize = 1 << 14;
/// In the last step the cost limit of all blocks grows by `COST_STEP` until `REST` too many triangles are left;
/// these are removed one by one. Costs within `ALIKE` of each other are equal.
const COST_STEP: f64 = 1.1;
const ALIKE: f64 = 1.0e-6;
const REST: f64 = 0.03;
/// A round that removes less is the last.
const LEAST_GAIN: f64 = 0.01;
/// Where space is divided, in alternation: borders of blocks are elsewhere in the next round.
const MIDDLES: [f64; 2] = [0.5, 0.4];
/// Points that move less, relative to the largest coordinate, did not move: rounding of f32, several times.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;
/// The row of a new vertex.
const NEW: u32 = u32::MAX;

/// How far to decimate.
#[derive(Clone, Copy, Debug, Default)]
pub struct Goal {
    /// Triangles to stop at.
    pub target: usize,
    /// Vertices of the mesh's own border stay as they are.
    pub preserve_border: bool,
    /// Only collapses that change neither shape nor attributes.
    pub lossless: bool,
}

/// A decimated mesh.
#[derive(Debug)]
pub struct Decimated {
    /// Its arrays; runs of triangles of one material take the place of clusters.
    pub arrays: CutArrays,
    /// The material of each run.
    pub materials: Vec<i32>,
    /// Named channels, a row for each vertex.
    pub channels: Vec<Channel>,
    /// Which attributes there are.
    pub layout: AttributeLayout,
    /// Internal to object space.
    pub frame: CoordinateFrame,
    /// What welding and mending did.
    pub report: BuildReport,
}

/// Decimates a mesh. The result does not depend on the number of threads.
pub fn decimate(
    source: &SourceMesh<'_>,
    goal: Goal,
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<Decimated> {
    options.validate()?;
    threads::install(options.threads, || run(source, goal, options, progress))?
}

fn run(
    source: &SourceMesh<'_>,
    goal: Goal,
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<Decimated> {
    let mut report = BuildReport::default();
    let mut mesh = weld(source, options.crease_angle, &mut report)?;
    let content = Content::new(&mesh, report.computed_normals, options);
    let mut options = options.clone();
    if goal.lossless {
        options.quality = Quality::Best;
    }
    let meter = Meter::new(progress, mesh.faces.len().saturating_sub(goal.target) as u64);
    let (layout, frame, stride) = (mesh.layout, mesh.frame, mesh.stride);
    let channels = std::mem::take(&mut mesh.channels);
    let whole = whole(mesh, &channels, goal.preserve_border);
    let mut rounds = Rounds { whole, stride, goal, content, options, meter };
    rounds.run()?;
    let (arrays, materials, channels) = finish(rounds.whole, layout, stride, &channels);
    Ok(Decimated { arrays, materials, channels, layout, frame, report })
}

/// A welded mesh in the form that collapses take; `ids` name the vertices of the source.
fn whole(mesh: WeldedMesh, channels: &Channels, preserve_border: bool) -> LocalMesh {
    let position_ids = hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3);
    let mut locked = vec![false; mesh.positions.len()];
    if preserve_border {
        let edges = Edges::named(&mesh.faces, |v| position_ids[v as usize]);
        for edge in edges.iter().filter(|edge| edge.faces() == 1) {
            (locked[edge.ends.0 as usize], locked[edge.ends.1 as usize]) = (true, true);
        }
        (0..locked.len()).for_each(|v| locked[v] = locked[position_ids[v] as usize]);
    }
    LocalMesh {
        ids: (0..mesh.positions.len() as u32).collect(),
        position_ids,
        locked,
        labels: channels.label_numbers(),
        attributes: mesh.attributes,
        materials: mesh.materials,
        indices: mesh.faces.into_flattened(),
        positions: mesh.positions,
        copies: Vec::new(),
    }
}

/// A simplified block.
struct Made {
    mesh: LocalMesh,
    /// Whether each vertex changed.
    moved: Vec<bool>,
}

/// The mesh while it is decimated.
struct Rounds<'a> {
    whole: LocalMesh,
    stride: usize,
    goal: Goal,
    content: Content,
    options: BuildOptions,
    meter: Meter<'a>,
}

impl Rounds<'_> {
    fn run(&mut self) -> Result<()> {
        self.advance(0)?;
        let is_best = self.options.quality == Quality::Best;
        let step = if is_best { BEST_STEP } else { FAST_STEP };
        let target = self.goal.target;
        for number in 0.. {
            let before = self.faces();
            let least = ROOM * target as f64;
            let exact = before as f64 <= (1.0 + NEAR) * least;
            if before <= target.max(SMALL) || before <= BLOCK && self.goal.lossless {
                break;
            }
            if !self.goal.lossless && exact && before <= TOGETHER {
                if is_best {
                    self.together(number)?;
                }
                break;
            }
            if before <= BLOCK && !exact {
                break;
            }
            let wanted = if exact { target } else { least.max(step * before as f64) as usize };
            self.round(number, wanted, exact)?;
            if (before.saturating_sub(self.faces()) as f64) < LEAST_GAIN * before as f64 {
                break;
            }
        }
        if self.faces() > target && !(self.goal.lossless && self.faces() > TOGETHER) {
            self.one_piece()?;
        }
        if self.faces() > target && !is_best {
            // meshoptimizer's collapses end where sheets touch.
            self.options.quality = Quality::Best;
            self.one_piece()?;
        }
        Ok(())
    }

    /// Collapses in blocks to the exact number, in the order of one queue.
    fn together(&mut self, number: usize) -> Result<()> {
        let (before, target) = (self.faces(), self.goal.target);
        let mut places = self.places();
        let size = (before / LAST_BLOCKS + 1).max(SMALL / 2);
        let mut blocks = split(&mut places, size, MIDDLES[number % MIDDLES.len()]);
        let shared = self.shared(&blocks);
        let started = |block: &&mut [Place]| {
            let local = self.part(block, |position| shared[position as usize]);
            let reduction = Reduction::new(&local, &self.content, &self.options);
            (local, reduction)
        };
        blocks.par_iter_mut().for_each(|block| block.sort_unstable_by_key(|place| place.number));
        let mut parts: Vec<(LocalMesh, Reduction)> = blocks.par_iter().with_max_len(1).map(started).collect();
        let left = |parts: &mut [(LocalMesh, Reduction)]| -> usize {
            parts.iter_mut().map(|(_, reduction)| reduction.collapses().triangles()).sum()
        };
        let next = |parts: &mut [(LocalMesh, Reduction)]| {
            let costs = parts.iter_mut().filter_map(|(_, reduction)| reduction.collapses().next_cost());
            costs.min_by(f64::total_cmp)
        };
        let mut limit = next(&mut parts).unwrap_or(f64::INFINITY);
        loop {
            self.advance(0)?;
            let before = left(&mut parts);
            let excess = before.saturating_sub(target);
            if excess as f64 <= REST * target as f64 {
                break;
            }
            // So that all blocks together never remove too much.
            let most = excess / parts.len();
            let waits = parts.par_iter_mut().with_max_len(1).map(|(_, reduction)| {
                let collapses = reduction.collapses();
                let target = collapses.triangles().saturating_sub(most);
                let waits = collapses.proceed(Limit { cost: limit, ..Limit::triangles(target) });
                waits || collapses.triangles() > target
            });
            if !waits.reduce(|| true, |a, b| a && b) {
                continue;
            }
            let Some(next) = next(&mut parts) else { break };
            if limit.is_infinite() && left(&mut parts) == before {
                break;
            }
            limit = next.max(limit * COST_STEP);
        }
        loop {
            let excess = left(&mut parts).saturating_sub(target);
            let next = |(at, (_, reduction)): (usize, &mut (LocalMesh, Reduction))| {
                reduction.collapses().next_cost().map(|cost| (cost, at))
            };
            let mut next: Vec<(f64, usize)> = parts.iter_mut().enumerate().filter_map(next).collect();
            if excess == 0 || next.is_empty() {
                break;
            }
            next.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
            // Up to the cost of the next block, and at least one step.
            let cost = next.get(1).map_or(f64::INFINITY, |(cost, _)| cost.max(next[0].0 * (1.0 + ALIKE)));
            let collapses = parts[next[0].1].1.collapses();
            let target = collapses.triangles().saturating_sub(excess);
            collapses.proceed(Limit { cost, ..Limit::triangles(target) });
        }
        let this = &*self;
        let made = parts.into_par_iter().with_max_len(1).map(|(local, reduction)| {
            let finished = reduction.finish(&local, &this.content);
            this.settled(&local, finished)
        });
        let made = made.collect();
        self.write_back(made)
    }

    fn advance(&self, by: usize) -> Result<()> {
        if self.meter.advance(by) { Ok(()) } else { Err(Error::Cancelled) }
    }

    /// Collapses the mesh in one piece to the exact number.
    fn one_piece(&mut self) -> Result<()> {
        let before = self.faces();
        let whole = std::mem::take(&mut self.whole);
        let limit = self.limit(self.goal.target, f64::INFINITY);
        let Made { mesh: after, moved } = self.reduced(&whole, limit);
        if after.indices.is_empty() {
            self.whole = whole;
            return Ok(());
        }
        self.whole = after;
        self.whole.ids.iter_mut().zip(&moved).filter(|(_, moved)| **moved).for_each(|(id, _)| *id = NEW);
        self.whole = compact(&self.whole, self.stride);
        self.advance(before.saturating_sub(self.faces()))
    }

    /// A simplified mesh, and whether each vertex changed.
    fn reduced(&self, mesh: &LocalMesh, limit: Limit) -> Made {
        self.settled(mesh, reduce(mesh, limit, &self.content, &self.options))
    }

    /// The same after its collapses.
    fn settled(&self, mesh: &LocalMesh, finished: Finished) -> Made {
        let Finished { mesh: mut after, moved, .. } = finished;
        let fits = self.options.quality == Quality::Best && !self.goal.lossless;
        // A vertex that moves along the surface would take its attributes along.
        if fits && self.content.is_bare() && !after.indices.is_empty() {
            fit(&mut after, mesh, RELAX_REACH * f64::from(moved), self.content.up);
        }
        after.join_copies(|after, v| after.differs(mesh, v));
        let moved = (0..after.ids.len()).map(|v| after.differs(mesh, v)).collect();
        Made { mesh: after, moved }
    }

    fn faces(&self) -> usize {
        self.whole.indices.len() / 3
    }

    fn limit(&self, target: usize, cost: f64) -> Limit {
        let distance = if self.goal.lossless { ROUNDING } else { f64::INFINITY };
        Limit { target, cost, distance }
    }

    /// Collapses in blocks until about so many triangles are left; not more than one or two fewer where it is `exact`.
    fn round(&mut self, number: usize, wanted: usize, exact: bool) -> Result<()> {
        let before = self.faces();
        let mut places = self.places();
        let mut blocks = split(&mut places, BLOCK, MIDDLES[number % MIDDLES.len()]);
        let shared = self.shared(&blocks);
        let ratio = wanted as f64 / before as f64;
        let limits: Vec<Limit> = if self.goal.lossless {
            vec![self.limit(0, f64::INFINITY); blocks.len()]
        } else if self.options.quality == Quality::Best {
            vec![self.limit(0, self.cost(&mut blocks, ratio)); blocks.len()]
        } else {
            blocks.iter().map(|b| self.limit((b.len() as f64 * ratio) as usize, f64::INFINITY)).collect()
        };
        blocks.par_iter_mut().for_each(|block| block.sort_unstable_by_key(|place| place.number));
        let missed = |made: &[Made]| {
            let left: usize = made.iter().map(|made| made.mesh.indices.len() / 3).sum();
            self.options.quality == Quality::Best
                && !self.goal.lossless
                && left < ((1.0 - MISSED) * wanted as f64).max(self.goal.target as f64) as usize
        };
        let mut made = None;
        if !exact || self.options.quality == Quality::Fast {
            made = Some(self.blocks(&blocks, &shared, &limits)?);
        }
        let made = match made.filter(|made| !missed(made)) {
            Some(made) => made,
            None => {
                let limits = self.exact_limits(&blocks, &shared, &limits, wanted)?;
                self.blocks(&blocks, &shared, &limits)?
            }
        };
        self.write_back(made)
    }

    /// Three times the centre of each triangle.
    fn places(&self) -> Vec<Place> {
        let whole = &self.whole;
        let place = |t: usize| {
            let p: [[f32; 3]; 3] =
                std::array::from_fn(|k| whole.positions[whole.indices[3 * t + k] as usize]);
            Place { point: std::array::from_fn(|k| p[0][k] + p[1][k] + p[2][k]), number: t as u32 }
        };
        (0..self.faces()).into_par_iter().map(place).collect()
    }

    /// Writes all simplified blocks back.
    fn write_back(&mut self, made: Vec<Made>) -> Result<()> {
        let before = self.faces();
        let mut indices = Vec::with_capacity(made.iter().map(|made| made.mesh.indices.len()).sum());
        for Made { mesh, moved } in made {
            self.take_in(&mesh, &moved, &mut indices);
        }
        self.whole.indices = indices;
        self.whole = compact(&self.whole, self.stride);
        self.advance(before.saturating_sub(self.faces()))
    }

    /// Simplifies each block.
    fn blocks(&self, blocks: &[&mut [Place]], shared: &[bool], limits: &[Limit]) -> Result<Vec<Made>> {
        blocks
            .par_iter()
            .zip(limits)
            // One at a time: threads steal what others have not begun.
            .with_max_len(1)
            .map(|(block, limit)| {
                self.advance(0)?;
                let local = self.part(block, |position| shared[position as usize]);
                Ok(self.reduced(&local, *limit))
            })
            .collect()
    }

    /// The target of each block such that `wanted` triangles are left in all, in the order of one queue.
    fn exact_limits(
        &self,
        blocks: &[&mut [Place]],
        shared: &[bool],
        limits: &[Limit],
        wanted: usize,
    ) -> Result<Vec<Limit>> {
        let mut traces: Vec<Vec<(f64, u32)>> = Vec::new();
        for beyond in BEYOND {
            traces = blocks
                .par_iter()
                .zip(limits)
                .with_max_len(1)
                .map(|(block, limit)| {
                    self.advance(0)?;
                    let local = self.part(block, |position| shared[position as usize]);
                    let limit = Limit { cost: beyond * limit.cost, ..*limit };
                    Ok(trace(&local, limit, &self.content, &self.options))
                })
                .collect::<Result<_>>()?;
            let left = |(block, trace): (&&mut [Place], &Vec<(f64, u32)>)| {
                trace.last().map_or(block.len(), |(_, after)| *after as usize)
            };
            if blocks.iter().zip(&traces).map(left).sum::<usize>() <= wanted {
                break;
            }
        }
        let mut left: Vec<usize> = blocks.iter().map(|block| block.len()).collect();
        let mut gone = self.faces() - wanted;
        let steps = merged(left.iter().zip(&traces).map(|(triangles, trace)| (*triangles, &trace[..])));
        let mut sum = 0;
        let crossing = steps.iter().find(|(_, removed)| {
            sum += *removed as usize;
            sum >= gone
        });
        let dearest = crossing.map_or(f64::INFINITY, |(cost, _)| *cost);
        // Steps that cost as much as the last one are taken block by block.
        let mut taken = vec![0; left.len()];
        for may_equal in [false, true] {
            for ((left, taken), trace) in left.iter_mut().zip(&mut taken).zip(&traces) {
                let end = trace.partition_point(|(cost, _)| *cost < dearest || may_equal && *cost == dearest);
                while gone > 0 && *taken < end {
                    let after = trace[*taken].1 as usize;
                    gone = gone.saturating_sub(left.saturating_sub(after));
                    (*left, *taken) = (after, *taken + 1);
                }
            }
        }
        Ok(left.into_iter().map(|left| self.limit(left, f64::INFINITY)).collect())
    }
}

/// The arrays of the simplified mesh, by material.
fn finish(
    mut mesh: LocalMesh,
    layout: AttributeLayout,
    stride: usize,
    channels: &Channels,
) -> (CutArrays, Vec<i32>, Vec<Channel>) {
    let material = |t: &[u32; 3]| mesh.materials.get(t[0] as usize).map_or(0, |m| m.cast_signed());
    let mut faces: Vec<[u32; 3]> = bytemuck::cast_slice(&mesh.indices).to_vec();
    // Stable: triangles of a material stay in their order.
    faces.sort_by_key(material);
    let mut arrays = CutArrays { uvs: vec![Vec::new(); layout.uv_sets.into()], ..CutArrays::default() };
    let mut materials = Vec::new();
    for run in faces.chunk_by(|a, b| material(a) == material(b)) {
        arrays.first_face.push(arrays.faces.len() as u32);
        arrays.faces.extend_from_slice(run);
        materials.push(material(&run[0]));
    }
    arrays.first_face.push(arrays.faces.len() as u32);
    mesh.indices = arrays.faces.as_flattened().to_vec();
    let mesh = compact(&mesh, stride);
    arrays.faces = bytemuck::cast_slice(&mesh.indices).to_vec();
    for (v, row) in mesh.attributes.chunks_exact(stride).enumerate() {
        arrays.push(layout, mesh.positions[v], v as u32, row, false);
    }
    let source = |v: usize| (mesh.ids[v] != NEW).then_some(mesh.ids[v] as usize);
    let channels = channels.finish_of(&mesh.attributes, stride, &mesh.labels, source);
    (arrays, materials, channels)
}

#[cfg(test)]
mod tests;
