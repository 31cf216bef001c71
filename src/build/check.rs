//! Every invariant of a built mesh, verified on the finished layout as culling reads it.

use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::lock_borders::{border_kept, locked_kept};
use crate::error::{Error, Result};
use crate::math::Bounds;
use crate::mesh::edges::Edges;
use crate::mesh::hash;
use crate::model::cluster::NO_GROUP;
use crate::model::rule::{ERROR_STEP, ROOT_ERROR, SOURCE_ERROR};
use crate::model::{ClusterAddress, ClusterRecord, Dag, InterruptCheck, WINDOW_PAGES, Window};

/// What was verified.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheckReport {
    /// Clusters whose bounds, links, errors and streams hold.
    pub clusters: usize,
    /// Groups whose spheres, errors and borders hold.
    pub groups: usize,
    /// Nodes that enclose what is below them.
    pub nodes: usize,
    /// Vertex identities that have one position everywhere.
    pub vertices: usize,
    /// Groups whose boundary was compared before and after simplification.
    pub borders: usize,
}

fn broken(what: String) -> Error {
    Error::Invariant(what)
}

fn ensure(holds: bool, what: impl FnOnce() -> String) -> Result<()> {
    if holds { Ok(()) } else { Err(broken(what())) }
}

/// Verifies a mesh; the error names the first cluster, group or node at fault. Pages that are not in memory are read a window
/// after the other, and do not stay.
pub fn check(dag: &Dag, proceed: InterruptCheck<'_>) -> Result<CheckReport> {
    dag.words().try_for_each(|words| words.load().map(drop))?;
    let seen = Seen::of(dag, proceed)?;
    links(dag, &seen)?;
    nodes(dag)?;
    let borders = borders(dag, &seen, proceed)?;
    Ok(CheckReport {
        clusters: seen.groups.len(),
        groups: dag.groups.len(),
        nodes: dag.nodes.len(),
        vertices: seen.vertices,
        borders,
    })
}

/// What is kept of all pages.
struct Seen {
    /// The group that each cluster names,
    groups: Vec<u32>,
    /// and the one that it was made from.
    refined: Vec<u32>,
    /// For each identity its position as a number, equal for equal positions.
    positions: Vec<u32>,
    /// Identities in use.
    vertices: usize,
}

impl Seen {
    /// Verifies the clusters and groups of each page.
    fn of(dag: &Dag, proceed: InterruptCheck<'_>) -> Result<Self> {
        let (mut groups, mut refined) = (Vec::new(), Vec::new());
        let mut positions = Positions { bits: vec![UNSET; dag.vertex_count as usize], used: 0 };
        let count = dag.pages.table.len();
        for start in (0..count).step_by(WINDOW_PAGES) {
            let pages = start..count.min(start + WINDOW_PAGES);
            let window = dag.pages.window(pages.clone(), proceed)?;
            pages.clone().into_par_iter().try_for_each(|page| {
                (0..window.records(page).len())
                    .try_for_each(|slot| cluster(dag, &window, ClusterAddress::new(page, slot)))?;
                dag.groups_of(page).try_for_each(|g| group(dag, &window, g))
            })?;
            for page in pages {
                groups.extend(window.records(page).iter().map(|record| record.group));
                refined.extend(window.records(page).iter().map(|record| record.refined));
                positions.add(&window, page)?;
            }
        }
        let Positions { bits, used } = positions;
        let positions = hash::first_equal(bytemuck::cast_slice(&bits), 3);
        Ok(Self { groups, refined, positions, vertices: used })
    }
}

/// The bits of no position.
const UNSET: [u32; 3] = [u32::MAX; 3];

/// Each identity's position.
struct Positions {
    bits: Vec<[u32; 3]>,
    used: usize,
}

impl Positions {
    /// An identity has one position everywhere.
    fn add(&mut self, window: &Window<'_>, page: usize) -> Result<()> {
        for slot in 0..window.records(page).len() {
            let at = ClusterAddress::new(page, slot);
            let geometry = window.geometry(at);
            for (id, p) in geometry.ids.iter().zip(geometry.positions.iter()) {
                let bits = p.map(f32::to_bits);
                let Some(known) = self.bits.get_mut(id as usize) else {
                    return Err(broken(format!("cluster {at:?}: identity {id} is out of range")));
                };
                if *known == UNSET {
                    *known = bits;
                    self.used += 1;
                }
                ensure(*known == bits, || format!("cluster {at:?}: identity {id} has two positions"))?;
            }
        }
        Ok(())
    }
}

/// Every cluster is a member of exactly the group it names.
fn links(dag: &Dag, all: &Seen) -> Result<()> {
    let mut seen = vec![false; dag.cluster_count()];
    for (g, group) in dag.groups.iter().enumerate() {
        for at in group.members() {
            let index = dag.pages.dense_index(at);
            ensure(!seen[index], || format!("cluster {at:?} is a member of two groups"))?;
            seen[index] = true;
            ensure(all.groups[index] as usize == g, || {
                format!("cluster {at:?} names group {}, but is a member of {g}", all.groups[index])
            })?;
        }
    }
    match seen.iter().position(|s| !s) {
        Some(index) => Err(broken(format!("cluster number {index} is in no group"))),
        None => Ok(()),
    }
}

fn cluster(dag: &Dag, window: &Window<'_>, at: ClusterAddress) -> Result<()> {
    let record = window.record(at);
    let geometry = window.geometry(at);
    let fail = |what: &str| Err(broken(format!("cluster {at:?}: {what}")));
    if geometry.triangles.is_empty() || geometry.positions.len() < 3 {
        return fail("no triangle");
    }
    if geometry.triangles.iter().flatten().any(|v| v >= record.vertex_count) {
        return fail("a triangle refers to a vertex that does not exist");
    }
    if record.level == 0 && (record.error != SOURCE_ERROR || record.refined != NO_GROUP) {
        return fail("level 0 must carry the source error and no origin");
    }
    if record.level > 0 && !(record.error > 0.0 && record.error.is_finite()) {
        return fail("errors above level 0 must be positive and finite");
    }
    if record.level > 0 {
        let Some(origin) = dag.groups.get(record.refined as usize) else { return fail("no origin") };
        if origin.error != record.error || origin.lod_sphere != record.lod_sphere {
            return fail("error and sphere differ from those of the group that made it");
        }
    }
    bounds(record, &geometry.positions.to_vec(), &geometry.triangles.to_vec()).or_else(fail)
}

/// The stored box and sphere hold the vertices; cone and longest edge are those of the triangles.
fn bounds(
    record: &ClusterRecord,
    positions: &[[f32; 3]],
    triangles: &[[u8; 3]],
) -> std::result::Result<(), &'static str> {
    for p in positions {
        let d: [f64; 3] = std::array::from_fn(|k| f64::from(p[k]) - f64::from(record.center[k]));
        if (0..3).any(|k| d[k].abs() > f64::from(record.extent[k])) {
            return Err("a vertex lies outside the box");
        }
        if (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt() > f64::from(record.radius) {
            return Err("a vertex lies outside the sphere");
        }
    }
    let Bounds { cone, max_edge, .. } = Bounds::of(positions, triangles);
    if (record.cone, record.max_edge) != (cone, max_edge) {
        return Err("the cone or the longest edge is not that of the triangles");
    }
    Ok(())
}

fn group(dag: &Dag, window: &Window<'_>, g: usize) -> Result<()> {
    let group = &dag.groups[g];
    let holds = |c: bool, what: &str| ensure(c, || format!("group {g}: {what}"));
    holds(group.count > 0, "it is empty")?;
    let page = group.first.page();
    let end = group.first.slot() + group.count as usize;
    holds(end <= window.records(page).len(), "it goes on behind its page")?;
    holds(group.error > 0.0, "the error is not positive")?;
    holds(group.error >= group.distance().max(group.attribute_error), "the error is below what cuts state")?;
    for at in group.members() {
        let record = window.record(at);
        holds(group.lod_sphere.contains(&record.lod_sphere), "a member's sphere is not inside the group's")?;
        holds(record.error.max(0.0) * ERROR_STEP <= group.error, "the error is not above a member's")?;
        holds(record.error < group.error, "the error is not strictly above a member's")?;
        holds(record.error >= group.min_own_error, "a member's own error is below the least")?;
        let made = dag.groups.get(record.refined as usize).map_or(0.0, |g| g.bound);
        let rank = dag.groups.get(record.refined as usize).map_or(0.0, |g| g.rank);
        holds(rank <= group.rank, "the rank is below a member's")?;
        let proven = group.error.is_finite() && group.bound.is_finite();
        holds(!proven || made < group.bound, "the bound is not strictly above a member's")?;
        let inside = boxes_nest(group.center, group.extent, record.center, record.extent);
        holds(inside, "a member's box is not inside the group's")?;
    }
    Ok(())
}

/// Boxes by centre and half extents, up to the rounding of one addition.
fn boxes_nest(center: [f32; 3], extent: [f32; 3], inner: [f32; 3], inner_extent: [f32; 3]) -> bool {
    (0..3).all(|k| {
        let reach = (f64::from(inner[k]) - f64::from(center[k])).abs() + f64::from(inner_extent[k]);
        reach <= f64::from(extent[k]) + 4.0 * f64::from(f32::EPSILON)
    })
}

/// Every group is below the root exactly once, and every node encloses all groups below it. (A node need not
/// enclose its child nodes: its bounds are made from the groups, which is tighter.)
fn nodes(dag: &Dag) -> Result<()> {
    let mut reached = vec![false; dag.groups.len()];
    let mut below: Vec<Vec<u32>> = vec![Vec::new(); dag.nodes.len()];
    for (n, node) in dag.nodes.iter().enumerate().rev() {
        let children = node.first..node.first + u32::from(node.count);
        if node.is_leaf == 1 {
            for g in children.clone() {
                let Some(flag) = reached.get_mut(g as usize) else {
                    return Err(broken(format!("node {n}: no group {g}")));
                };
                ensure(!std::mem::replace(flag, true), || format!("group {g} is reached twice"))?;
            }
            below[n].extend(children);
        } else {
            for child in children {
                ensure(child as usize > n && (child as usize) < dag.nodes.len(), || {
                    format!("node {n}: child {child} does not come after its parent")
                })?;
                let groups = std::mem::take(&mut below[child as usize]);
                below[n].extend(groups);
            }
        }
        for g in &below[n] {
            let group = &dag.groups[*g as usize];
            let enclosed = node.lod_sphere.contains(&group.lod_sphere)
                && node.max_parent_error >= group.error * ERROR_STEP
                && node.min_own_error <= group.min_own_error
                && boxes_nest(node.center, node.extent, group.center, group.extent);
            ensure(enclosed, || format!("node {n} does not enclose group {g}"))?;
        }
    }
    match reached.iter().position(|r| !r) {
        Some(g) => Err(broken(format!("group {g} is not in the hierarchy"))),
        None => Ok(()),
    }
}

/// Each group's boundary towards other groups is the same before and after simplification.
///
/// On a grid, points that fell together cannot be told from the two sides of a seam, and what holds of each of them
/// need not hold of both as one. There, boundaries are compared between points of one identity, which are what they
/// were.
fn borders(dag: &Dag, seen: &Seen, proceed: InterruptCheck<'_>) -> Result<usize> {
    let positions = &seen.positions[..];
    let mut identities = vec![0u32; positions.len()];
    positions.iter().for_each(|p| identities[*p as usize] += 1);
    let is_certain = |p: u32| dag.grid.is_none() || identities[p as usize] == 1;
    let outputs = Outputs::of(dag, seen);
    let top = dag.groups.iter().map(|g| g.level).max().unwrap_or(0);
    let mut compared = 0;
    for level in 0..=top {
        // All clusters of this level: those of its groups, and those that were stuck in it.
        let is_of = |at: &ClusterAddress| {
            let index = dag.pages.dense_index(*at);
            let made = dag.groups.get(seen.refined[index] as usize).is_some_and(|g| g.level >= level);
            !made && dag.groups[seen.groups[index] as usize].level >= level
        };
        let clusters = |page: usize| {
            let slots = 0..dag.pages.table[page].clusters as usize;
            slots.map(move |slot| ClusterAddress::new(page, slot)).filter(is_of)
        };
        let mut owner = vec![u32::MAX; positions.len()];
        let mut shared = vec![false; positions.len()];
        let of_level: Vec<usize> =
            (0..dag.pages.table.len()).filter(|page| clusters(*page).next().is_some()).collect();
        for pages in of_level.chunks(WINDOW_PAGES) {
            let window = dag.pages.window(pages.iter().copied(), proceed)?;
            for at in pages.iter().flat_map(|page| clusters(*page)) {
                let group = window.record(at).group;
                for id in window.geometry(at).ids.iter() {
                    let p = positions[id as usize] as usize;
                    if owner[p] != u32::MAX && owner[p] != group {
                        shared[p] = true;
                    }
                    owner[p] = group;
                }
            }
        }
        drop(owner);
        let groups: Vec<usize> = (0..dag.groups.len())
            .filter(|g| dag.groups[*g].level == level && dag.groups[*g].error != ROOT_ERROR)
            .collect();
        compared += groups.len();
        let mut rest = &groups[..];
        while !rest.is_empty() {
            let (own, behind) = rest.split_at(outputs.window(dag, rest));
            rest = behind;
            let before = own.iter().map(|g| dag.groups[*g].first.page());
            let after = own.iter().flat_map(|g| outputs.of_group(*g)).map(|at| at.page());
            let window = dag.pages.window(before.chain(after), proceed)?;
            own.par_iter().try_for_each(|g| {
                let before = corners(&window, dag.groups[*g].members(), positions);
                let after = corners(&window, outputs.of_group(*g).iter().copied(), positions);
                ensure(!after.is_empty(), || {
                    format!("group {g}: has an error, but nothing was made from it")
                })?;
                let mut points: Vec<u32> = before.iter().chain(&after).flatten().copied().collect();
                points.sort_unstable();
                points.dedup();
                let local = |p: u32| points.partition_point(|q| *q < p) as u32;
                let edges =
                    |faces: &[[u32; 3]]| Edges::of(&faces.iter().map(|f| f.map(local)).collect::<Vec<_>>());
                let is_shared =
                    |p: u32| shared[points[p as usize] as usize] && is_certain(points[p as usize]);
                // Nor is it known there what of the boundary was the mesh's own.
                let (before, after) = (edges(&before), edges(&after));
                let kept = match dag.grid {
                    None => border_kept(&before, &after, is_shared),
                    Some(_) => locked_kept(&before, &after, is_shared).is_some(),
                };
                ensure(kept, || format!("group {g}: simplification changed its border to other groups"))
            })?;
        }
    }
    Ok(compared)
}

/// The clusters that were made from each group.
struct Outputs {
    /// Where those of each group begin, and where the last ones end.
    starts: Vec<usize>,
    clusters: Vec<ClusterAddress>,
}

impl Outputs {
    fn of(dag: &Dag, seen: &Seen) -> Self {
        let mut made: Vec<(u32, ClusterAddress)> = seen
            .refined
            .iter()
            .copied()
            .zip(dag.pages.addresses())
            .filter(|(g, _)| (*g as usize) < dag.groups.len())
            .collect();
        made.sort_by_key(|(g, _)| *g);
        let starts = (0..=dag.groups.len()).map(|g| made.partition_point(|(of, _)| (*of as usize) < g));
        Self { starts: starts.collect(), clusters: made.into_iter().map(|(_, at)| at).collect() }
    }

    fn of_group(&self, g: usize) -> &[ClusterAddress] {
        &self.clusters[self.starts[g]..self.starts[g + 1]]
    }

    /// How many of some groups make a window: one at least.
    fn window(&self, dag: &Dag, groups: &[usize]) -> usize {
        let mut pages = FxHashSet::default();
        let fits = |g: &&usize| {
            pages.insert(dag.groups[**g].first.page());
            pages.extend(self.of_group(**g).iter().map(|at| at.page()));
            pages.len() <= WINDOW_PAGES
        };
        groups.iter().take_while(fits).count().max(1)
    }
}

/// The triangles of clusters by position.
fn corners(
    window: &Window<'_>,
    clusters: impl Iterator<Item = ClusterAddress>,
    positions: &[u32],
) -> Vec<[u32; 3]> {
    let of_cluster = |at| {
        let geometry = window.geometry(at);
        geometry
            .triangles
            .iter()
            .map(move |t| t.map(|v| positions[geometry.ids.get(usize::from(v)) as usize]))
    };
    clusters.flat_map(of_cluster).collect()
}
