//! What may not move: vertices shared between groups, by position. The mesh's own border stays free.

use super::store::RoundPositions;

/// For each position of a round, whether clusters of two groups touch it.
pub fn shared_positions(round: &RoundPositions, groups: &[Vec<u32>]) -> Vec<bool> {
    let mut owner = vec![u32::MAX; round.positions.len()];
    let mut shared = vec![false; round.positions.len()];
    for (group, members) in groups.iter().enumerate() {
        for position in members.iter().flat_map(|c| round.of(*c as usize)) {
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

/// Half-edges without an opposite, sorted: each undirected edge (smaller end first) with its forward minus its
/// backward uses, zeros left out. A surface is closed exactly when this is empty.
pub fn boundary(faces: &[[u32; 3]]) -> Vec<(u32, u32, i32)> {
    let mut uses: Vec<(u32, u32, i32)> = Vec::with_capacity(3 * faces.len());
    for [a, b, c] in faces {
        uses.extend([(a, b), (b, c), (c, a)].map(|(a, b)| if a < b { (*a, *b, 1) } else { (*b, *a, -1) }));
    }
    uses.sort_unstable();
    let net = uses.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1));
    net.map(|c| (c[0].0, c[0].1, c.iter().map(|e| e.2).sum::<i32>())).filter(|e| e.2 != 0).collect()
}

/// True when replacing the triangles `before` by `after` (corners by position) opens no crack: every boundary
/// half-edge between locked vertices is unchanged, and where *all* of the boundary is locked, none is added.
pub fn border_kept(before: &[[u32; 3]], after: &[[u32; 3]], locked: impl Fn(u32) -> bool) -> bool {
    let (before, after) = (boundary(before), boundary(after));
    let inner = |e: &&(u32, u32, i32)| locked(e.0) && locked(e.1);
    let kept = before.iter().filter(inner).all(|e| after.binary_search(e).is_ok());
    kept && (after.len() == before.len() || !before.iter().all(|e| inner(&e)))
}
