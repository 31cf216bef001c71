//! Quantizing: positions and UVs on power-of-two grids and normals in few bits, the same for every level, so that
//! files are small. Vertices that clusters share have one position before and one after, so that cuts stay closed.
//! Bounds are computed again from the result. The rounding of positions is stored with the mesh and is part of the
//! error of every cut (`docs/numerics.md`).

use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;

use super::page::MAX_STEPS;
use super::validate;
use crate::error::{Error, Result};
use crate::layout::{GroupSize, Paging, by_first_use, hierarchy, paginate, renamed_rows, spatial_order};
use crate::math::octahedral::{NORMAL_BITS, narrow, widen};
use crate::math::{Aabb, Bounds};
use crate::model::cluster::{NO_GROUP, NO_PAGE, RECORD_WORDS, Streams};
use crate::model::packing::{VertexRow, vertex_row, write_triangles};
use crate::model::rule::ROOT_ERROR;
use crate::model::{
    AttributeLayout, Channel, ClusterAddress, ClusterGeometry, ClusterRecord, Dag, Grid, Group, MemorySink,
    Outline, Packing, PageSink, Pages, UNINTERRUPTED, Words, dependencies,
};

/// Bits of each octahedral coordinate of a normal in files that round: off by a quarter of a degree at most.
pub const STORED_NORMAL_BITS: u32 = 10;
/// By default a step is at most the median edge of the source over 2 to this power.
const AUTO_EDGE_BITS: i32 = 4;
/// And at most its fine detail over 2 to this power: see [`Sizes::fine`].
const AUTO_FINE_BITS: i32 = 3;
/// One in so many triangles of the source may be finer than the fine detail.
pub const FINE_PART: u64 = 200;
/// UVs are multiples of 2 to minus this where 2^24 of them reach: rounded by a sixteenth of a texel of 8192 at most.
pub const STORED_UV_EXPONENT: i32 = 16;
/// The finest grid: coordinates are about 1 at most.
pub const MAX_EXPONENT: i32 = MAX_STEPS.ilog2() as i32;

/// How finely a file keeps positions and normals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Precision {
    /// A sixteenth of the median edge of the source, and an eighth of its fine detail, or less.
    Auto,
    /// As they are.
    Exact,
    /// Steps of so many object units, or less.
    Step(f64),
}

/// A mesh as it is to be stored, page by page.
#[derive(Debug)]
pub struct Rounded<'a> {
    /// The mesh that is rounded.
    dag: &'a Dag,
    /// What comes of it.
    outline: Outline,
    /// Nothing where all stays as it is.
    rounding: Option<Rounding>,
    /// Triangles of the source that have an area, and none on the grid.
    pub flattened: u64,
}

/// What becomes of groups and identities: of fewer bits, more groups go into a page.
#[derive(Debug)]
struct Rounding {
    grid: Grid,
    /// The number that each group has in the mesh.
    order: Vec<u32>,
    /// The number here of each group of the mesh.
    renamed: Vec<u32>,
    /// The identity here of each of the mesh.
    names: Vec<u32>,
}

impl<'a> Rounded<'a> {
    /// Finds the grid and everything but the pages.
    pub fn new(dag: &'a Dag, precision: Precision) -> Result<Self> {
        dag.load_all(UNINTERRUPTED)?;
        // What could not be read is not written.
        validate::structure(dag).map_err(|(kind, what)| Error::Invariant(format!("{kind:?}: {what}")))?;
        let Some(exponent) = exponent(dag, precision)? else {
            let pages = Arc::new(Pages::absent(Arc::clone(&dag.pages.table), dag.layout()));
            let refined = |page| dag.pages.records(page).iter().map(|record| record.refined_page);
            let dependencies = dependencies(dag.pages.table.len(), refined);
            let outline = Outline { mesh: Dag { pages, topology: None, ..dag.clone() }, dependencies };
            return Ok(Self { dag, outline, rounding: None, flattened: 0 });
        };
        let uv_exponent = (dag.layout().uv_sets > 0 && uvs_fit(dag)).then_some(STORED_UV_EXPONENT);
        let mut grid = Grid { exponent, normal_bits: STORED_NORMAL_BITS, uv_exponent, moved: 0.0 };
        let survey = |grid: Grid, names: &[u32]| -> Vec<Surveyed> {
            (0..dag.pages.table.len()).into_par_iter().map(|p| survey(dag, p, grid, names)).collect()
        };
        let names: Vec<u32> = (0..dag.vertex_count).collect();
        let pages = survey(grid, &names);
        let moved = pages.iter().map(|p| p.moved).fold(0.0, f64::max).sqrt();
        let before = dag.grid.map_or(0.0, |grid| grid.moved);
        // The squares and their sum, the root and the product are off by a few units in the last place.
        grid.moved = if moved > 0.0 { before + moved * dag.frame.scale * (1.0 + 1.0e-15) } else { before };
        if moved > 0.0 {
            grid.moved = grid.moved.next_up();
        }

        let (boxes, words) = of_groups(dag, &pages);
        let spatial = spatial_order(dag.groups.iter().map(|group| group.level).zip(boxes.iter().copied()));
        let paginate = |words: &[usize]| {
            paginate(&spatial, |g| {
                let group = &dag.groups[g as usize];
                let source = group.members().map(|at| dag.record(at)).filter(|record| record.level == 0);
                GroupSize {
                    level: group.level,
                    root: group.error == ROOT_ERROR,
                    clusters: group.count,
                    words: words[g as usize] as u32,
                    faces: source.map(|record| u32::from(record.triangle_count)).sum(),
                }
            })
        };
        // As building does: names follow pages, all but.
        let members = |g: &u32| dag.groups[*g as usize].members();
        let by_page = paginate(&words).order;
        let uses = by_page.iter().flat_map(members).flat_map(|at| dag.geometry(at).ids.iter());
        let (names, _) = by_first_use(uses, dag.vertex_count as usize);
        let (_, words) = of_groups(dag, &survey(grid, &names));
        let Paging { table, order, first } = paginate(&words);
        let boxes: Vec<Aabb> = order.iter().map(|g| boxes[*g as usize]).collect();
        let place = |((g, first), bounds): ((&u32, &ClusterAddress), &Aabb)| {
            let (center, extent) = bounds.center_extent();
            Group { first: *first, center, extent, ..dag.groups[*g as usize] }
        };
        let groups: Vec<Group> = order.iter().zip(&first).zip(&boxes).map(place).collect();
        let mut renamed = vec![0; order.len()];
        order.iter().zip(0..).for_each(|(old, new)| renamed[*old as usize] = new);
        let face_ids = dag.face_ids.as_ref().map(|rows| Ok(reordered(dag, &order, rows.load()?)));
        let channels = dag.channels.iter().map(|Channel { info, words }| {
            let rows = renamed_rows(words.load()?, info.width(), &names, dag.vertex_count);
            Ok(Channel { info: info.clone(), words: rows.into() })
        });
        // Rounding keeps the order of numbers: the box of what was rounded is the rounded box.
        let bounds = Aabb { min: snap(dag.bounds.min, grid.step()), max: snap(dag.bounds.max, grid.step()) };
        let mesh = Dag {
            topology: None,
            pages: Arc::new(Pages::absent(table.into(), dag.layout())),
            grid: Some(grid),
            bounds,
            nodes: hierarchy(&groups, &boxes),
            groups: groups.into(),
            channels: channels.collect::<Result<_>>()?,
            face_ids: face_ids.transpose()?,
            ..dag.clone()
        };
        let rounding = Rounding { grid, order, renamed, names };
        let refined = |page| {
            let own = rounding.members(dag, &mesh, page);
            own.map(|at| rounding.renamed(&mesh, dag.record(at).refined).1)
        };
        let dependencies = dependencies(mesh.pages.table.len(), refined);
        let flattened = pages.iter().map(|p| p.flattened).sum();
        Ok(Self { dag, outline: Outline { mesh, dependencies }, rounding: Some(rounding), flattened })
    }

    /// Hands the pages to a sink.
    pub fn store<S: PageSink>(self, sink: S) -> Result<S::Output> {
        let Self { dag, outline, rounding, .. } = self;
        outline.fill(sink, |mesh, page| match &rounding {
            Some(rounding) => rounding.page(dag, mesh, page).into(),
            // All are in memory.
            None => dag.pages.words(page).cloned().unwrap_or_default(),
        })
    }
}

/// `dag` is the mesh that is rounded and `mesh` what comes of it.
impl Rounding {
    /// The clusters of a page, as the mesh addresses them.
    fn members(&self, dag: &Dag, mesh: &Dag, page: usize) -> impl Iterator<Item = ClusterAddress> {
        self.order[mesh.groups_of(page)].iter().flat_map(|g| dag.groups[*g as usize].members())
    }

    /// The number here of a group of the mesh, and the page of its members; [`NO_GROUP`] and [`NO_PAGE`] where there is
    /// none.
    fn renamed(&self, mesh: &Dag, group: u32) -> (u32, u32) {
        let number = self.renamed.get(group as usize);
        number.map_or((NO_GROUP, NO_PAGE), |n| (*n, mesh.groups[*n as usize].first.page() as u32))
    }

    /// A page with positions, normals and UVs rounded, and bounds made again.
    fn page(&self, dag: &Dag, mesh: &Dag, page: usize) -> Vec<u32> {
        let grid = self.grid;
        let mut out = vec![0; mesh.pages.table[page].clusters as usize * RECORD_WORDS];
        for (slot, at) in self.members(dag, mesh, page).enumerate() {
            let (record, geometry) = (dag.record(at), dag.geometry(at));
            let positions: Vec<[f32; 3]> = geometry.positions.iter().map(|p| snap(p, grid.step())).collect();
            let triangles = geometry.triangles.to_vec();
            let Bounds { center, extent, radius, max_edge, cone } = Bounds::of(&positions, &triangles);
            let bounds = ClusterRecord { center, radius, extent, cone, max_edge, ..*record };
            let (group, _) = self.renamed(mesh, record.group);
            let (refined, refined_page) = self.renamed(mesh, record.refined);
            let data = out.len();
            let record = ClusterRecord { data: data as u32, group, refined, refined_page, ..bounds };
            out[slot * RECORD_WORDS..][..RECORD_WORDS].copy_from_slice(bytemuck::cast_slice(&[record]));

            let packed = pack(&positions, &geometry, &self.names, dag.layout(), grid);
            out.resize(data + packed.streams.normals, 0);
            packed.packing.write(&packed.rows, &mut out[data..]);
            write_triangles(&triangles, positions.len(), &mut out[data + packed.streams.triangles..]);
            out.extend(geometry.normals.iter().map(|normal| {
                let [x, y] = narrow(*normal, grid.normal_bits).map(|t| u32::from(widen(t, grid.normal_bits)));
                x | y << NORMAL_BITS
            }));
            out.extend(geometry.colors);
            match grid.uv_step() {
                0.0 => out.extend::<&[u32]>(bytemuck::cast_slice(geometry.uvs)),
                step => out.extend(geometry.uvs.iter().flat_map(|uv| snap(*uv, step).map(f32::to_bits))),
            }
        }
        out
    }
}

/// How a page holds a cluster of which positions were rounded.
struct Packed {
    rows: Vec<VertexRow>,
    packing: Packing,
    streams: Streams,
}

fn pack(
    positions: &[[f32; 3]],
    geometry: &ClusterGeometry<'_>,
    names: &[u32],
    layout: AttributeLayout,
    grid: Grid,
) -> Packed {
    let vertex = |(p, id): (&[f32; 3], u32)| vertex_row(*p, names[id as usize], grid.step());
    let rows: Vec<VertexRow> = positions.iter().zip(geometry.ids.iter()).map(vertex).collect();
    let packing = Packing::of(&rows, grid.step());
    let streams = layout.streams(rows.len(), geometry.triangles.len(), packing.widths);
    Packed { rows, packing, streams }
}

/// The mesh that a file of this precision holds. A mesh on a grid as coarse is returned unchanged.
pub fn quantize(dag: &Dag, precision: Precision) -> Result<Dag> {
    Rounded::new(dag, precision)?.store(MemorySink::default())
}

/// Box and words of each group, of those of the clusters of all pages.
fn of_groups(dag: &Dag, pages: &[Surveyed]) -> (Vec<Aabb>, Vec<usize>) {
    let mut clusters = pages.iter().flat_map(|p| &p.clusters);
    let of_group = |g: &Group| {
        let own = clusters.by_ref().take(g.count as usize);
        own.fold((Aabb::EMPTY, 0), |(bounds, words), (b, w)| (bounds.union(b), words + w))
    };
    dag.groups.iter().map(of_group).unzip()
}

/// Rows of faces where groups come in this order.
fn reordered(dag: &Dag, order: &[u32], rows: &[u32]) -> Words {
    let members = order.iter().flat_map(|g| dag.groups[*g as usize].members());
    let source = members.filter(|at| dag.record(*at).level == 0);
    let rows = source.flat_map(|at| {
        let first = dag.pages.first_face(at);
        &rows[first..first + usize::from(dag.record(at).triangle_count)]
    });
    rows.copied().collect::<Vec<u32>>().into()
}

/// The exponent of the grid to round to; none where everything stays.
fn exponent(dag: &Dag, precision: Precision) -> Result<Option<i32>> {
    let wanted = match precision {
        Precision::Exact => return Ok(None),
        Precision::Auto if dag.grid.is_some() => return Ok(None),
        Precision::Auto => {
            let Sizes { edge, fine } = Sizes::of(dag);
            (AUTO_EDGE_BITS - edge).max(AUTO_FINE_BITS - fine)
        }
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

/// Whether 2^24 steps reach all UVs; where they do not, UVs stay as they are.
fn uvs_fit(dag: &Dag) -> bool {
    let most = MAX_STEPS as f32 * 2f32.powi(-STORED_UV_EXPONENT);
    let fit = |p: usize| {
        let mut slots = 0..dag.pages.table[p].clusters as usize;
        slots.all(|slot| geometry(dag, p, slot).uvs.as_flattened().iter().all(|t| t.abs() <= most))
    };
    (0..dag.pages.table.len()).into_par_iter().all(fit)
}

fn geometry(dag: &Dag, page: usize, slot: usize) -> ClusterGeometry<'_> {
    dag.geometry(ClusterAddress::new(page, slot))
}

/// ⌊log2⌋ of a positive number, by its bits: the same on every machine.
fn floor_log2(x: f64) -> i32 {
    (x.to_bits() >> (f64::MANTISSA_DIGITS - 1)) as i32 - (f64::MAX_EXP - 1)
}

/// How large the triangles of the source are: ⌊log2⌋ of lengths in internal units.
struct Sizes {
    /// The median edge. An inner edge counts for both its triangles.
    edge: i32,
    /// What all but one of [`FINE_PART`] triangles reach: the height over the longest edge, their own or that of a neighbour in
    /// their cluster. A sliver between larger ones is none of what is fine; a strip of a cylinder is.
    fine: i32,
}

impl Sizes {
    // Exponents of f64, halved.
    const BINS: i32 = f64::MAX_EXP / 2;

    fn of(dag: &Dag) -> Self {
        let bins = (0..dag.pages.table.len()).into_par_iter().map(|p| Self::histograms(dag, p));
        let empty = || [(); 2].map(|()| vec![0u64; 2 * Self::BINS as usize]);
        let add = |mut a: [Vec<u64>; 2], b: [Vec<u64>; 2]| {
            a.iter_mut().flatten().zip(b.iter().flatten()).for_each(|(a, b)| *a += b);
            a
        };
        let [edges, heights] = bins.reduce(empty, add);
        Self { edge: Self::reached(&edges, 2), fine: Self::reached(&heights, FINE_PART) }
    }

    /// The bin up to which more than one of `part` lie; 0 where there are none.
    fn reached(bins: &[u64], part: u64) -> i32 {
        let few = bins.iter().sum::<u64>() / part;
        let mut count = 0;
        let bin = bins.iter().position(|bin| {
            count += bin;
            count > few
        });
        bin.map_or(0, |bin| bin as i32 - Self::BINS)
    }

    /// Edges and heights of a page.
    fn histograms(dag: &Dag, p: usize) -> [Vec<u64>; 2] {
        let [mut edges, mut heights] = [(); 2].map(|()| vec![0u64; 2 * Self::BINS as usize]);
        let bin = |squared: f64| ((floor_log2(squared) >> 1) + Self::BINS) as usize;
        // The sides of a cluster with the heights of their triangles.
        let mut sides: Vec<([u8; 2], u8, f64)> = Vec::new();
        for (slot, _) in dag.pages.records(p).iter().enumerate().filter(|(_, r)| r.level == 0) {
            let geometry = geometry(dag, p, slot);
            sides.clear();
            for t in 0..geometry.triangles.len() {
                let corners = geometry.corners(t).map(|c| DVec3::from_array(c.map(f64::from)));
                let [a, b, c] = corners;
                let squared = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
                squared.iter().for_each(|squared| edges[bin(*squared)] += 1);
                let longest = squared.iter().fold(f64::MIN_POSITIVE, |most, x| most.max(*x));
                let height = (b - a).cross(c - a).length_squared() / longest;
                let names = geometry.triangles.get(t);
                for k in 0..3 {
                    let (v, w) = (names[k], names[(k + 1) % 3]);
                    sides.push(([v.min(w), v.max(w)], t as u8, height));
                }
            }
            let mut reached = vec![0f64; geometry.triangles.len()];
            sides.sort_unstable_by_key(|(side, ..)| *side);
            for faces in sides.chunk_by(|a, b| a.0 == b.0) {
                let most = faces.iter().fold(0.0, |most: f64, face| most.max(face.2));
                faces.iter().for_each(|(_, t, _)| {
                    let own = &mut reached[usize::from(*t)];
                    *own = own.max(most);
                });
            }
            reached.iter().filter(|squared| **squared > 0.0).for_each(|squared| heights[bin(*squared)] += 1);
        }
        [edges, heights]
    }
}

/// The nearest point of a grid with such steps, a power of two. Never inlined: LLVM 22 crashes over it in a loop with
/// minima and maxima.
#[inline(never)]
fn snap<const N: usize>(p: [f32; N], step: f32) -> [f32; N] {
    // Adding zero turns −0 into +0, so that equal positions have equal bits.
    p.map(|x| (x / step).round_ties_even() * step + 0.0)
}

/// What a grid makes of a page.
struct Surveyed {
    /// The square of the largest distance that a vertex moves, internal units.
    moved: f64,
    /// See [`Rounded::flattened`].
    flattened: u64,
    /// Of each cluster the box after, and the words that it takes.
    clusters: Vec<(Aabb, usize)>,
}

fn survey(dag: &Dag, page: usize, grid: Grid, names: &[u32]) -> Surveyed {
    let mut out = Surveyed { moved: 0.0, flattened: 0, clusters: Vec::new() };
    let mut snapped: Vec<[f32; 3]> = Vec::new();
    for slot in 0..dag.pages.table[page].clusters as usize {
        let geometry = geometry(dag, page, slot);
        let positions = geometry.positions;
        snapped.clear();
        snapped.extend(positions.iter().map(|p| snap(p, grid.step())));
        for (p, q) in positions.iter().zip(&snapped) {
            let squared = (0..3).map(|k| (f64::from(p[k]) - f64::from(q[k])).powi(2)).sum();
            out.moved = out.moved.max(squared);
        }
        if dag.pages.records(page)[slot].level == 0 {
            let has_area = |corners: [[f32; 3]; 3]| {
                let [a, b, c] = corners.map(|p| DVec3::from_array(p.map(f64::from)));
                (b - a).cross(c - a) != DVec3::ZERO
            };
            let is_flattened = |t: &usize| {
                let after = geometry.triangles.get(*t).map(|v| snapped[usize::from(v)]);
                has_area(geometry.corners(*t)) && !has_area(after)
            };
            out.flattened += (0..geometry.triangles.len()).filter(is_flattened).count() as u64;
        }
        let words = RECORD_WORDS + pack(&snapped, &geometry, names, dag.layout(), grid).streams.end;
        out.clusters.push((Aabb::of_points(&snapped), words));
    }
    out
}
