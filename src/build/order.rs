//! The order of triangles in a cluster: along a spiral, each at an edge of one before, and vertices in the order of their
//! first use. Files code what follows from such an order in next to no bits (`format/page.rs`).

use super::clusterize::ClusterMesh;
use crate::limits::{CLUSTER_MAX_TRIANGLES, CLUSTER_MAX_VERTICES};

/// Orders and rotates the triangles of a cluster so that most begin with an edge of an earlier one, and numbers its
/// vertices by first use. The walk is that of Rossignac, "Edgebreaker", IEEE TVCG 5(1), 1999: turn right where
/// there is a triangle, else left, else return to the last edge that was skipped.
pub fn spiral(mesh: &mut ClusterMesh) {
    let room = Vec::with_capacity(mesh.triangles.len());
    let triangles = std::mem::replace(&mut mesh.triangles, room);
    // Every directed edge by where it starts: where it ends, its triangle and the corner. Counted two places ahead, so
    // that filling leaves the starts where they belong.
    let mut starts = [0u16; CLUSTER_MAX_VERTICES + 2];
    triangles.as_flattened().iter().for_each(|v| starts[usize::from(*v) + 2] += 1);
    for i in 2..starts.len() {
        starts[i] += starts[i - 1];
    }
    let mut edges = [(0u8, 0u8, 0u8); 3 * CLUSTER_MAX_TRIANGLES];
    for (t, corners) in triangles.iter().enumerate() {
        for k in 0..3 {
            let at = &mut starts[usize::from(corners[k]) + 1];
            edges[usize::from(*at)] = (corners[(k + 1) % 3], t as u8, k as u8);
            *at += 1;
        }
    }
    let mut done = [false; CLUSTER_MAX_TRIANGLES];
    let mut gates: Vec<[u8; 2]> = Vec::with_capacity(2 * triangles.len());
    let mut next = 0;
    while mesh.triangles.len() < triangles.len() {
        let across = |[a, b]: [u8; 2]| {
            let [start, end] = [0, 1].map(|k| usize::from(starts[usize::from(a) + k]));
            let mut same = edges[start..end].iter().filter(|e| e.0 == b);
            same.find(|e| !done[usize::from(e.1)]).map(|e| (usize::from(e.1), usize::from(e.2)))
        };
        let found = match gates.pop() {
            Some(gate) => across(gate),
            None => {
                next += done[next..].iter().position(|done| !done).unwrap_or(0);
                let [a, b, c] = triangles[next];
                // All three sides of a first triangle are gates; the other two come below.
                gates.push([b, a]);
                debug_assert!(a != b && b != c);
                Some((next, 0))
            }
        };
        let Some((t, k)) = found else { continue };
        let [a, b, c] = [0, 1, 2].map(|i| triangles[t][(k + i) % 3]);
        done[t] = true;
        mesh.triangles.push([a, b, c]);
        gates.extend([[a, c], [c, b]]);
    }
    let mut local = [u8::MAX; CLUSTER_MAX_VERTICES + 1];
    let mut vertices = Vec::with_capacity(mesh.vertices.len());
    for corner in mesh.triangles.as_flattened_mut() {
        let slot = &mut local[usize::from(*corner)];
        if *slot == u8::MAX {
            *slot = vertices.len() as u8;
            vertices.push(mesh.vertices[usize::from(*corner)]);
        }
        *corner = *slot;
    }
    mesh.vertices = vertices;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_strip_is_walked_from_edge_to_edge() {
        // A band of quads whose triangles come in no good order.
        let quad = |i: u8| [[2 * i, 2 * i + 1, 2 * i + 3], [2 * i, 2 * i + 3, 2 * i + 2]];
        let mut triangles: Vec<[u8; 3]> = (0..20).flat_map(quad).collect();
        triangles.sort_unstable_by_key(|t| t[1].wrapping_mul(37));
        let key = |mesh: &ClusterMesh| {
            let turned = |t: &[u8; 3]| {
                let v = t.map(|v| mesh.vertices[usize::from(v)]);
                let k = (0..3).min_by_key(|k| v[*k]).unwrap();
                [v[k], v[(k + 1) % 3], v[(k + 2) % 3]]
            };
            let mut all: Vec<_> = mesh.triangles.iter().map(turned).collect();
            all.sort_unstable();
            all
        };
        let mut mesh = ClusterMesh { vertices: (100..142).collect(), triangles, material: 0 };
        let before = key(&mesh);
        spiral(&mut mesh);
        assert_eq!(key(&mesh), before);
        let mut used = 0;
        for v in mesh.triangles.as_flattened() {
            assert!(*v <= used);
            used = used.max(v + 1);
        }
        // All but those where the walk turns back to its start begin with an edge of the one before.
        let follow = mesh.triangles.windows(2).filter(|w| {
            let edges = [0, 1, 2].map(|k| [w[0][(k + 1) % 3], w[0][k]]);
            edges.contains(&[w[1][0], w[1][1]])
        });
        assert!(follow.count() >= mesh.triangles.len() - 2);
    }
}
