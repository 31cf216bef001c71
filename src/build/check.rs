//! Every invariant of a built mesh, verified on the finished layout as culling reads it.

use rayon::prelude::*;

use super::lock_borders::{border_kept, locked_kept};
use crate::error::{Error, Result};
use crate::math::Bounds;
use crate::mesh::edges::Edges;
use crate::mesh::hash;
use crate::model::cluster::NO_GROUP;
use crate::model::rule::{ERROR_STEP, ROOT_ERROR, SOURCE_ERROR};
use crate::model::{ClusterAddress, ClusterRecord, Dag, UNINTERRUPTED};

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

/// Verifies a mesh; the error names the first cluster, group or node at fault.
pub fn check(dag: &Dag) -> Result<CheckReport> {
    dag.load_all(UNINTERRUPTED)?;
    links(dag)?;
    let addresses: Vec<ClusterAddress> = dag.pages.addresses().collect();
    addresses.par_iter().try_for_each(|at| cluster(dag, *at))?;
    dag.groups.par_iter().enumerate().try_for_each(|(g, _)| group(dag, g))?;
    nodes(dag)?;
    let (positions, vertices) = identities(dag, &addresses)?;
    let borders = borders(dag, &addresses, &positions)?;
    Ok(CheckReport {
        clusters: addresses.len(),
        groups: dag.groups.len(),
        nodes: dag.nodes.len(),
        vertices,
        borders,
    })
}

/// Every cluster is a member of exactly the group it names.
fn links(dag: &Dag) -> Result<()> {
    let mut seen = vec![false; dag.cluster_count()];
    for (g, group) in dag.groups.iter().enumerate() {
        ensure(group.count > 0, || format!("group {g} is empty"))?;
        for at in group.members() {
            let index = dag.pages.dense_index(at);
            ensure(!seen[index], || format!("cluster {at:?} is a member of two groups"))?;
            seen[index] = true;
            ensure(dag.record(at).group as usize == g, || {
                format!("cluster {at:?} names group {}, but is a member of {g}", dag.record(at).group)
            })?;
        }
    }
    match seen.iter().position(|s| !s) {
        Some(index) => Err(broken(format!("cluster number {index} is in no group"))),
        None => Ok(()),
    }
}

fn cluster(dag: &Dag, at: ClusterAddress) -> Result<()> {
    let record = dag.record(at);
    let geometry = dag.geometry(at);
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

fn group(dag: &Dag, g: usize) -> Result<()> {
    let group = &dag.groups[g];
    let holds = |c: bool, what: &str| ensure(c, || format!("group {g}: {what}"));
    holds(group.error > 0.0, "the error is not positive")?;
    holds(group.error >= group.distance().max(group.attribute_error), "the error is below what cuts state")?;
    let stated = group.error >= group.distance().max(group.attribute_error);
    holds(stated, "the error is below what is stated of shape or attributes")?;
    for at in group.members() {
        let record = dag.record(at);
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

/// For each identity its position as a number equal for equal positions; and how many identities are in use.
fn identities(dag: &Dag, addresses: &[ClusterAddress]) -> Result<(Vec<u32>, usize)> {
    let unset = [u32::MAX; 3];
    let mut positions = vec![unset; dag.vertex_count as usize];
    let mut used = 0;
    for at in addresses {
        let geometry = dag.geometry(*at);
        for (id, p) in geometry.ids.iter().zip(geometry.positions.iter()) {
            let bits = p.map(f32::to_bits);
            let Some(known) = positions.get_mut(id as usize) else {
                return Err(broken(format!("cluster {at:?}: identity {id} is out of range")));
            };
            if *known == unset {
                *known = bits;
                used += 1;
            }
            ensure(*known == bits, || format!("cluster {at:?}: identity {id} has two positions"))?;
        }
    }
    Ok((hash::first_equal(bytemuck::cast_slice(&positions), 3), used))
}

/// Each group's boundary towards other groups is the same before and after simplification.
///
/// On a grid, points that fell together cannot be told from the two sides of a seam, and what holds of each of them
/// need not hold of both as one. There, boundaries are compared between points of one identity, which are what they
/// were.
fn borders(dag: &Dag, addresses: &[ClusterAddress], positions: &[u32]) -> Result<usize> {
    let mut identities = vec![0u32; positions.len()];
    positions.iter().for_each(|p| identities[*p as usize] += 1);
    let is_certain = |p: u32| dag.grid.is_none() || identities[p as usize] == 1;
    let level_of = |g: u32| dag.groups[g as usize].level;
    let made: Vec<i64> = addresses
        .iter()
        .map(|at| match dag.record(*at).refined {
            NO_GROUP => -1,
            g => i64::from(level_of(g)),
        })
        .collect();
    let mut outputs = vec![Vec::new(); dag.groups.len()];
    for at in addresses {
        if let Some(list) = outputs.get_mut(dag.record(*at).refined as usize) {
            list.push(*at);
        }
    }
    let top = dag.groups.iter().map(|g| g.level).max().unwrap_or(0);
    let mut compared = 0;
    for level in 0..=top {
        // All clusters of this level: those of its groups, and those that were stuck in it.
        let mut owner = vec![u32::MAX; dag.vertex_count as usize];
        let mut shared = vec![false; dag.vertex_count as usize];
        for (at, made) in addresses.iter().zip(&made) {
            let group = dag.record(*at).group;
            if *made >= i64::from(level) || level_of(group) < level {
                continue;
            }
            for id in dag.geometry(*at).ids.iter() {
                let p = positions[id as usize] as usize;
                if owner[p] != u32::MAX && owner[p] != group {
                    shared[p] = true;
                }
                owner[p] = group;
            }
        }
        let groups: Vec<usize> = (0..dag.groups.len())
            .filter(|g| dag.groups[*g].level == level && dag.groups[*g].error != ROOT_ERROR)
            .collect();
        compared += groups.len();
        groups.par_iter().try_for_each(|g| {
            let before = corners(dag, dag.groups[*g].members(), positions);
            let after = corners(dag, outputs[*g].iter().copied(), positions);
            ensure(!after.is_empty(), || format!("group {g}: has an error, but nothing was made from it"))?;
            let mut points: Vec<u32> = before.iter().chain(&after).flatten().copied().collect();
            points.sort_unstable();
            points.dedup();
            let local = |p: u32| points.partition_point(|q| *q < p) as u32;
            let edges =
                |faces: &[[u32; 3]]| Edges::of(&faces.iter().map(|f| f.map(local)).collect::<Vec<_>>());
            let is_shared = |p: u32| shared[points[p as usize] as usize] && is_certain(points[p as usize]);
            // Nor is it known there what of the boundary was the mesh's own.
            let (before, after) = (edges(&before), edges(&after));
            let kept = match dag.grid {
                None => border_kept(&before, &after, is_shared),
                Some(_) => locked_kept(&before, &after, is_shared).is_some(),
            };
            ensure(kept, || format!("group {g}: simplification changed its border to other groups"))
        })?;
    }
    Ok(compared)
}

/// The triangles of clusters by position.
fn corners(dag: &Dag, clusters: impl Iterator<Item = ClusterAddress>, positions: &[u32]) -> Vec<[u32; 3]> {
    let of_cluster = |at| {
        let geometry = dag.geometry(at);
        geometry
            .triangles
            .iter()
            .map(move |t| t.map(|v| positions[geometry.ids.get(usize::from(v)) as usize]))
    };
    clusters.flat_map(of_cluster).collect()
}
