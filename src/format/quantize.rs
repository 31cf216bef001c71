//! Positions on one power-of-two grid and normals in few bits, for every level alike, so that files are small.
//! Vertices that clusters share have one position before and one after, so that cuts stay closed; bounds are made
//! again from what came out. How far positions moved is kept beside the mesh and is part of what cuts state
//! (`docs/numerics.md`).

use std::borrow::Cow;
use std::sync::Arc;

use rayon::prelude::*;

use super::page::MAX_STEPS;
use super::validate;
use crate::error::{Error, Result};
use crate::math::octahedral::{NORMAL_BITS, narrow, widen};
use crate::math::{Aabb, Bounds};
use crate::model::cluster::RECORD_WORDS;
use crate::model::packing::{VertexRow, vertex_row};
use crate::model::{
    AttributeLayout, ClusterAddress, ClusterGeometry, ClusterRecord, Dag, FOREVER, Grid, Group, Node,
    Packing, PageEntry, PageWords, Pages,
};

/// Bits of each octahedral coordinate of a normal in files that round: off by a quarter of a degree at most.
pub const STORED_NORMAL_BITS: u32 = 10;
/// With no other wish, a step is at most the median edge of the source over 2 to this power.
const AUTO_EDGE_BITS: i32 = 4;
/// The finest grid: coordinates are about 1 at most.
pub const MAX_EXPONENT: i32 = MAX_STEPS.ilog2() as i32;

/// How finely a file keeps positions and normals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Precision {
    /// A sixteenth of the median edge of the source, or less.
    Auto,
    /// As they are.
    Exact,
    /// Steps of so many object units, or less.
    Step(f64),
}

/// A mesh as it is to be stored, page by page.
#[derive(Debug)]
pub struct Rounded<'a> {
    /// The mesh.
    pub dag: &'a Dag,
    /// What its positions and normals are rounded to.
    pub grid: Option<Grid>,
    /// Box of the source.
    pub bounds: Aabb,
    /// Groups, with their boxes.
    pub groups: Cow<'a, [Group]>,
    /// The hierarchy, with its boxes.
    pub nodes: Cow<'a, [Node]>,
}

impl<'a> Rounded<'a> {
    /// Finds the grid and everything but the pages.
    pub fn new(dag: &'a Dag, precision: Precision) -> Result<Self> {
        dag.load_all(FOREVER)?;
        // What could not be read is not written.
        validate::structure(dag).map_err(|(kind, what)| Error::Invariant(format!("{kind:?}: {what}")))?;
        let asis = Self {
            dag,
            grid: dag.grid,
            bounds: dag.bounds,
            groups: Cow::Borrowed(&dag.groups),
            nodes: Cow::Borrowed(&dag.nodes),
        };
        let Some(exponent) = exponent(dag, precision)? else { return Ok(asis) };
        let mut grid = Grid { exponent, normal_bits: STORED_NORMAL_BITS, moved: 0.0 };
        let pages: Vec<(f64, Vec<Aabb>)> =
            (0..dag.pages.table.len()).into_par_iter().map(|p| survey(dag, p, grid)).collect();
        let moved = pages.iter().map(|p| p.0).fold(0.0, f64::max).sqrt();
        let before = dag.grid.map_or(0.0, |grid| grid.moved);
        // The squares and their sum, the root and the product are off by a few units in the last place.
        grid.moved = if moved > 0.0 { before + moved * dag.frame.scale * (1.0 + 1.0e-15) } else { before };
        if moved > 0.0 {
            grid.moved = grid.moved.next_up();
        }

        let mut clusters = pages.iter().flat_map(|p| &p.1);
        let of_group =
            |g: &Group| clusters.by_ref().take(g.count as usize).fold(Aabb::EMPTY, |b, c| b.union(c));
        let boxes: Vec<Aabb> = dag.groups.iter().map(of_group).collect();
        let mut groups = dag.groups.to_vec();
        for (group, bounds) in groups.iter_mut().zip(&boxes) {
            (group.center, group.extent) = bounds.center_extent();
        }
        let mut nodes = dag.nodes.clone();
        let mut below = vec![Aabb::EMPTY; nodes.len()];
        // Children come after their parents.
        for (n, node) in nodes.iter_mut().enumerate().rev() {
            let children = node.first as usize..node.first as usize + usize::from(node.count);
            let of = if node.is_leaf == 1 { &boxes[children] } else { &below[children] };
            below[n] = of.iter().fold(Aabb::EMPTY, |b, c| b.union(c));
            (node.center, node.extent) = below[n].center_extent();
        }
        // Rounding keeps the order of numbers: the box of what was rounded is the rounded box.
        let bounds = Aabb { min: snap(dag.bounds.min, grid), max: snap(dag.bounds.max, grid) };
        Ok(Self { grid: Some(grid), bounds, groups: Cow::Owned(groups), nodes: Cow::Owned(nodes), ..asis })
    }

    /// The words of a page.
    pub fn page(&self, page: usize) -> Cow<'a, [u32]> {
        let words = self.dag.pages.page(page);
        match self.grid {
            Some(grid) if self.dag.grid != Some(grid) => {
                Cow::Owned(round_page(words, self.dag.pages.records(page), self.dag.layout(), grid))
            }
            _ => Cow::Borrowed(words),
        }
    }
}

/// The mesh that a file of this precision holds. One that is on a grid as coarse stays what it is.
pub fn quantize(dag: &Dag, precision: Precision) -> Result<Dag> {
    let rounded = Rounded::new(dag, precision)?;
    let pages: Vec<PageWords> =
        (0..dag.pages.table.len()).into_par_iter().map(|p| rounded.page(p).into()).collect();
    let entry = |(entry, words): (&PageEntry, &PageWords)| PageEntry { words: words.len() as u32, ..*entry };
    let table = dag.pages.table.iter().zip(&pages).map(entry).collect();
    Ok(Dag {
        pages: Arc::new(Pages::new(table, dag.layout(), pages)),
        grid: rounded.grid,
        bounds: rounded.bounds,
        groups: rounded.groups.into(),
        nodes: rounded.nodes.into_owned(),
        ..dag.clone()
    })
}

/// The exponent of the grid to round to; none where everything stays.
fn exponent(dag: &Dag, precision: Precision) -> Result<Option<i32>> {
    let wanted = match precision {
        Precision::Exact => return Ok(None),
        Precision::Auto if dag.grid.is_some() => return Ok(None),
        Precision::Auto => AUTO_EDGE_BITS - median_edge_exponent(dag),
        Precision::Step(step) if step > 0.0 && step.is_finite() => -floor_log2(step / dag.frame.scale),
        Precision::Step(step) => {
            return Err(Error::argument("precision", format!("must be positive and finite, not {step}")));
        }
    };
    let wanted = wanted.max(0);
    if dag.grid.is_some_and(|grid| grid.exponent <= wanted) {
        return Ok(None);
    }
    let largest = |p: usize| {
        let records = dag.pages.records(p).iter().enumerate();
        let positions = records.flat_map(|(slot, _)| geometry(dag, p, slot).positions.iter()).flatten();
        positions.fold(0f32, |most, x| most.max(x.abs()))
    };
    let largest = (0..dag.pages.table.len()).into_par_iter().map(largest).reduce(|| 0.0, f32::max);
    let fits = |exponent: i32| (largest * 2f32.powi(exponent)).round_ties_even() <= MAX_STEPS as f32;
    // Where f32 itself is coarser in places there is nothing to gain.
    Ok((wanted <= MAX_EXPONENT && fits(wanted)).then_some(wanted))
}

fn geometry(dag: &Dag, page: usize, slot: usize) -> ClusterGeometry<'_> {
    dag.geometry(ClusterAddress::new(page, slot))
}

/// ⌊log2⌋ of a positive number, by its bits: the same on every machine.
fn floor_log2(x: f64) -> i32 {
    (x.to_bits() >> (f64::MANTISSA_DIGITS - 1)) as i32 - (f64::MAX_EXP - 1)
}

/// ⌊log2⌋ of the median edge of the triangles of the source, internal units. An inner edge counts for both its
/// triangles.
fn median_edge_exponent(dag: &Dag) -> i32 {
    // Exponents of f64, halved.
    const BINS: i32 = f64::MAX_EXP / 2;
    let histogram = |p: usize| {
        let mut bins = vec![0u64; 2 * BINS as usize];
        for (slot, _) in dag.pages.records(p).iter().enumerate().filter(|(_, r)| r.level == 0) {
            let geometry = geometry(dag, p, slot);
            for t in 0..geometry.triangles.len() {
                let corners = geometry.corners(t).map(|c| c.map(f64::from));
                for k in 0..3 {
                    let (a, b) = (corners[k], corners[(k + 1) % 3]);
                    let squared: f64 = (0..3).map(|i| (a[i] - b[i]).powi(2)).sum();
                    bins[((floor_log2(squared) >> 1) + BINS) as usize] += 1;
                }
            }
        }
        bins
    };
    let add = |mut a: Vec<u64>, b: Vec<u64>| {
        a.iter_mut().zip(&b).for_each(|(a, b)| *a += b);
        a
    };
    let bins = (0..dag.pages.table.len()).into_par_iter().map(histogram);
    let bins = bins.reduce(|| vec![0; 2 * BINS as usize], add);
    let half = bins.iter().sum::<u64>() / 2;
    let mut count = 0;
    let median = bins.iter().position(|bin| {
        count += bin;
        count > half
    });
    median.map_or(0, |bin| bin as i32 - BINS)
}

/// The nearest point of the grid. Never inlined: LLVM 22 crashes over it in a loop with minima and maxima.
#[inline(never)]
fn snap(p: [f32; 3], grid: Grid) -> [f32; 3] {
    // Adding zero turns −0 into +0, so that equal positions have equal bits.
    p.map(|x| (x * grid.steps()).round_ties_even() * grid.step() + 0.0)
}

/// The square of the largest distance that a vertex of a page moves, internal units, and the boxes of its clusters
/// after.
fn survey(dag: &Dag, page: usize, grid: Grid) -> (f64, Vec<Aabb>) {
    let mut most = 0f64;
    let mut boxes = Vec::new();
    let mut snapped: Vec<[f32; 3]> = Vec::new();
    for slot in 0..dag.pages.table[page].clusters as usize {
        let positions = geometry(dag, page, slot).positions;
        snapped.clear();
        snapped.extend(positions.iter().map(|p| snap(p, grid)));
        for (p, q) in positions.iter().zip(&snapped) {
            let squared = (0..3).map(|k| (f64::from(p[k]) - f64::from(q[k])).powi(2)).sum();
            most = most.max(squared);
        }
        boxes.push(Aabb::of_points(&snapped));
    }
    (most, boxes)
}

/// A page with positions and normals rounded, and bounds made again.
fn round_page(words: &[u32], records: &[ClusterRecord], layout: AttributeLayout, grid: Grid) -> Vec<u32> {
    let mut out: Vec<u32> = bytemuck::cast_slice(records).to_vec();
    for (slot, record) in records.iter().enumerate() {
        let (vertices, triangles) = (usize::from(record.vertex_count), usize::from(record.triangle_count));
        let geometry = ClusterGeometry::new(&words[record.data as usize..], layout, vertices, triangles);
        let positions: Vec<[f32; 3]> = geometry.positions.iter().map(|p| snap(p, grid)).collect();
        let Bounds { center, extent, radius, max_edge, cone } = Bounds::of(&positions, geometry.triangles);
        let data = out.len();
        let record = ClusterRecord { center, radius, extent, cone, max_edge, data: data as u32, ..*record };
        out[slot * RECORD_WORDS..][..RECORD_WORDS].copy_from_slice(bytemuck::cast_slice(&[record]));

        let vertex = |(p, id): (&[f32; 3], u32)| vertex_row(*p, id, grid.step());
        let rows: Vec<VertexRow> = positions.iter().zip(geometry.ids.iter()).map(vertex).collect();
        let packing = Packing::of(&rows, grid.step());
        let streams = layout.streams(vertices, triangles, packing.widths);
        out.resize(data + streams.triangles, 0);
        packing.write(&rows, &mut out[data..]);
        let corners: &[u8] = bytemuck::cast_slice(geometry.triangles);
        out.resize(data + streams.normals, 0);
        bytemuck::cast_slice_mut(&mut out[data + streams.triangles..])[..corners.len()]
            .copy_from_slice(corners);
        out.extend(geometry.normals.iter().map(|normal| {
            let [x, y] = narrow(*normal, grid.normal_bits).map(|t| u32::from(widen(t, grid.normal_bits)));
            x | y << NORMAL_BITS
        }));
        out.extend::<&[u32]>(bytemuck::cast_slice(geometry.colors));
        out.extend::<&[u32]>(bytemuck::cast_slice(geometry.uvs));
    }
    out
}
