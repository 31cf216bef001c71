//! Partition of triangles and of clusters as a graph: of few cut edges, where halving space only looks at places.
//!
//! Nodes that share an edge of the mesh are joined by their shared length. What is connected by no edge (leaves,
//! shells, loose triangles) is joined to what is near: neighbours along a Morton curve that belong to different
//! islands get a link, too light to matter beside an edge, so that parts of several islands are compact.

use super::metis;
use crate::math::{Aabb, morton};

/// Weight of a shared edge against that of a link: a cut never saves an edge to spare links.
const EDGE_WEIGHT: i32 = 260;
const LINK_WEIGHT: i32 = 1;

/// A graph with weights, each edge in both directions.
#[derive(Debug)]
pub struct Graph {
    starts: Vec<i32>,
    neighbours: Vec<i32>,
    weights: Vec<i32>,
}

impl Graph {
    /// Joins nodes at `places` along `edges`; an edge named several times weighs as much more. Islands are linked.
    pub fn new(places: &[[f32; 3]], edges: &[(u32, u32)]) -> Self {
        let weigh = |weight: i32| move |&(a, b): &(u32, u32)| [(a, b, weight), (b, a, weight)];
        let links = links(places, edges);
        let mut all: Vec<(u32, u32, i32)> = edges.iter().flat_map(weigh(EDGE_WEIGHT)).collect();
        all.extend(links.iter().flat_map(weigh(LINK_WEIGHT)));
        all.retain(|(a, b, _)| a != b);
        all.sort_unstable();
        let mut graph = Self { starts: vec![0], neighbours: Vec::new(), weights: Vec::new() };
        for same in all.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
            graph.starts.resize(same[0].0 as usize + 1, graph.neighbours.len() as i32);
            graph.neighbours.push(same[0].1.cast_signed());
            graph.weights.push(same.iter().map(|e| e.2).sum());
        }
        graph.starts.resize(places.len() + 1, graph.neighbours.len() as i32);
        graph
    }

    /// The nodes of each of `count` parts of about equal size, in ascending order. Sizes are what METIS makes of
    /// them: callers with limits split again.
    pub fn parts(&self, count: usize) -> Vec<Vec<u32>> {
        let mut parts = vec![Vec::new(); count];
        let part = metis::partition(&self.starts, &self.neighbours, &self.weights, count);
        part.iter().zip(0..).for_each(|(part, node)| parts[*part as usize].push(node));
        parts.retain(|part| !part.is_empty());
        parts
    }
}

/// Pairs of nodes next to each other along a Morton curve and not connected by edges.
fn links(places: &[[f32; 3]], edges: &[(u32, u32)]) -> Vec<(u32, u32)> {
    let mut islands = Islands((0..places.len() as u32).collect());
    edges.iter().for_each(|(a, b)| islands.join(*a, *b));
    let bounds = Aabb::of_points(places);
    let code = |node: u32| morton::code(places[node as usize], &bounds);
    let mut curve: Vec<(u64, u32)> = (0..places.len() as u32).map(|node| (code(node), node)).collect();
    curve.sort_unstable();
    let near = curve.windows(2).map(|w| (w[0].1, w[1].1));
    near.filter(|(a, b)| islands.of(*a) != islands.of(*b)).collect()
}

/// Sets of connected nodes: each points to another of its set, one to itself.
struct Islands(Vec<u32>);

impl Islands {
    fn of(&mut self, mut node: u32) -> u32 {
        while self.0[node as usize] != node {
            let up = self.0[self.0[node as usize] as usize];
            self.0[node as usize] = up;
            node = up;
        }
        node
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.of(a), self.of(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// Pairs of items that have something in common, given as (what, item); of more than two with the same, each with
/// the next. Sorts what it is given.
pub fn pairs(uses: &mut [(u64, u32)]) -> Vec<(u32, u32)> {
    uses.sort_unstable();
    let same = uses.chunk_by(|a, b| a.0 == b.0);
    same.flat_map(|uses| uses.windows(2).map(|w| (w[0].1, w[1].1))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn islands_are_linked_along_the_curve_alone() {
        // Two pairs and a single node on a line.
        let places = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [9.0, 0.0, 0.0]];
        let graph = Graph::new(&places, &[(0, 1), (2, 3), (3, 2)]);
        assert_eq!(graph.starts, [0, 1, 3, 5, 7, 8]);
        assert_eq!(graph.neighbours, [1, 0, 2, 1, 3, 2, 4, 3]);
        assert_eq!(graph.weights, [260, 260, 1, 1, 520, 520, 1, 1]);
        let parts = graph.parts(2);
        assert_eq!(parts.iter().map(Vec::len).sum::<usize>(), 5);
    }

    #[test]
    fn what_three_share_joins_each_to_the_next() {
        assert_eq!(pairs(&mut [(7, 2), (5, 0), (7, 1), (7, 4)]), [(1, 2), (2, 4)]);
    }
}
