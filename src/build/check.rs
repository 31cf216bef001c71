//! Every invariant of a built mesh, verified on the finished layout as culling reads it.

use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::bits::Bits;
use super::lock_borders::{border_kept, locked_kept};
use super::slabs::Slabs;
use crate::error::{Error, Result};
use crate::math::Bounds;
use crate::mesh::edges::Edges;
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

/// Verifies a mesh; the error names a cluster, group or node at fault. Pages that are not in memory are read a window after the
/// other, and do not stay. Of all vertices some bits are kept.
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
    /// Identities at whose position there are others.
    doubtful: Bits,
    /// Identities in use.
    vertices: usize,
}

/// The bits of a position behind a number, such as an identity: in one number, so that sorting is fast.
fn behind(number: u32, p: [f32; 3]) -> u128 {
    p.iter().fold(u128::from(number), |key, x| key << 32 | u128::from(x.to_bits()))
}

/// The bits of a position in one number.
fn bits(p: [f32; 3]) -> u128 {
    behind(0, p)
}

impl Seen {
    /// Verifies the clusters and groups of each page.
    fn of(dag: &Dag, proceed: InterruptCheck<'_>) -> Result<Self> {
        let clusters = dag.cluster_count();
        let mut seen = Self {
            groups: vec![0; clusters],
            refined: vec![0; clusters],
            doubtful: Bits::new(dag.vertex_count as usize),
            vertices: 0,
        };
        let counts = |page: usize| (page, dag.pages.table[page].clusters as usize);
        let pages: Vec<(usize, usize)> = (0..dag.pages.table.len()).map(counts).collect();
        let slabs = Slabs::new(dag, &pages);
        let mut known = Bits::new(dag.vertex_count as usize);
        let mut verified = vec![false; pages.len()];
        for slab in 0..slabs.count() {
            let mut keys = Vec::new();
            for pages in slabs.pages(slab).chunks(WINDOW_PAGES) {
                let window = dag.pages.window(pages.iter().copied(), proceed)?;
                let new: Vec<usize> = pages
                    .iter()
                    .copied()
                    .filter(|page| !std::mem::replace(&mut verified[*page], true))
                    .collect();
                new.par_iter().try_for_each(|page| {
                    (0..window.records(*page).len())
                        .try_for_each(|slot| cluster(dag, &window, ClusterAddress::new(*page, slot)))?;
                    dag.groups_of(*page).try_for_each(|g| group(dag, &window, g))
                })?;
                for page in new {
                    for (slot, record) in window.records(page).iter().enumerate() {
                        let index = dag.pages.dense_index(ClusterAddress::new(page, slot));
                        (seen.groups[index], seen.refined[index]) = (record.group, record.refined);
                    }
                }
                for at in pages.iter().flat_map(|page| addresses(dag, *page)) {
                    let geometry = window.geometry(at);
                    for (id, p) in geometry.ids.iter().zip(geometry.positions.iter()) {
                        ensure(id < dag.vertex_count, || {
                            format!("cluster {at:?}: identity {id} is out of range")
                        })?;
                        if slabs.of(p) == slab {
                            keys.push(behind(id, p));
                        }
                    }
                }
            }
            seen.add(keys, &mut known, dag.grid.is_some())?;
        }
        Ok(seen)
    }

    /// An identity has one position everywhere; positions come behind identities.
    fn add(&mut self, mut keys: Vec<u128>, known: &mut Bits, on_grid: bool) -> Result<()> {
        let id = |key: &u128| (key >> 96) as u32;
        keys.par_sort_unstable();
        keys.dedup();
        for key in &keys {
            ensure(known.set(id(key)), || format!("identity {} has two positions", id(key)))?;
        }
        self.vertices += keys.len();
        if on_grid {
            // Positions before identities.
            keys.par_iter_mut().for_each(|key| *key = key.rotate_left(32));
            keys.par_sort_unstable();
            let several = keys.chunk_by(|a, b| a >> 32 == b >> 32).filter(|same| same.len() > 1);
            for key in several.flatten() {
                self.doubtful.set(*key as u32);
            }
        }
        Ok(())
    }
}

/// The clusters of a page.
fn addresses(dag: &Dag, page: usize) -> impl Iterator<Item = ClusterAddress> {
    (0..dag.pages.table[page].clusters as usize).map(move |slot| ClusterAddress::new(page, slot))
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
    let triangles: u32 = group.members().map(|at| u32::from(window.record(at).triangle_count)).sum();
    holds([0, triangles].contains(&u32::from(group.triangles)), "its members do not have its triangles")?;
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
    let outputs = Outputs::of(dag, seen);
    let top = dag.groups.iter().map(|g| g.level).max().unwrap_or(0);
    let mut compared = 0;
    for level in 0..=top {
        let shared = shared(dag, seen, level, proceed)?;
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
                let group = &dag.groups[*g];
                let mut surface = Surface::default();
                let before = surface.add(&window, group.members());
                let after = surface.add(&window, outputs.of_group(*g).iter().copied());
                ensure(!after.is_empty(), || {
                    format!("group {g}: has an error, but nothing was made from it")
                })?;
                ensure(group.triangles == 0 || usize::from(group.made) == after.len(), || {
                    format!("group {g}: {} triangles were made from it, not {}", after.len(), group.made)
                })?;
                let (points, is_shared) = surface.points(&shared, &seen.doubtful);
                let edges = |triangles: &[[u32; 3]]| {
                    Edges::of(&triangles.iter().map(|t| t.map(|v| points[v as usize])).collect::<Vec<_>>())
                };
                // Nor is it known there what of the boundary was the mesh's own.
                let (before, after) = (edges(&before), edges(&after));
                let is_shared = |p: u32| is_shared[p as usize];
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

/// What was made of a group has its positions, but is no group beside others.
const NO_OWNER: u32 = u32::MAX;

/// Identities at positions that several groups of a level have, of the clusters of the level and those that were made of them.
fn shared(dag: &Dag, seen: &Seen, level: u32, proceed: InterruptCheck<'_>) -> Result<Bits> {
    // The clusters of a level are those of its groups, and those that were stuck in it.
    let owner = |at: ClusterAddress| {
        let index = dag.pages.dense_index(at);
        match dag.groups.get(seen.refined[index] as usize).map(|made| made.level) {
            Some(made) if made > level => None,
            Some(made) if made == level => Some(NO_OWNER),
            _ => Some(seen.groups[index]).filter(|g| dag.groups[*g as usize].level >= level),
        }
    };
    let counts = |page: usize| (page, addresses(dag, page).filter(|at| owner(*at).is_some()).count());
    let pages: Vec<_> =
        (0..dag.pages.table.len()).map(counts).filter(|(_, clusters)| *clusters > 0).collect();
    let slabs = Slabs::new(dag, &pages);
    let mut out = Bits::new(dag.vertex_count as usize);
    for slab in 0..slabs.count() {
        let mut corners: Vec<(u128, u32)> = Vec::new();
        for pages in slabs.pages(slab).chunks(WINDOW_PAGES) {
            let window = dag.pages.window(pages.iter().copied(), proceed)?;
            for at in pages.iter().flat_map(|page| addresses(dag, *page)) {
                let Some(owner) = owner(at) else { continue };
                let geometry = window.geometry(at);
                let own = geometry.ids.iter().zip(geometry.positions.iter());
                let own = own.filter(|(_, p)| slabs.of(*p) == slab);
                // Positions before owners.
                corners.extend(own.map(|(id, p)| (behind(owner, p).rotate_left(32), id)));
            }
        }
        corners.par_sort_unstable_by_key(|(key, _)| *key);
        for same in corners.chunk_by(|(a, _), (b, _)| a >> 32 == b >> 32) {
            let mut owners = same.iter().map(|(key, _)| *key as u32);
            let first = owners.next();
            if owners.any(|owner| Some(owner) != first && owner != NO_OWNER) {
                for (_, id) in same {
                    out.set(*id);
                }
            }
        }
    }
    Ok(out)
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

/// The vertices of some clusters: bits of positions, and identities.
#[derive(Default)]
struct Surface(Vec<(u128, u32)>);

impl Surface {
    /// Adds clusters; returns their triangles.
    fn add(&mut self, window: &Window<'_>, clusters: impl Iterator<Item = ClusterAddress>) -> Vec<[u32; 3]> {
        let mut triangles = Vec::new();
        for at in clusters {
            let geometry = window.geometry(at);
            let first = self.0.len() as u32;
            self.0.extend(geometry.positions.iter().map(bits).zip(geometry.ids.iter()));
            triangles.extend(geometry.triangles.iter().map(|t| t.map(|v| first + u32::from(v))));
        }
        triangles
    }

    /// For each vertex the number of its position; and for each position whether one of its identities is shared and none is
    /// doubtful.
    fn points(&self, shared: &Bits, doubtful: &Bits) -> (Vec<u32>, Vec<bool>) {
        let mut order: Vec<u32> = (0..self.0.len() as u32).collect();
        order.sort_unstable_by_key(|v| self.0[*v as usize].0);
        let (mut numbers, mut found) = (vec![0; order.len()], Vec::new());
        for same in order.chunk_by(|a, b| self.0[*a as usize].0 == self.0[*b as usize].0) {
            same.iter().for_each(|v| numbers[*v as usize] = found.len() as u32);
            let mut ids = same.iter().map(|v| self.0[*v as usize].1);
            found.push(ids.clone().any(|id| shared.has(id)) && !ids.any(|id| doubtful.has(id)));
        }
        (numbers, found)
    }
}
