//! Triangles clipped at the planes of a box, such that boxes on both sides of a plane have the same points on it.
//!
//! A point where an edge of a triangle crosses a plane is made from the ends of that edge, in an order that depends on their
//! positions alone; one where a triangle meets two planes is made on its line with the plane of the lower axis. Nothing
//! depends on what else a box clips, after Sutherland and Hodgman, Reentrant Polygon Clipping, 1974.

use super::plan::Crossing;
use crate::math::Aabb;

/// What a point of a polygon is, by which it is found again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Key {
    /// A vertex.
    Vertex(u32),
    /// Where the edge between two vertices, the lower number first, crosses a plane.
    Edge(u32, u32, Plane),
    /// Where a triangle meets two planes, that of the lower axis first.
    Face(u32, Plane, Plane),
}

/// A plane across an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Plane {
    axis: u8,
    bits: u32,
}

impl Plane {
    /// Across an axis at a value.
    pub fn new(axis: usize, value: f32) -> Self {
        // Zero has one sign.
        Self { axis: axis as u8, bits: (value + 0.0).to_bits() }
    }

    fn axis(self) -> usize {
        usize::from(self.axis)
    }

    fn value(self) -> f32 {
        f32::from_bits(self.bits)
    }

    /// Positive above, negative below, and 0 on it.
    fn side(self, p: [f32; 3]) -> i32 {
        let (x, at) = (p[self.axis()], self.value());
        i32::from(x > at) - i32::from(x < at)
    }
}

/// A point of a polygon.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// What it is.
    pub key: Key,
    /// Where it is.
    pub position: [f32; 3],
    /// What corners of the triangle weigh there.
    pub weights: [f64; 3],
}

/// The line that an edge of a polygon lies on.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Line {
    /// The edge from this corner of the triangle to the next.
    Side(usize),
    /// Where the triangle meets a plane.
    Section(Plane),
}

/// A triangle that is clipped: points in order, each with the line to the next.
pub struct Polygon {
    number: u32,
    corners: [Point; 3],
    points: Vec<(Point, Line)>,
}

impl Polygon {
    /// A whole triangle with a number of its own.
    pub fn new(number: u32, vertices: [u32; 3], positions: [[f32; 3]; 3]) -> Self {
        let corners = std::array::from_fn(|k| Point {
            key: Key::Vertex(vertices[k]),
            position: positions[k],
            weights: std::array::from_fn(|j| f64::from(u8::from(j == k))),
        });
        Self { number, corners, points: (0..3).map(|k| (corners[k], Line::Side(k))).collect() }
    }

    /// The points; none where nothing is left.
    pub fn points(&self) -> impl ExactSizeIterator<Item = &Point> {
        self.points.iter().map(|(point, _)| point)
    }

    /// Keeps what lies in a box, with what lies on its lower planes and without what lies on its upper ones.
    pub fn clip(&mut self, bounds: &Aabb) {
        for axis in 0..3 {
            self.keep(Plane::new(axis, bounds.min[axis]), 1);
            self.keep(Plane::new(axis, bounds.max[axis]), -1);
        }
    }

    /// Keeps what lies on one side of a plane.
    fn keep(&mut self, plane: Plane, sign: i32) {
        let sides: Vec<i32> = self.points.iter().map(|(p, _)| sign * plane.side(p.position)).collect();
        if sides.iter().all(|side| *side > 0) {
            return;
        }
        if sides.iter().all(|side| *side <= 0) {
            // In the plane it belongs to the box above.
            if sign < 0 || sides.iter().any(|side| *side < 0) {
                self.points.clear();
            }
            return;
        }
        let count = self.points.len();
        let mut kept = Vec::with_capacity(count + 2);
        for i in 0..count {
            let (next, (point, line)) = ((i + 1) % count, self.points[i]);
            match (sides[i], sides[next]) {
                (0, -1) => kept.push((point, Line::Section(plane))),
                (1, -1) => {
                    kept.push((point, line));
                    kept.push((self.crossing(line, plane), Line::Section(plane)));
                }
                (-1, 1) => kept.push((self.crossing(line, plane), line)),
                (-1, _) => {}
                _ => kept.push((point, line)),
            }
        }
        self.points = kept;
    }

    /// Adds points where halvings of neighbours cross edges that lie in a plane of the box.
    pub fn insert(&mut self, plane: Plane, crossings: &[Crossing]) {
        if crossings.is_empty() {
            return;
        }
        let count = self.points.len();
        let mut out = Vec::with_capacity(count);
        for i in 0..count {
            let ((point, line), (next, _)) = (self.points[i], self.points[(i + 1) % count]);
            out.push((point, line));
            if plane.side(point.position) != 0 || plane.side(next.position) != 0 {
                continue;
            }
            let mut found: Vec<Point> = Vec::new();
            for crossing in crossings {
                let other = Plane::new(crossing.axis, crossing.value);
                if other.side(point.position) * other.side(next.position) >= 0 {
                    continue;
                }
                let at = self.crossing(line, other);
                let third = at.position[3 - plane.axis() - crossing.axis];
                let is_there = crossing.reach[0] <= third && third <= crossing.reach[1];
                if is_there && found.iter().all(|known| known.key != at.key) {
                    found.push(at);
                }
            }
            let far = |p: &Point| {
                let along = |k: usize| f64::from(p.position[k]) - f64::from(point.position[k]);
                (0..3).map(|k| along(k).powi(2)).sum::<f64>()
            };
            found.sort_by(|a, b| far(a).total_cmp(&far(b)));
            out.extend(found.into_iter().map(|at| (at, line)));
        }
        self.points = out;
    }

    /// Where a line crosses a plane.
    fn crossing(&self, line: Line, plane: Plane) -> Point {
        match line {
            Line::Side(k) => self.on_side(k, plane),
            Line::Section(other) => {
                let (first, second) = if other.axis < plane.axis { (other, plane) } else { (plane, other) };
                let [a, b] = self.section(first);
                Point { key: Key::Face(self.number, first, second), ..between(a, b, second) }
            }
        }
    }

    /// Where a side of the triangle crosses a plane.
    fn on_side(&self, k: usize, plane: Plane) -> Point {
        let (a, b) = (self.corners[k], self.corners[(k + 1) % 3]);
        let (Key::Vertex(i), Key::Vertex(j)) = (a.key, b.key) else { unreachable!("corners are vertices") };
        Point { key: Key::Edge(i.min(j), i.max(j), plane), ..between(a, b, plane) }
    }

    /// The ends of the line where the triangle meets a plane.
    fn section(&self, plane: Plane) -> [Point; 2] {
        let sides = self.corners.map(|corner| plane.side(corner.position));
        let mut ends = (0..3).filter(|k| sides[*k] == 0).map(|k| self.corners[k]).collect::<Vec<_>>();
        let crossed = (0..3).filter(|k| sides[*k] * sides[(k + 1) % 3] < 0);
        ends.extend(crossed.map(|k| self.on_side(k, plane)));
        match ends[..] {
            [a, b, ..] => [a, b],
            [a] => [a, a],
            [] => [self.corners[0]; 2],
        }
    }
}

/// Where the line between two points crosses a plane; the same whichever point comes first. The coordinate across the plane is
/// that of the plane.
fn between(a: Point, b: Point, plane: Plane) -> Point {
    let order = |p: &Point| p.position.map(|x| x + 0.0);
    let less = order(&a).partial_cmp(&order(&b)) == Some(std::cmp::Ordering::Less);
    let (a, b) = if less { (a, b) } else { (b, a) };
    let axis = plane.axis();
    let (from, to) = (f64::from(a.position[axis]), f64::from(b.position[axis]));
    let part = if from == to { 0.5 } else { (f64::from(plane.value()) - from) / (to - from) };
    let part = part.clamp(0.0, 1.0);
    let position = std::array::from_fn(|k| {
        let (x, y) = (a.position[k], b.position[k]);
        let mixed = f64::from(x) + part * (f64::from(y) - f64::from(x));
        if k == axis { plane.value() } else { (mixed as f32).clamp(x.min(y), x.max(y)) }
    });
    let weights = std::array::from_fn(|k| a.weights[k] + part * (b.weights[k] - a.weights[k]));
    Point { key: a.key, position, weights }
}

/// Triangles of a convex polygon, whose points may lie in rows: those of which the worst is best.
pub fn triangulate(points: &[[f32; 3]]) -> Vec<[usize; 3]> {
    let count = points.len();
    if count < 3 {
        return Vec::new();
    }
    let quality = |a: usize, b: usize, c: usize| {
        let edge = |i: usize, j: usize| [0, 1, 2].map(|k| f64::from(points[j][k]) - f64::from(points[i][k]));
        let (u, v, w) = (edge(a, b), edge(a, c), edge(b, c));
        let across: [f64; 3] =
            std::array::from_fn(|k| u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]);
        let squared = |x: [f64; 3]| x.iter().map(|x| x * x).sum::<f64>();
        let around = squared(u) + squared(v) + squared(w);
        if around > 0.0 { squared(across).sqrt() / around } else { 0.0 }
    };
    // For each run of points the worst triangle between its ends, and the point that makes the last one with them.
    let mut best = vec![(f64::INFINITY, 0usize); count * count];
    for length in 2..count {
        for i in 0..count - length {
            let j = i + length;
            let split = |k: usize| best[i * count + k].0.min(best[k * count + j].0).min(quality(i, k, j));
            best[i * count + j] = (i + 1..j)
                .map(|k| (split(k), k))
                .fold((f64::NEG_INFINITY, i + 1), |a, b| if b.0 > a.0 { b } else { a });
        }
    }
    let mut out = Vec::with_capacity(count - 2);
    let mut stack = vec![(0, count - 1)];
    while let Some((i, j)) = stack.pop() {
        if j - i < 2 {
            continue;
        }
        let k = best[i * count + j].1;
        out.push([i, k, j]);
        stack.extend([(i, k), (k, j)]);
    }
    out
}
