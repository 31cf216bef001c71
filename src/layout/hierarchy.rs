//! The culling hierarchy: a wide tree per level, coarsest level first. Mixing levels in one tree would inflate the
//! bounds. The roots of the trees hang off a chain of nodes, a few of the coarsest at each. Traversal of a distant
//! mesh visits these alone: the node of all finer levels is culled.

use crate::limits::NODE_WIDTH;
use crate::math::{Aabb, Sphere};
use crate::model::rule::ERROR_STEP;
use crate::model::{Group, Node};

/// Roots of levels at a node of the chain.
const LEVELS_PER_NODE: usize = 4;

/// Nodes over groups in their final order, coarsest level first, with the boxes of these.
pub fn hierarchy(groups: &[Group], boxes: &[Aabb]) -> Vec<Node> {
    let top = groups.first().map_or(0, |group| group.level);
    // (range of `groups`, level) of each level.
    let mut levels: Vec<(usize, usize, u32)> = Vec::new();
    for of_level in groups.chunk_by(|a, b| a.level == b.level) {
        let start = levels.last().map_or(0, |level| level.1);
        levels.push((start, start + of_level.len(), of_level[0].level));
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
    ranges
        .iter()
        .zip(&children)
        .map(|(&(start, end, level), &(first, count, is_leaf))| {
            let (center, extent) =
                boxes[start..end].iter().fold(Aabb::EMPTY, |b, c| b.union(c)).center_extent();
            let members = &groups[start..end];
            let spheres: Vec<Sphere> = members.iter().map(|g| g.lod_sphere).collect();
            let largest = members.iter().map(|g| g.error).fold(0.0, f32::max);
            let least = members.iter().map(|g| g.min_own_error).fold(f32::INFINITY, f32::min);
            Node {
                center,
                extent,
                lod_sphere: Sphere::of_spheres(&spheres),
                max_parent_error: largest * ERROR_STEP,
                min_own_error: least,
                first,
                count,
                is_leaf: u16::from(is_leaf),
                level,
            }
        })
        .collect()
}

/// Cuts a range into `parts` (a power of two) by halving.
fn split_range(start: usize, end: usize, parts: usize, emit: &mut impl FnMut(usize, usize)) {
    if parts == 1 || end - start <= 1 {
        if end > start {
            emit(start, end);
        }
        return;
    }
    let middle = start + (end - start) / 2;
    split_range(start, middle, parts / 2, emit);
    split_range(middle, end, parts / 2, emit);
}
