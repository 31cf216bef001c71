//! The edges of triangles with their uses. Bucketed by the smaller end: buckets are short, so sorting each is
//! cheaper than sorting all.

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

    /// The edges of faces whose corners go by other names.
    pub fn named(faces: &[[u32; 3]], name: impl Fn(u32) -> u32) -> Self {
        let points = faces.iter().flatten().map(|v| name(*v)).max().map_or(0, |v| v as usize + 1);
        let halves_of = |f: &[u32; 3]| {
            let [a, b, c] = f.map(&name);
            [(a, b), (b, c), (c, a)]
        };
        let mut starts = vec![0u32; points + 2];
        // Counted two places ahead, so that filling leaves the starts where they belong.
        faces.iter().flat_map(halves_of).for_each(|(a, b)| starts[a.min(b) as usize + 2] += 1);
        for i in 2..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut halves = vec![0u32; 3 * faces.len()];
        for (a, b) in faces.iter().flat_map(halves_of) {
            let at = &mut starts[a.min(b) as usize + 1];
            halves[*at as usize] = 2 * a.max(b) + u32::from(a > b);
            *at += 1;
        }
        starts.truncate(points + 1);
        sort_buckets(&mut halves, &starts);
        Self { starts, halves }
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

/// Sorts each bucket; large sets of them on all threads.
fn sort_buckets(halves: &mut [u32], starts: &[u32]) {
    if halves.len() < PARALLEL_HALVES {
        let first = starts[0];
        starts
            .windows(2)
            .for_each(|w| halves[(w[0] - first) as usize..(w[1] - first) as usize].sort_unstable());
        return;
    }
    let middle = starts.len() / 2;
    let (a, b) = halves.split_at_mut((starts[middle] - starts[0]) as usize);
    rayon::join(|| sort_buckets(a, &starts[..=middle]), || sort_buckets(b, &starts[middle..]));
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
}
