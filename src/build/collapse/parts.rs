//! Parts that hang together, and what it costs to leave one out: the squared distance of its surface from what else is
//! there, in the same measure as the cost of a collapse, shared out to the pairs of triangles that go with it. So parts
//! compete with collapses, and a small one goes when that is cheaper than to coarsen others.

use glam::DVec3;

use super::surface::{NONE, Surface};
use super::wedges::squared_distance;

/// A part of no more faces may go as a whole; larger ones collapse first.
const MOST_FACES: u32 = 64;
/// Places at which the distance of a part is looked up.
const SAMPLES: usize = 16;
/// The same with what it stands for besides: parts that went before it.
const MOST_SAMPLES: usize = 48;

/// A part.
#[derive(Debug)]
pub struct Part {
    /// Faces that it had at first, also those that are gone.
    pub faces: Vec<u32>,
    /// Number of those that are left.
    pub alive: u32,
    /// It holds a locked point, and stays.
    pub locked: bool,
    /// Places of it, and of parts that went and were nearest to it, and the area that each stands for.
    samples: Vec<(DVec3, f64)>,
}

/// All parts of a surface.
#[derive(Debug, Default)]
pub struct Parts {
    /// Each of them.
    pub all: Vec<Part>,
    /// The part of each point.
    pub of_point: Vec<u32>,
    tree: Tree,
}

/// Faces of a leaf of the tree.
const LEAF: usize = 8;
/// The tree is made again when so much of the faces is left that it was made of: those that stay have grown.
const STALE: f64 = 0.7;
/// Boxes are larger by this part of the longest side of their faces, for what moves meanwhile.
const GROWTH: f64 = 0.5;

/// Boxes around faces, halved at medians; the children of a node lie one after the other.
#[derive(Debug, Default)]
struct Tree {
    nodes: Vec<Node>,
    faces: Vec<u32>,
    /// Faces that were there when it was made.
    alive: usize,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// The first child, or of a leaf the first face and their number.
    first: u32,
    count: u32,
}

impl Tree {
    fn of(surface: &Surface) -> Self {
        let faces: Vec<u32> =
            (0..surface.faces.len() as u32).filter(|f| surface.faces[*f as usize].alive()).collect();
        let mut new = Self { nodes: Vec::new(), alive: surface.alive, faces };
        let boxes = |f: u32| {
            let [a, b, c] = surface.faces[f as usize].points.map(|p| surface.positions[p as usize]);
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            let more = DVec3::splat(GROWTH * longest);
            (a.min(b).min(c) - more, a.max(b).max(c) + more)
        };
        let mut order = std::mem::take(&mut new.faces);
        new.nodes.push(Node { low: DVec3::ZERO, high: DVec3::ZERO, first: 0, count: 0 });
        let mut todo = vec![(0usize, 0usize, order.len())];
        while let Some((node, from, to)) = todo.pop() {
            let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
            for f in &order[from..to] {
                let (l, h) = boxes(*f);
                (low, high) = (low.min(l), high.max(h));
            }
            if to - from <= LEAF {
                new.nodes[node] = Node { low, high, first: from as u32, count: (to - from) as u32 };
                continue;
            }
            let size = high - low;
            let axis = (0..3).fold(0, |best, k| if size[k] > size[best] { k } else { best });
            let middle = (from + to) / 2;
            let center = |f: &u32| {
                let (l, h) = boxes(*f);
                l[axis] + h[axis]
            };
            order[from..to]
                .select_nth_unstable_by(middle - from, |f, g| center(f).total_cmp(&center(g)).then(f.cmp(g)));
            let first = new.nodes.len();
            new.nodes[node] = Node { low, high, first: first as u32, count: 0 };
            new.nodes.extend([new.nodes[node]; 2]);
            todo.extend([(first, from, middle), (first + 1, middle, to)]);
        }
        new.faces = order;
        new
    }

    /// The squared distance of a place from the faces that count, and the nearest.
    fn nearest(&self, surface: &Surface, p: DVec3, counts: impl Fn(u32) -> bool) -> Option<(f64, u32)> {
        let mut best = (f64::INFINITY, NONE);
        let to = |node: &Node| p.distance_squared(p.clamp(node.low, node.high));
        let mut stack: Vec<(f64, u32)> = self.nodes.first().map(|root| (to(root), 0)).into_iter().collect();
        while let Some((distance, n)) = stack.pop() {
            if distance >= best.0 {
                continue;
            }
            let node = &self.nodes[n as usize];
            if node.count == 0 {
                let mut children = [node.first, node.first + 1].map(|c| (to(&self.nodes[c as usize]), c));
                if children[0].0 < children[1].0 {
                    children.swap(0, 1);
                }
                stack.extend(children);
                continue;
            }
            for f in &self.faces[node.first as usize..(node.first + node.count) as usize] {
                let face = &surface.faces[*f as usize];
                if !face.alive() || !counts(face.points[0]) {
                    continue;
                }
                let corners = face.points.map(|p| surface.positions[p as usize]);
                let squared = squared_distance(p, corners);
                if squared < best.0 {
                    best = (squared, *f);
                }
            }
        }
        (best.1 != NONE).then_some(best)
    }
}

impl Parts {
    /// The parts of a surface.
    pub fn of(surface: &Surface) -> Self {
        let mut new = Self { of_point: vec![NONE; surface.positions.len()], ..Self::default() };
        for f in 0..surface.faces.len() {
            let face = &surface.faces[f];
            if face.alive() && new.of_point[face.points[0] as usize] == NONE {
                let faces = new.flood(surface, f, usize::MAX).unwrap_or_default();
                new.add(surface, faces);
            }
        }
        new
    }

    /// Whether there is more than one.
    pub fn several(&self) -> bool {
        self.all.len() > 1
    }

    /// The faces that hang together with one, if there are at most so many. Marks nothing.
    fn flood(&self, surface: &Surface, start: usize, most: usize) -> Option<Vec<u32>> {
        let mut seen = rustc_hash::FxHashSet::default();
        let mut faces = vec![start as u32];
        seen.insert(start as u32);
        let mut at = 0;
        while at < faces.len() {
            for p in surface.faces[faces[at] as usize].points {
                for (f, _) in surface.around(p) {
                    if seen.insert(f as u32) {
                        faces.push(f as u32);
                    }
                }
            }
            if faces.len() > most {
                return None;
            }
            at += 1;
        }
        Some(faces)
    }

    fn add(&mut self, surface: &Surface, faces: Vec<u32>) -> u32 {
        let number = self.all.len() as u32;
        let mut locked = false;
        let mut samples = Vec::new();
        let each = faces.len().div_ceil(SAMPLES);
        for chunk in faces.chunks(each) {
            let mut area = 0.0;
            for (i, f) in chunk.iter().enumerate() {
                let points = surface.faces[*f as usize].points;
                let corners = points.map(|p| surface.positions[p as usize]);
                for p in points {
                    self.of_point[p as usize] = number;
                    locked |= surface.locked[p as usize];
                }
                area += 0.5 * (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
                if i == chunk.len() / 2 {
                    samples.push(((corners[0] + corners[1] + corners[2]) / 3.0, 0.0));
                }
            }
            samples.iter_mut().last().into_iter().for_each(|(_, weight)| *weight = area);
        }
        self.all.push(Part { alive: faces.len() as u32, faces, locked, samples });
        number
    }

    /// The part of a point.
    pub fn at(&self, point: u32) -> u32 {
        self.of_point[point as usize]
    }

    /// Takes in a point that was copied; [`Self::take_in_cut`] says later whether it is a part of its own.
    pub fn copy_point(&mut self, point: u32) {
        self.of_point.push(self.of_point[point as usize]);
    }

    /// Takes in that an opening at a point was closed by a face, the last one; returns its part.
    pub fn take_in_closed(&mut self, surface: &Surface, point: u32) -> u32 {
        let number = self.at(point);
        let part = &mut self.all[number as usize];
        part.alive += 1;
        part.faces.push(surface.faces.len() as u32 - 1);
        number
    }

    /// Takes in that the surface was cut between two points and closed by two faces, the last ones: a small piece becomes
    /// a part of its own.
    pub fn take_in_cut(&mut self, surface: &Surface, points: [u32; 2]) {
        let count = surface.faces.len() as u32;
        let part = self.at(points[0]) as usize;
        self.all[part].alive += 2;
        self.all[part].faces.extend([count - 2, count - 1]);
        let of = |p: u32| {
            let (f, _) = surface.around(p).next()?;
            self.flood(surface, f, MOST_FACES as usize)
        };
        let piece = match points.map(of) {
            [Some(a), Some(b)] if a.contains(&b[0]) => return,
            [Some(a), Some(b)] => {
                if a.len() < b.len() {
                    a
                } else {
                    b
                }
            }
            [Some(piece), None] | [None, Some(piece)] => piece,
            [None, None] => return,
        };
        self.all[part].alive -= piece.len() as u32;
        self.add(surface, piece);
    }

    /// Whether a part may go as a whole.
    pub fn may_go(&self, part: u32) -> bool {
        let part = &self.all[part as usize];
        !part.locked && part.alive > 0 && part.alive <= MOST_FACES
    }

    /// The sum of squared distances of a part from what else there is, weighted by area, and the area; none where there
    /// is nothing else.
    pub fn apart(&mut self, surface: &Surface, part: u32) -> Option<(f64, f64)> {
        if (surface.alive as f64) < STALE * self.tree.alive as f64 || self.tree.nodes.is_empty() {
            self.tree = Tree::of(surface);
        }
        let (mut sum, mut area) = (0.0, 0.0);
        for (p, weight) in &self.all[part as usize].samples {
            let (squared, _) = self.nearest_other(surface, part, *p)?;
            sum += squared * weight;
            area += weight;
        }
        Some((sum, area))
    }

    /// The squared distance of a place from all but one part, and the nearest of these.
    fn nearest_other(&self, surface: &Surface, part: u32, p: DVec3) -> Option<(f64, u32)> {
        let (squared, face) = self.tree.nearest(surface, p, |point| self.at(point) != part)?;
        Some((squared, self.at(surface.faces[face as usize].points[0])))
    }

    /// Takes in that a part is gone: what it stood for goes to those nearest to it.
    pub fn went(&mut self, surface: &Surface, part: u32) {
        let samples = std::mem::take(&mut self.all[part as usize].samples);
        self.all[part as usize].alive = 0;
        for (p, weight) in samples {
            let Some((_, other)) = self.nearest_other(surface, part, p) else { continue };
            let of = &mut self.all[other as usize].samples;
            if of.len() < MOST_SAMPLES {
                of.push((p, weight));
            } else if let Some(last) = of.last_mut() {
                last.1 += weight;
            }
        }
    }
}
