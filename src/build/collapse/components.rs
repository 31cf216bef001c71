//! Connected components, and what it costs to remove one: the squared distance of its surface from the rest of the
//! mesh, in the measure of a collapse's cost, shared out to the pairs of triangles that go with it. So components
//! compete with collapses: a small one is removed where that is cheaper than to coarsen others.

use glam::DVec3;

use super::surface::{NONE, Surface};
use super::wedges::squared_distance;

/// A component of at most so many faces may be removed as a whole; larger ones collapse first.
const MOST_FACES: u32 = 64;
/// Samples of the distance of a component.
const SAMPLES: usize = 16;
/// The same with those of removed components that it stands for.
const MOST_SAMPLES: usize = 48;

/// A connected component.
#[derive(Debug)]
pub struct Component {
    /// Faces that it had at first, including those that are gone.
    pub faces: Vec<u32>,
    /// Number of faces that are left.
    pub alive: u32,
    /// It has a locked point, and so stays.
    pub locked: bool,
    /// Samples of its surface and of removed components that it was nearest to, each with the area that it stands
    /// for.
    samples: Vec<(DVec3, f64)>,
}

/// The connected components of a surface.
#[derive(Debug, Default)]
pub struct Components {
    /// Each of them.
    pub all: Vec<Component>,
    /// The component of each point.
    pub of_point: Vec<u32>,
    tree: Tree,
}

/// Faces of a leaf of the tree.
const LEAF: usize = 8;
/// The tree is rebuilt when this part of its faces is left: those that stay have grown.
const STALE: f64 = 0.7;
/// Boxes are larger by this part of the longest side of their faces, since faces move before the tree is rebuilt.
const GROWTH: f64 = 0.5;

/// Boxes around faces, halved at medians; the children of a node lie one after the other.
#[derive(Debug, Default)]
struct Tree {
    nodes: Vec<Node>,
    faces: Vec<u32>,
    /// Number of faces when it was built.
    alive: usize,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// The first child; of a leaf the first face.
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

    /// The squared distance of a point to the nearest of the faces that count, and that face.
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

impl Components {
    /// The components of a surface.
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

    /// The faces connected to one, if they are at most `most`.
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
        self.all.push(Component { alive: faces.len() as u32, faces, locked, samples });
        number
    }

    /// The component of a point.
    pub fn at(&self, point: u32) -> u32 {
        self.of_point[point as usize]
    }

    /// Adds a copy of a point to its component; [`Self::cut_ring`] splits the component later.
    pub fn copy_point(&mut self, point: u32) {
        self.of_point.push(self.of_point[point as usize]);
    }

    /// Adds the last face, which closed an opening at a point; returns its component.
    pub fn close_opening(&mut self, surface: &Surface, point: u32) -> u32 {
        let number = self.at(point);
        let component = &mut self.all[number as usize];
        component.alive += 1;
        component.faces.push(surface.faces.len() as u32 - 1);
        number
    }

    /// Adds the last two faces, which closed a cut between two points. A small piece becomes a component of its
    /// own.
    pub fn cut_ring(&mut self, surface: &Surface, points: [u32; 2]) {
        let count = surface.faces.len() as u32;
        let component = self.at(points[0]) as usize;
        self.all[component].alive += 2;
        self.all[component].faces.extend([count - 2, count - 1]);
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
        self.all[component].alive -= piece.len() as u32;
        self.add(surface, piece);
    }

    /// Whether a component may be removed as a whole.
    pub fn is_removable(&self, component: u32) -> bool {
        let component = &self.all[component as usize];
        !component.locked && component.alive > 0 && component.alive <= MOST_FACES
    }

    /// The sum of squared distances of a component to all others, weighted by area, and the area; none where there
    /// are no others.
    pub fn distance(&mut self, surface: &Surface, component: u32) -> Option<(f64, f64)> {
        if (surface.alive as f64) < STALE * self.tree.alive as f64 || self.tree.nodes.is_empty() {
            self.tree = Tree::of(surface);
        }
        let (mut sum, mut area) = (0.0, 0.0);
        for (p, weight) in &self.all[component as usize].samples {
            let (squared, _) = self.nearest_other(surface, component, *p)?;
            sum += squared * weight;
            area += weight;
        }
        Some((sum, area))
    }

    /// The squared distance of a point to the other components, and the nearest of them.
    fn nearest_other(&self, surface: &Surface, component: u32, p: DVec3) -> Option<(f64, u32)> {
        let (squared, face) = self.tree.nearest(surface, p, |point| self.at(point) != component)?;
        Some((squared, self.at(surface.faces[face as usize].points[0])))
    }

    /// Marks a component as removed: the components nearest to it take over its samples.
    pub fn remove(&mut self, surface: &Surface, component: u32) {
        let samples = std::mem::take(&mut self.all[component as usize].samples);
        self.all[component as usize].alive = 0;
        for (p, weight) in samples {
            let Some((_, other)) = self.nearest_other(surface, component, p) else { continue };
            let of = &mut self.all[other as usize].samples;
            if of.len() < MOST_SAMPLES {
                of.push((p, weight));
            } else if let Some(last) = of.last_mut() {
                last.1 += weight;
            }
        }
    }
}
