//! The culling hierarchy and, with it, the order of groups: a wide tree per level, coarsest level first. Mixing levels in
//! one tree would inflate the bounds. Their roots hang off a chain of nodes, a few of the coarsest at each: of a distant
//! mesh only these are looked at, and all finer ones fall with the node of the rest.

use super::clusterize::{Place, median_split};
use super::dag::BuildGroup;
use crate::limits::NODE_WIDTH;
use crate::math::{Aabb, Sphere};
use crate::model::Node;
use crate::model::rule::ERROR_STEP;

/// Roots of levels at a node of the chain.
const LEVELS_PER_NODE: usize = 4;

/// Nodes, and the groups in the order in which the leaves refer to them.
pub fn build(groups: &[BuildGroup], boxes: &[Aabb]) -> (Vec<Node>, Vec<u32>) {
    let top = groups.iter().map(|g| g.level).max().unwrap_or(0);
    let mut order = Vec::with_capacity(groups.len());
    // (range of `order`, level) of each level.
    let mut levels: Vec<(usize, usize, u32)> = Vec::new();
    for level in (0..=top).rev() {
        let of_level = (0..groups.len()).filter(|g| groups[*g].level == level);
        let place = |g: usize| Place { point: boxes[g].center(), number: g as u32 };
        let mut of_level: Vec<Place> = of_level.map(place).collect();
        if of_level.is_empty() {
            continue;
        }
        let start = order.len();
        sort_spatially(&mut of_level);
        order.extend(of_level.iter().map(|g| g.number));
        levels.push((start, order.len(), level));
    }
    // Breadth first: the same of nodes, whose children are not laid out yet.
    let mut ranges: Vec<(usize, usize, u32)> = vec![(0, groups.len(), top)];
    let mut children: Vec<(u32, u16, bool)> = Vec::new();
    // The end of the chain, and the levels that it still has to hold.
    let (mut link, mut rest) = (0, &levels[..]);
    let mut node = 0;
    while node < ranges.len() {
        let (start, end, level) = ranges[node];
        if node == link && !rest.is_empty() {
            let first = ranges.len();
            let own = if rest.len() <= LEVELS_PER_NODE + 1 { rest.len() } else { LEVELS_PER_NODE };
            ranges.extend(&rest[..own]);
            rest = &rest[own..];
            if let Some((start, _, level)) = rest.first() {
                link = ranges.len();
                ranges.push((*start, groups.len(), *level));
            }
            children.push((first as u32, (ranges.len() - first) as u16, false));
        } else if end - start <= NODE_WIDTH {
            children.push((start as u32, (end - start) as u16, true));
        } else {
            let first = ranges.len();
            split_range(start, end, NODE_WIDTH, &mut |a, b| ranges.push((a, b, level)));
            children.push((first as u32, (ranges.len() - first) as u16, false));
        }
        node += 1;
    }
    let nodes = ranges
        .iter()
        .zip(&children)
        .map(|(&(start, end, level), &(first, count, is_leaf))| {
            let members = &order[start..end];
            let bounds = members.iter().fold(Aabb::EMPTY, |b, g| b.union(&boxes[*g as usize]));
            let (center, extent) = bounds.center_extent();
            let spheres: Vec<Sphere> = members.iter().map(|g| groups[*g as usize].lod_sphere).collect();
            let largest = members.iter().map(|g| groups[*g as usize].error).fold(0.0, f32::max);
            Node {
                center,
                extent,
                lod_sphere: Sphere::of_spheres(&spheres),
                max_parent_error: largest * ERROR_STEP,
                first,
                count,
                is_leaf: u16::from(is_leaf),
                level,
            }
        })
        .collect();
    (nodes, order)
}

/// Orders groups so that the ranges made by [`split_range`] are compact: medians along the longest axis.
fn sort_spatially(groups: &mut [Place]) {
    if groups.len() <= NODE_WIDTH {
        groups.sort_unstable_by_key(|g| g.number);
        return;
    }
    let middle = split_middle(0, groups.len(), NODE_WIDTH);
    let (a, b) = median_split(groups, middle);
    // A range is cut into NODE_WIDTH parts by three halvings, then each part again: every cut is a halving.
    sort_spatially(a);
    sort_spatially(b);
}

fn split_middle(start: usize, end: usize, parts: usize) -> usize {
    debug_assert!(parts >= 2);
    start + (end - start) / 2
}

/// Cuts a range into `parts` (a power of two) by halving.
fn split_range(start: usize, end: usize, parts: usize, emit: &mut impl FnMut(usize, usize)) {
    if parts == 1 || end - start <= 1 {
        if end > start {
            emit(start, end);
        }
        return;
    }
    let middle = split_middle(start, end, parts);
    split_range(start, middle, parts / 2, emit);
    split_range(middle, end, parts / 2, emit);
}
