//! One level at once: a mesh simplified to a number of triangles, without a DAG, pages or proofs.
//!
//! Rounds over blocks of the whole mesh, on all cores. A block is a part of space (`math::median`) with the points that it
//! shares with others locked; the next round halves space elsewhere. With the best quality what a collapse may cost is the
//! same in all blocks of a round, as a sample tells, and the last blocks go on together to the exact number: it is as if there
//! were one queue, and what is flat goes first. What is small, or left with the fast quality, is done in one piece. Nothing
//! depends on the number of threads.

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
/// Part of the triangles that a round leaves, at least: by our own collapses, and by meshoptimizer's, whose order is less
/// exact the more goes at once.
const BEST_STEP: f64 = 0.1;
const FAST_STEP: f64 = 0.5;
/// Rounds stop at so many times the target; the rest is done with an exact number.
const ROOM: f64 = 1.1;
/// A round that misses what it was to leave by more than this part of it is done again, exactly.
const MISSED: f64 = 0.1;
/// Where a round would take away no more than this part, none is made before the last.
const NEAR: f64 = 0.2;
/// What an exact round looks at, in terms of what a collapse of it may cost by the sample; more where that is too little.
const BEYOND: [f64; 3] = [1.5, 6.0, f64::INFINITY];
/// As many triangles are done with all blocks in memory, step by step; more by what each block is found to need.
const TOGETHER: usize = 1 << 20;
/// Blocks of the last step, and what they have at least.
const LAST_BLOCKS: usize = 8;
const SMALL: usize = 1 << 14;
/// In the last step blocks go on together by this part in cost until this part too much is left; the rest goes one by one.
/// Costs that differ by no more are the same.
const COST_STEP: f64 = 1.1;
const ALIKE: f64 = 1.0e-6;
const REST: f64 = 0.03;
/// A round that takes away less is the last.
const LEAST_GAIN: f64 = 0.01;
/// Where space is halved, by turns: borders of blocks are elsewhere in the next round.
const MIDDLES: [f64; 2] = [0.5, 0.4];
/// What lies so near, in parts of the largest coordinate, is where it was: rounding of f32, several times.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;
/// The row of what is no vertex of the source.
const NEW: u32 = u32::MAX;

/// How far to decimate.
#[derive(Clone, Copy, Debug, Default)]
pub struct Goal {
    /// Triangles to stop at.
    pub target: usize,
    /// Vertices of the mesh's own border stay as they are.
    pub preserve_border: bool,
    /// Only what changes neither shape nor attributes goes.
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
    /// What was mended.
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

/// A welded mesh as one that collapses; `ids` name the vertices of the source.
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

/// What became of a block.
struct Made {
    mesh: LocalMesh,
    /// For each vertex whether it is another one than it was.
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
            // Meshoptimizer's collapses end where sheets are in each other's way.
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
            // Even if all of them take as much as they may, no more goes than is to.
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
            // Up to what the next one asks, and at least one step.
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
        self.put_back(made)
    }

    fn advance(&self, by: usize) -> Result<()> {
        if self.meter.advance(by) { Ok(()) } else { Err(Error::Cancelled) }
    }

    /// Collapses what is left in one piece: to the exact number.
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

    /// What becomes of a mesh, and for each vertex whether it is another one than it was.
    fn reduced(&self, mesh: &LocalMesh, limit: Limit) -> Made {
        self.settled(mesh, reduce(mesh, limit, &self.content, &self.options))
    }

    /// The same once its collapses are done.
    fn settled(&self, mesh: &LocalMesh, finished: Finished) -> Made {
        let Finished { mesh: mut after, moved, .. } = finished;
        let fits = self.options.quality == Quality::Best && !self.goal.lossless;
        // What moves within the surface would take along what it carries.
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
        self.put_back(made)
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

    /// Takes in what became of all blocks.
    fn put_back(&mut self, made: Vec<Made>) -> Result<()> {
        let before = self.faces();
        let mut indices = Vec::with_capacity(made.iter().map(|made| made.mesh.indices.len()).sum());
        for Made { mesh, moved } in made {
            self.take_in(&mesh, &moved, &mut indices);
        }
        self.whole.indices = indices;
        self.whole = compact(&self.whole, self.stride);
        self.advance(before.saturating_sub(self.faces()))
    }

    /// What becomes of each block.
    fn blocks(&self, blocks: &[&mut [Place]], shared: &[bool], limits: &[Limit]) -> Result<Vec<Made>> {
        blocks
            .par_iter()
            .zip(limits)
            // One at a time: a thread that is through takes what another has not begun.
            .with_max_len(1)
            .map(|(block, limit)| {
                self.advance(0)?;
                let local = self.part(block, |position| shared[position as usize]);
                Ok(self.reduced(&local, *limit))
            })
            .collect()
    }

    /// Where each block is to stop so that `wanted` triangles are left of all, in the order of one queue.
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
        // What costs as much as the last step goes block by block.
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

/// The arrays of what is left, by material.
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
