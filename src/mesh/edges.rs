//! The edges of triangles with their uses. Bucketed by the smaller end: buckets are short, so sorting each is
//! cheaper than sorting all.

use std::ops::Range;

use rayon::prelude::*;

/// Half-edges from which on the work is shared between threads.
const PARALLEL_HALVES: usize = 1 << 16;

/// Each undirected edge of a set of triangles once, in the order of its ends.
#[derive(Clone, Debug)]
pub struct Edges {
    /// Where each point's bucket starts in `halves`; one more entry than points.
    starts: Vec<u32>,
    /// Half-edges by their smaller end, sorted: the larger end times two, plus one if it is where they start.
    halves: Vec<u32>,
}

/// An edge and how often faces run along it in either direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Smaller end first.
    pub ends: (u32, u32),
    /// Uses from the smaller to the larger end.
    pub forward: u32,
    /// Uses from the larger to the smaller end.
    pub backward: u32,
}

impl Edge {
    /// Faces at the edge.
    pub fn faces(&self) -> u32 {
        self.forward + self.backward
    }

    /// Uses without an opposite, signed; a surface is closed where this is zero at every edge.
    pub fn open(&self) -> i32 {
        self.forward as i32 - self.backward as i32
    }
}

impl Edges {
    /// The edges of faces over points numbered from 0 and below 2^31. Memory follows the largest number.
    pub fn of(faces: &[[u32; 3]]) -> Self {
        Self::named(faces, |v| v)
    }

    /// The edges of faces whose corners go by other names. Of many faces each thread looks for those edges whose
    /// smaller end lies in its share of the points.
    pub fn named(faces: &[[u32; 3]], name: impl Fn(u32) -> u32 + Sync) -> Self {
        let last = |face: &[u32; 3]| face.iter().map(|v| name(*v)).max();
        if 3 * faces.len() < PARALLEL_HALVES {
            let points = faces.iter().filter_map(last).max().map_or(0, |v| v + 1);
            return Self::within(0..points, faces, name);
        }
        let points = faces.par_iter().filter_map(last).max().map_or(0, |v| v + 1);
        let size = points.div_ceil(rayon::current_num_threads() as u32).max(1);
        let firsts: Vec<u32> = (0..points).step_by(size as usize).collect();
        let share = |first: u32| Self::within(first..(first + size).min(points), faces, &name);
        let mut shares = firsts.into_par_iter().map(share).collect::<Vec<_>>().into_iter();
        let Some(mut all) = shares.next() else { return Self::within(0..0, faces, name) };
        for Self { starts, halves } in shares {
            let before = all.halves.len() as u32;
            all.starts.extend(starts[1..].iter().map(|start| before + start));
            all.halves.extend(halves);
        }
        all
    }

    /// The edges whose smaller end is in a range of points, numbered from there.
    fn within(range: Range<u32>, faces: &[[u32; 3]], name: impl Fn(u32) -> u32) -> Self {
        let points = range.len();
        let halves_of = |face: &[u32; 3]| {
            let [a, b, c] = face.map(&name);
            [(a, b), (b, c), (c, a)].map(|(a, b)| {
                // Far beyond all points where it is below the range.
                let bucket = a.min(b).wrapping_sub(range.start) as usize;
                (bucket, 2 * a.max(b) + u32::from(a > b))
            })
        };
        let halves = || faces.iter().flat_map(halves_of).filter(|(bucket, _)| *bucket < points);
        // Counted two places ahead, so that filling leaves the starts where they belong.
        let mut starts = vec![0u32; points + 2];
        halves().for_each(|(bucket, _)| starts[bucket + 2] += 1);
        for i in 2..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut filled = vec![0u32; starts[points + 1] as usize];
        for (bucket, half) in halves() {
            let at = &mut starts[bucket + 1];
            filled[*at as usize] = half;
            *at += 1;
        }
        starts.truncate(points + 1);
        for bucket in starts.windows(2) {
            filled[bucket[0] as usize..bucket[1] as usize].sort_unstable();
        }
        Self { starts, halves: filled }
    }

    /// The edges whose smaller end is `point`.
    pub fn at(&self, point: u32) -> impl Iterator<Item = Edge> {
        let range = match self.starts.get(point as usize..point as usize + 2) {
            Some(ends) => ends[0] as usize..ends[1] as usize,
            None => 0..0,
        };
        self.halves[range].chunk_by(|x, y| x / 2 == y / 2).map(move |uses| {
            let backward = uses.iter().map(|h| h % 2).sum();
            Edge { ends: (point, uses[0] / 2), forward: uses.len() as u32 - backward, backward }
        })
    }

    /// All edges.
    pub fn iter(&self) -> impl Iterator<Item = Edge> {
        (0..self.points()).flat_map(|point| self.at(point))
    }

    /// One more than the largest point.
    pub fn points(&self) -> u32 {
        self.starts.len() as u32 - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_with_their_uses() {
        let edges = Edges::of(&[[0, 1, 2], [2, 1, 5], [1, 2, 0]]);
        let all: Vec<_> = edges.iter().map(|e| (e.ends, e.forward, e.backward)).collect();
        assert_eq!(all, [((0, 1), 2, 0), ((0, 2), 0, 2), ((1, 2), 2, 1), ((1, 5), 1, 0), ((2, 5), 0, 1)]);
        assert_eq!(Edges::of(&[]).iter().count(), 0);
        assert_eq!(edges.at(17).count(), 0);
    }

    #[test]
    fn many_faces_have_the_same_edges_in_any_number_of_shares() {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % 5_000
        };
        let faces: Vec<[u32; 3]> = (0..PARALLEL_HALVES).map(|_| std::array::from_fn(|_| random())).collect();
        let last = faces.iter().flatten().max().unwrap();
        let whole = Edges::within(0..last + 1, &faces, |v| v);
        for threads in [1, 2, 3, 7] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let shared = pool.install(|| Edges::of(&faces));
            assert_eq!((&shared.starts, &shared.halves), (&whole.starts, &whole.halves));
        }
        assert_eq!(whole.iter().map(|e| e.faces() as usize).sum::<usize>(), 3 * faces.len());
    }
}
