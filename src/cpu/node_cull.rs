//! Stage 2. Walks the hierarchies of instances, level by level: nodes and groups that the rule of the cut
//! rules out, that are off the screen or that the depth pyramid hides end there.

use std::sync::Arc;

use rayon::prelude::*;

use crate::math::Sphere;
use crate::model::rule::{SOURCE_ERROR, Threshold};
use crate::views::{InstanceView, Occluder, Screen};

/// Nodes per task.
const NODES_PER_TASK: usize = 32;

/// A group whose clusters may be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct CandidateGroup {
    /// Index in the frame's list of instances.
    pub instance: u32,
    /// Group of its mesh.
    pub group: u32,
}

/// What the walk found and cost.
#[derive(Debug, Default)]
pub struct Walk {
    /// Surviving groups in scene order: by instance, then by group.
    pub groups: Vec<CandidateGroup>,
    /// Groups that would survive, but whose pages are not there, in any order.
    pub absent: Vec<CandidateGroup>,
    /// Nodes and groups looked at.
    pub visited: u64,
}

#[derive(Clone, Copy)]
struct Visit {
    instance: u32,
    node: u32,
}

#[derive(Default)]
struct Found {
    nodes: Vec<Visit>,
    groups: Vec<CandidateGroup>,
    absent: Vec<CandidateGroup>,
    visited: u64,
}

/// Walks from the roots of `numbers` (indices in `views`, ascending). A node lives while the largest parent
/// error below it projects above `tau` pixels.
pub fn run(
    numbers: &[u32],
    views: &[InstanceView],
    screen: &Screen,
    tau: f32,
    hzb: Option<&impl Occluder>,
) -> Walk {
    let mut frontier: Vec<Visit> = numbers.iter().map(|&instance| Visit { instance, node: 0 }).collect();
    let mut walk = Walk::default();
    while !frontier.is_empty() {
        let found: Vec<Found> = frontier
            .par_chunks(NODES_PER_TASK)
            .map(|chunk| {
                let mut out = Found::default();
                for &visit in chunk {
                    visit_node(visit, views, screen, tau, hzb, &mut out);
                }
                out
            })
            .collect();
        frontier.clear();
        for mut part in found {
            frontier.append(&mut part.nodes);
            walk.groups.append(&mut part.groups);
            walk.absent.append(&mut part.absent);
            walk.visited += part.visited;
        }
    }
    walk.groups.par_sort_unstable();
    walk
}

fn visit_node(
    visit: Visit,
    views: &[InstanceView],
    screen: &Screen,
    tau: f32,
    hzb: Option<&impl Occluder>,
    out: &mut Found,
) {
    let instance = &views[visit.instance as usize];
    let mesh = &*instance.mesh;
    let threshold = Threshold::View(instance.lod, tau);
    let seen = |center: [f32; 3], extent: [f32; 3]| {
        instance.footprint(screen, center, extent).is_some_and(|f| hzb.is_none_or(|h| !h.hides(&f)))
    };
    // What is too coarse may have to be drawn in place of what is not there.
    let whole = Arc::ptr_eq(&instance.pages, &mesh.pages);
    let in_cut = |sphere: &Sphere, parent_error: f32, own_error: f32| {
        threshold.may_be_in_cut(sphere, parent_error, if whole { own_error } else { SOURCE_ERROR })
    };
    let node = &mesh.nodes[visit.node as usize];
    out.visited += 1;
    if !in_cut(&node.lod_sphere, node.max_parent_error, node.min_own_error) || !seen(node.center, node.extent)
    {
        return;
    }
    let children = node.first..node.first + u32::from(node.count);
    if node.is_leaf == 0 {
        out.nodes.extend(children.map(|node| Visit { instance: visit.instance, node }));
        return;
    }
    for group in children {
        let g = &mesh.groups[group as usize];
        out.visited += 1;
        if in_cut(&g.lod_sphere, g.error, g.min_own_error) && seen(g.center, g.extent) {
            let there = instance.pages.holds(g.first.page());
            let list = if there { &mut out.groups } else { &mut out.absent };
            list.push(CandidateGroup { instance: visit.instance, group });
        }
    }
}
