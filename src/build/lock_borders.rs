//! What may not move: vertices shared between groups, by position. The mesh's own border stays free.

use rustc_hash::FxHashMap;

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

/// Half-edges without an opposite: for each undirected edge (smaller end first), forward minus backward uses,
/// zeros left out. A surface is closed exactly when this is empty.
pub fn boundary(corners: impl Iterator<Item = [u32; 3]>) -> FxHashMap<(u32, u32), i32> {
    let mut net = FxHashMap::default();
    for [a, b, c] in corners {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            if from < to {
                *net.entry((from, to)).or_insert(0) += 1;
            } else {
                *net.entry((to, from)).or_insert(0) -= 1;
            }
        }
    }
    net.retain(|_, n| *n != 0);
    net
}

/// True when replacing the triangles `before` by `after` (corners by position) opens no crack: every boundary
/// half-edge between locked vertices is unchanged, and where *all* of the boundary is locked, none is added.
pub fn border_kept(
    before: impl Iterator<Item = [u32; 3]>,
    after: impl Iterator<Item = [u32; 3]>,
    locked: impl Fn(u32) -> bool,
) -> bool {
    let (before, after) = (boundary(before), boundary(after));
    let inner = |e: &(u32, u32)| locked(e.0) && locked(e.1);
    let kept = before.iter().filter(|(e, _)| inner(e)).all(|(e, n)| after.get(e) == Some(n));
    kept && (after.len() == before.len() || !before.keys().all(inner))
}

/// The part of [`border_kept`] that edge collapses need: they map vertices to vertices and locked ones to
/// themselves, so they map boundary to boundary and can fail only between locked vertices. Much cheaper.
pub fn locked_edges_kept(before: &[[u32; 3]], after: &[[u32; 3]], locked: impl Fn(u32) -> bool) -> bool {
    let edges = |faces: &[[u32; 3]]| {
        let mut edges: Vec<(u32, u32, i32)> = Vec::new();
        for f in faces {
            let l = f.map(&locked);
            for k in 0..3 {
                let (a, b) = (k, (k + 1) % 3);
                if l[a] && l[b] {
                    edges.push(if f[a] < f[b] { (f[a], f[b], 1) } else { (f[b], f[a], -1) });
                }
            }
        }
        edges.sort_unstable();
        let net = edges.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1));
        net.map(|c| (c[0].0, c[0].1, c.iter().map(|e| e.2).sum::<i32>())).collect::<Vec<_>>()
    };
    let after = edges(after);
    edges(before).iter().filter(|e| e.2 != 0).all(|e| after.binary_search(e).is_ok())
}
