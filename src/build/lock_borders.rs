//! Locking the borders of groups: vertices that several groups share may not move. The mesh's own border stays
//! free.

use super::store::LevelPositions;
use crate::mesh::edges::{Edge, Edges};

/// For each position of a level, whether clusters of two groups touch it.
pub fn shared_positions(level: &LevelPositions, groups: &[Vec<u32>]) -> Vec<bool> {
    let mut owner = vec![u32::MAX; level.positions.len()];
    let mut shared = vec![false; level.positions.len()];
    for (group, members) in groups.iter().enumerate() {
        for position in members.iter().flat_map(|c| level.of(*c as usize)) {
            let owner = &mut owner[*position as usize];
            if *owner == u32::MAX {
                *owner = group as u32;
            } else if *owner != group as u32 {
                shared[*position as usize] = true;
            }
        }
    }
    shared
}

/// True when replacing triangles with the edges `before` by ones with the edges `after` (points numbered alike)
/// opens no crack: every boundary half-edge between locked points is unchanged, and where *all* of the boundary
/// is locked, none is added.
pub fn border_kept(before: &Edges, after: &Edges, locked: impl Fn(u32) -> bool) -> bool {
    let open = |edges: &Edges| edges.iter().filter(|e| e.open() != 0).count();
    let inner = locked_kept(before, after, locked);
    inner.is_some_and(|inner| inner < open(before) || open(after) == inner)
}

/// The number of boundary half-edges between locked points, if all of them are unchanged.
pub fn locked_kept(before: &Edges, after: &Edges, locked: impl Fn(u32) -> bool) -> Option<usize> {
    let between = |e: &Edge| e.open() != 0 && locked(e.ends.0) && locked(e.ends.1);
    let same = |edge: &Edge| after.at(edge.ends.0).any(|e| e.ends == edge.ends && e.open() == edge.open());
    before.iter().filter(between).try_fold(0, |count, edge| same(&edge).then_some(count + 1))
}
