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
use crate::layout::{FirstUse, GroupSize, Paging, hierarchy, paginate, renamed_rows, spatial_order};
use crate::math::octahedral::{NORMAL_BITS, narrow, widen};
use crate::math::{Aabb, Bounds};
use crate::model::cluster::{NO_GROUP, NO_PAGE, RECORD_WORDS, Streams};
use crate::model::packing::{VertexRow, vertex_row, write_triangles};
use crate::model::rule::ROOT_ERROR;
use crate::model::{
    AttributeLayout, Channel, ClusterAddress, ClusterGeometry, ClusterRecord, Dag, Grid, Group,
    InterruptCheck, MemorySink, Outline, Packing, PageEntry, PageSink, Pages, UNINTERRUPTED, WINDOW_PAGES,
    Window, Words, dependencies,
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

/// A mesh as it is to be stored, page by page: of its pages no more are in memory than somebody looks at.
pub struct Rounded<'a> {
    /// The mesh that is rounded.
    dag: &'a Dag,
    /// Whether to go on reading it.
    proceed: InterruptCheck<'a>,
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
    pub fn new(dag: &'a Dag, precision: Precision, proceed: InterruptCheck<'a>) -> Result<Self> {
        dag.words().try_for_each(|words| words.load().map(drop))?;
        // What could not be read is not written.
        let fault = |(kind, what)| Error::Invariant(format!("{kind:?}: {what}"));
        validate::all_but_pages(dag).map_err(fault)?;
        let pages = Pass { dag, proceed };
        let seen = pages.each(|window, p| {
            validate::page(dag, p, window.page(p)).map_err(fault)?;
            Ok(Seen::of(window, p))
        })?;
        let measures = Measures::of(&seen);
        let clusters: Vec<Clustered> = seen.into_iter().flat_map(|page| page.clusters).collect();
        let of_page =
            |entry: &PageEntry| &clusters[entry.first_cluster as usize..][..entry.clusters as usize];
        let Some(exponent) = exponent(dag, precision, &measures)? else {
            let pages = Arc::new(Pages::absent(Arc::clone(&dag.pages.table), dag.layout()));
            let page_of = |refined: u32| dag.groups.get(refined as usize).map(|g| g.first.page() as u32);
            let refined = |page: usize| {
                let own = of_page(&dag.pages.table[page]).iter();
                own.map(|cluster| page_of(cluster.refined).unwrap_or(NO_PAGE))
            };
            let dependencies = dependencies(dag.pages.table.len(), refined);
            let outline = Outline { mesh: Dag { pages, topology: None, ..dag.clone() }, dependencies };
            return Ok(Self { dag, proceed, outline, rounding: None, flattened: 0 });
        };
        let uv_exponent = (dag.layout().uv_sets > 0 && measures.uvs_fit()).then_some(STORED_UV_EXPONENT);
        let mut grid = Grid { exponent, normal_bits: STORED_NORMAL_BITS, uv_exponent, moved: 0.0 };
        let survey =
            |grid: Grid, names: &[u32]| pages.each(|window, p| Ok(survey(dag, window, p, grid, names)));
        let names: Vec<u32> = (0..dag.vertex_count).collect();
        let surveyed = survey(grid, &names)?;
        let moved = surveyed.iter().map(|p| p.moved).fold(0.0, f64::max).sqrt();
        let before = dag.grid.map_or(0.0, |grid| grid.moved);
        // The squares and their sum, the root and the product are off by a few units in the last place.
        grid.moved = if moved > 0.0 { before + moved * dag.frame.scale * (1.0 + 1.0e-15) } else { before };
        if moved > 0.0 {
            grid.moved = grid.moved.next_up();
        }

        let (boxes, words) = of_groups(dag, &surveyed);
        let spatial = spatial_order(dag.groups.iter().map(|group| group.level).zip(boxes.iter().copied()));
        let members_of = |g: &u32| {
            let group = &dag.groups[*g as usize];
            let first = dag.pages.dense_index(group.first);
            first..first + group.count as usize
        };
        let paginate = |words: &[usize]| {
            paginate(&spatial, |g| {
                let group = &dag.groups[g as usize];
                GroupSize {
                    level: group.level,
                    root: group.error == ROOT_ERROR,
                    clusters: group.count,
                    words: words[g as usize] as u32,
                    faces: clusters[members_of(&g)].iter().map(|cluster| u32::from(cluster.faces)).sum(),
                }
            })
        };
        // As building does: names follow pages, all but.
        let by_page = paginate(&words).order;
        let names = pages.names(&by_page)?;
        let (_, words) = of_groups(dag, &survey(grid, &names)?);
        let Paging { table, order, first } = paginate(&words);
        let boxes: Vec<Aabb> = order.iter().map(|g| boxes[*g as usize]).collect();
        let place = |((g, first), bounds): ((&u32, &ClusterAddress), &Aabb)| {
            let (center, extent) = bounds.center_extent();
            Group { first: *first, center, extent, ..dag.groups[*g as usize] }
        };
        let groups: Vec<Group> = order.iter().zip(&first).zip(&boxes).map(place).collect();
        let mut renamed = vec![0; order.len()];
        order.iter().zip(0..).for_each(|(old, new)| renamed[*old as usize] = new);
        let reordered = |rows: &Words| {
            let starts = starts(clusters.iter().map(|cluster| usize::from(cluster.faces)));
            let rows = rows.load()?;
            let own = order.iter().flat_map(members_of).flat_map(|c| &rows[starts[c]..starts[c + 1]]);
            Ok(own.copied().collect::<Vec<u32>>().into())
        };
        let face_ids = dag.face_ids.as_ref().map(reordered).transpose()?;
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
            face_ids,
            ..dag.clone()
        };
        let rounding = Rounding { grid, order, renamed, names };
        let refined = |page| {
            let own = rounding.order[mesh.groups_of(page)].iter().flat_map(members_of);
            own.map(|cluster| rounding.renamed(&mesh, clusters[cluster].refined).1)
        };
        let dependencies = dependencies(mesh.pages.table.len(), refined);
        let flattened = surveyed.iter().map(|p| p.flattened).sum();
        let outline = Outline { mesh, dependencies };
        Ok(Self { dag, proceed, outline, rounding: Some(rounding), flattened })
    }

    /// Hands the pages to a sink.
    pub fn store<S: PageSink>(self, sink: S) -> Result<S::Output> {
        let Self { dag, proceed, outline, rounding, .. } = self;
        outline.fill(sink, |mesh, pages| {
            let Some(rounding) = &rounding else {
                let window = dag.pages.window(pages.clone(), proceed)?;
                return Ok(pages.map(|page| window.words(page)).collect());
            };
            let members = pages.clone().flat_map(|page| rounding.members(dag, mesh, page));
            let window = dag.pages.window(members.map(|at| at.page()), proceed)?;
            let page = |page| rounding.page(dag, &window, mesh, page).into();
            Ok(pages.into_par_iter().map(page).collect())
        })
    }
}

/// Goes through the pages of a mesh, a window after the other.
#[derive(Clone, Copy)]
struct Pass<'a> {
    dag: &'a Dag,
    proceed: InterruptCheck<'a>,
}

impl Pass<'_> {
    /// What something makes of each page, in parallel.
    fn each<T: Send>(&self, of: impl Fn(&Window<'_>, usize) -> Result<T> + Sync) -> Result<Vec<T>> {
        let count = self.dag.pages.table.len();
        let mut out = Vec::with_capacity(count);
        for start in (0..count).step_by(WINDOW_PAGES) {
            let pages = start..count.min(start + WINDOW_PAGES);
            let window = self.dag.pages.window(pages.clone(), self.proceed)?;
            let made: Result<Vec<T>> = pages.into_par_iter().map(|page| of(&window, page)).collect();
            out.extend(made?);
        }
        Ok(out)
    }

    /// New numbers for identities, by their first use where groups come in this order.
    fn names(&self, order: &[u32]) -> Result<Vec<u32>> {
        let mut names = FirstUse::new(self.dag.vertex_count as usize);
        let group = |g: &u32| &self.dag.groups[*g as usize];
        // Neighbours mostly lie in one page.
        for groups in order.chunks(WINDOW_PAGES) {
            let pages = groups.iter().map(|g| group(g).first.page());
            let window = self.dag.pages.window(pages, self.proceed)?;
            let members = groups.iter().flat_map(|g| group(g).members());
            members.for_each(|at| window.geometry(at).ids.iter().for_each(|id| names.add(id)));
        }
        Ok(names.finish().0)
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
    fn page(&self, dag: &Dag, window: &Window<'_>, mesh: &Dag, page: usize) -> Vec<u32> {
        let grid = self.grid;
        let mut out = vec![0; mesh.pages.table[page].clusters as usize * RECORD_WORDS];
        for (slot, at) in self.members(dag, mesh, page).enumerate() {
            let (record, geometry) = (window.record(at), window.geometry(at));
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
    Rounded::new(dag, precision, UNINTERRUPTED)?.store(MemorySink::default())
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

/// Where each of some things starts that lie one behind the other; and where the last one ends.
fn starts(lengths: impl Iterator<Item = usize>) -> Vec<usize> {
    let ends = lengths.scan(0, |end, length| {
        *end += length;
        Some(*end)
    });
    std::iter::once(0).chain(ends).collect()
}

/// The exponent of the grid to round to; none where everything stays.
fn exponent(dag: &Dag, precision: Precision, measures: &Measures) -> Result<Option<i32>> {
    let wanted = match precision {
        Precision::Exact => return Ok(None),
        Precision::Auto if dag.grid.is_some() => return Ok(None),
        Precision::Auto => (AUTO_EDGE_BITS - measures.edge).max(AUTO_FINE_BITS - measures.fine),
        Precision::Step(step) if step > 0.0 && step.is_finite() => -floor_log2(step / dag.frame.scale),
        Precision::Step(step) => {
            return Err(Error::argument("precision", format!("must be positive and finite, not {step}")));
        }
    };
    let wanted = wanted.max(0);
    if dag.grid.is_some_and(|grid| grid.exponent <= wanted) {
        return Ok(None);
    }
    let steps = (measures.largest * 2f32.powi(wanted)).round_ties_even();
    // Where f32 itself is coarser in places there is nothing to gain.
    Ok((wanted <= MAX_EXPONENT && steps <= MAX_STEPS as f32).then_some(wanted))
}

/// ⌊log2⌋ of a positive number, by its bits: the same on every machine.
fn floor_log2(x: f64) -> i32 {
    (x.to_bits() >> (f64::MANTISSA_DIGITS - 1)) as i32 - (f64::MAX_EXP - 1)
}

/// What is to be known of a cluster without its page.
#[derive(Clone, Copy, Debug)]
struct Clustered {
    /// The group that it was made from.
    refined: u32,
    /// Triangles of the source.
    faces: u8,
}

/// What a page holds.
struct Seen {
    clusters: Vec<Clustered>,
    /// How many edges, and heights, have which ⌊log2⌋, less [`Seen::LEAST`]: those that there are.
    bins: [Vec<(u16, u32)>; 2],
    /// Coordinates of positions.
    largest: f32,
    /// Coordinates of UVs.
    largest_uv: f32,
}

impl Seen {
    /// Exponents of f64, halved: zero has the least.
    const LEAST: i32 = -(f64::MAX_EXP / 2);
    const BINS: usize = f64::MAX_EXP as usize;

    fn of(window: &Window<'_>, page: usize) -> Self {
        let mut out = Self { clusters: Vec::new(), bins: Default::default(), largest: 0.0, largest_uv: 0.0 };
        let [mut edges, mut heights] = [[0u32; Self::BINS]; 2];
        let bin = |squared: f64| ((floor_log2(squared) >> 1) - Self::LEAST) as usize;
        // The sides of a cluster with the heights of their triangles.
        let mut sides: Vec<([u8; 2], u8, f64)> = Vec::new();
        for (slot, record) in window.records(page).iter().enumerate() {
            let geometry = window.geometry(ClusterAddress::new(page, slot));
            let largest = |most: f32, values: &mut dyn Iterator<Item = f32>| {
                values.fold(most, |most, x| most.max(x.abs()))
            };
            out.largest = largest(out.largest, &mut geometry.positions.iter().flatten());
            out.largest_uv = largest(out.largest_uv, &mut geometry.uvs.as_flattened().iter().copied());
            let faces = if record.level == 0 { record.triangle_count } else { 0 };
            out.clusters.push(Clustered { refined: record.refined, faces });
            if record.level > 0 {
                continue;
            }
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
        out.bins = [edges, heights].map(|bins| (0..).zip(bins).filter(|(_, count)| *count > 0).collect());
        out
    }
}

/// How large things are in a mesh.
struct Measures {
    /// The median edge of the source, as ⌊log2⌋ of internal units. An inner edge counts for both its triangles.
    edge: i32,
    /// What all but one of [`FINE_PART`] triangles reach, likewise: the height over the longest edge, their own or that of a
    /// neighbour in their cluster. A sliver between larger ones is none of what is fine; a strip of a cylinder is.
    fine: i32,
    /// The largest coordinate of a position.
    largest: f32,
    /// The same of UVs.
    largest_uv: f32,
}

impl Measures {
    fn of(pages: &[Seen]) -> Self {
        let [edge, fine] = [(0, 2), (1, FINE_PART)].map(|(of, part)| {
            let mut bins = [0u64; Seen::BINS];
            let counted = pages.iter().flat_map(|page| &page.bins[of]);
            counted.for_each(|(bin, count)| bins[usize::from(*bin)] += u64::from(*count));
            Self::reached(&bins, part)
        });
        let most = |of: fn(&Seen) -> f32| pages.iter().map(of).fold(0.0, f32::max);
        Self { edge, fine, largest: most(|page| page.largest), largest_uv: most(|page| page.largest_uv) }
    }

    /// The bin up to which more than one of `part` lie; 0 where there are none.
    fn reached(bins: &[u64], part: u64) -> i32 {
        let few = bins.iter().sum::<u64>() / part;
        let mut count = 0;
        let bin = bins.iter().position(|bin| {
            count += bin;
            count > few
        });
        bin.map_or(0, |bin| bin as i32 + Seen::LEAST)
    }

    /// Whether 2^24 steps reach all UVs; where they do not, UVs stay as they are.
    fn uvs_fit(&self) -> bool {
        self.largest_uv <= MAX_STEPS as f32 * 2f32.powi(-STORED_UV_EXPONENT)
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

fn survey(dag: &Dag, window: &Window<'_>, page: usize, grid: Grid, names: &[u32]) -> Surveyed {
    let mut out = Surveyed { moved: 0.0, flattened: 0, clusters: Vec::new() };
    let mut snapped: Vec<[f32; 3]> = Vec::new();
    for slot in 0..dag.pages.table[page].clusters as usize {
        let geometry = window.geometry(ClusterAddress::new(page, slot));
        let positions = geometry.positions;
        snapped.clear();
        snapped.extend(positions.iter().map(|p| snap(p, grid.step())));
        for (p, q) in positions.iter().zip(&snapped) {
            let squared = (0..3).map(|k| (f64::from(p[k]) - f64::from(q[k])).powi(2)).sum();
            out.moved = out.moved.max(squared);
        }
        if window.records(page)[slot].level == 0 {
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
