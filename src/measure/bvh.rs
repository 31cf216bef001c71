//! A bounding volume hierarchy over the triangles of a whole mesh: nearest points, and what lies near a box.
//!
//! Nodes have four children, whose boxes are tested at once. They are split by the surface area heuristic over bins
//! (Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", 2007), in parallel and always alike.
//!
//! Boxes are f32, about the centre of the mesh and rounded outwards; triangles are f64 as given. Only what a box
//! excludes with a margin is skipped (docs/numerics.md).

use rayon::prelude::*;

use super::closest::{Triangle, Vec3, closest_point, distance_below, squared};

/// Triangles of a leaf at most.
const LEAF: usize = 1;
/// Bins of a split.
const BINS: usize = 16;
/// Up to so many triangles are split in the middle: cheaper than bins and as good.
const FEW: usize = 12;
/// Above so many triangles the children of a node are built in parallel.
const PARALLEL: usize = 1 << 14;
/// Levels after which splits are in the middle, so that depth is bounded whatever the triangles.
const SAH_LEVELS: usize = 32;
/// What a descent has to remember: three siblings at each of [`SAH_LEVELS`] and of the 16 levels that halving twice
/// leaves of 2^28 triangles.
const STACK: usize = 3 * (SAH_LEVELS + 16);
/// Most triangles: what a leaf can point at.
pub const MAX_TRIANGLES: usize = 1 << 28;

const LEAF_BIT: u32 = 1 << 31;
const COUNT_SHIFT: u32 = 28;
const EMPTY: u32 = u32::MAX;

/// Four boxes by axis, and for each a node, or a leaf: a count and the first of its triangles.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
struct Node {
    low: [[f32; 4]; 3],
    high: [[f32; 4]; 3],
    child: [u32; 4],
}

impl Node {
    const NONE: Self =
        Self { low: [[f32::INFINITY; 4]; 3], high: [[f32::NEG_INFINITY; 4]; 3], child: [EMPTY; 4] };

    /// Squared distances from a point to the four boxes.
    fn squared_distances(&self, p: [f32; 3]) -> [f32; 4] {
        let mut out = [0.0; 4];
        for k in 0..3 {
            for i in 0..4 {
                let d = (self.low[k][i] - p[k]).max(p[k] - self.high[k][i]).max(0.0);
                out[i] += d * d;
            }
        }
        out
    }

    /// Which of the four boxes touch another.
    fn touches(&self, low: [f32; 3], high: [f32; 3]) -> [bool; 4] {
        let mut out = [true; 4];
        for k in 0..3 {
            for i in 0..4 {
                out[i] &= (self.low[k][i] <= high[k]) & (low[k] <= self.high[k][i]);
            }
        }
        out
    }
}

/// A triangle's box while the tree is built.
#[derive(Clone, Copy, Debug)]
struct Item {
    low: [f32; 3],
    high: [f32; 3],
    id: u32,
}

impl Item {
    /// Twice the centre of an axis.
    fn middle(&self, axis: usize) -> f32 {
        self.low[axis] + self.high[axis]
    }
}

#[derive(Clone, Copy)]
struct Bounds {
    low: [f32; 3],
    high: [f32; 3],
}

impl Bounds {
    const EMPTY: Self = Self { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };

    fn add(&mut self, low: [f32; 3], high: [f32; 3]) {
        for k in 0..3 {
            self.low[k] = self.low[k].min(low[k]);
            self.high[k] = self.high[k].max(high[k]);
        }
    }

    fn of(items: &[Item]) -> Self {
        let mut out = Self::EMPTY;
        items.iter().for_each(|item| out.add(item.low, item.high));
        out
    }

    fn half_area(&self) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|k| (self.high[k] - self.low[k]).max(0.0));
        x * y + y * z + z * x
    }
}

/// A nearest point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Distance, with the triangle's radius added where the tree has radii.
    pub distance: f64,
    /// The triangle's place in the tree: see [`Bvh::triangle`] and [`Bvh::id`]. Good as a hint for a point nearby.
    pub place: usize,
    /// The nearest point.
    pub point: Vec3,
}

/// The tree.
#[derive(Clone, Debug)]
pub struct Bvh {
    nodes: Vec<Node>,
    /// In the order of the leaves.
    triangles: Vec<Triangle>,
    ids: Vec<u32>,
    /// In the order of the leaves, or empty.
    radii: Vec<f64>,
    center: Vec3,
    scale: f64,
}

impl Bvh {
    /// A tree over triangles with finite coordinates, at most [`MAX_TRIANGLES`] of them.
    pub fn new(triangles: &[Triangle]) -> Self {
        Self::with_radii(triangles, &[])
    }

    /// A tree over triangles each of which is `radius` farther away than it looks. `radii` are not negative, one for
    /// each triangle or none at all.
    pub fn with_radii(triangles: &[Triangle], radii: &[f64]) -> Self {
        let (low, high) = bounds(triangles);
        let center: Vec3 = std::array::from_fn(|k| 0.5 * low[k] + 0.5 * high[k]);
        let extent = (0..3).fold(0.0f64, |e, k| e.max(high[k] - low[k]));
        let scale = if extent > f64::MIN_POSITIVE { extent.recip().min(f64::MAX) } else { 1.0 };
        let item = |(id, t): (usize, &Triangle)| {
            let mut item = Bounds::EMPTY;
            for corner in t {
                // One step outwards covers the rounding of the f64 steps before by far.
                let at: [f32; 3] = std::array::from_fn(|k| ((corner[k] - center[k]) * scale) as f32);
                item.add(at.map(f32::next_down), at.map(f32::next_up));
            }
            Item { low: item.low, high: item.high, id: id as u32 }
        };
        let mut items: Vec<Item> = if triangles.len() > PARALLEL {
            triangles.par_iter().enumerate().map(item).collect()
        } else {
            triangles.iter().enumerate().map(item).collect()
        };
        let mut nodes = Vec::new();
        if items.len() > PARALLEL {
            nodes = parallel_nodes(&mut items, 0, 0);
        } else if !items.is_empty() {
            add_nodes(&mut nodes, &mut items, 0, 0);
        }
        let ids: Vec<u32> = items.iter().map(|item| item.id).collect();
        drop(items);
        let radii =
            if radii.is_empty() { vec![] } else { ids.iter().map(|id| radii[*id as usize]).collect() };
        let triangles = if ids.len() > PARALLEL {
            ids.par_iter().map(|id| triangles[*id as usize]).collect()
        } else {
            ids.iter().map(|id| triangles[*id as usize]).collect()
        };
        Self { nodes, triangles, ids, radii, center, scale }
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// True without triangles.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// The triangles in the order of the tree: neighbours are near each other.
    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// The triangle at a place.
    pub fn triangle(&self, place: usize) -> Triangle {
        self.triangles[place]
    }

    /// The number that the triangle at a place had where the tree was made from.
    pub fn id(&self, place: usize) -> usize {
        self.ids[place] as usize
    }

    /// The radius of the triangle at a place.
    pub fn radius(&self, place: usize) -> f64 {
        self.radii.get(place).copied().unwrap_or(0.0)
    }

    /// The nearest point of the surface; `None` if nothing is nearer than `bound`. `hint` is a place to look at
    /// first, and may be out of range. Anything within `enough` ends the search: callers look for a maximum.
    pub fn nearest(&self, p: Vec3, bound: f64, enough: f64, hint: usize) -> Option<Nearest> {
        let mut best = Nearest { distance: bound, place: usize::MAX, point: p };
        let look = |best: &mut Nearest, place: usize| {
            let point = closest_point(p, self.triangles[place]);
            let d2 = squared(p, point);
            if d2 < best.distance * best.distance {
                let distance = d2.sqrt() + self.radius(place);
                if distance < best.distance {
                    *best = Nearest { distance, place, point };
                    return true;
                }
            }
            false
        };
        if hint < self.triangles.len() {
            look(&mut best, hint);
        }
        if best.distance > enough {
            self.descend(p, best.distance, |place| {
                let better = look(&mut best, place);
                (better, if best.distance <= enough { -1.0 } else { best.distance })
            });
        }
        (best.place != usize::MAX).then_some(best)
    }

    /// What the distance from a point to the surface cannot be below, but for rounding of 1e-15 of the coordinates.
    pub fn distance_below(&self, p: Vec3) -> f64 {
        let mut least = f64::INFINITY;
        self.descend(p, least, |place| {
            let distance = distance_below(p, self.triangles[place]) + self.radius(place);
            let better = distance < least;
            least = least.min(distance);
            (better, least)
        });
        least
    }

    /// Calls `look` with places whose boxes are within a distance, nearest boxes first as far as cheaply known. It
    /// returns whether that distance became less, and the distance; a negative one ends the descent.
    fn descend(&self, p: Vec3, distance: f64, mut look: impl FnMut(usize) -> (bool, f64)) {
        if self.nodes.is_empty() {
            return;
        }
        let at: [f32; 3] = std::array::from_fn(|k| ((p[k] - self.center[k]) * self.scale) as f32);
        let largest = at.iter().fold(1.0f32, |m, x| m.max(x.abs()));
        let margin = f64::from(largest) * MARGIN;
        let limit = |distance: f64| {
            let reach = (distance * self.scale + margin) * (1.0 + MARGIN);
            ((reach * reach) as f32).next_up()
        };
        let mut most = limit(distance);
        let mut stack = [(0u32, 0.0f32); STACK];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (entry, d) = stack[top];
            if d > most {
                continue;
            }
            if entry & LEAF_BIT != 0 {
                for place in places(entry) {
                    let (better, distance) = look(place);
                    if better {
                        if distance < 0.0 {
                            return;
                        }
                        most = limit(distance);
                    }
                }
                continue;
            }
            let node = &self.nodes[entry as usize];
            let distances = node.squared_distances(at);
            let first = top;
            for i in 0..4 {
                if distances[i] <= most && node.child[i] != EMPTY {
                    // Farthest first, so that the nearest is on top.
                    let mut slot = top;
                    while slot > first && stack[slot - 1].1 < distances[i] {
                        stack[slot] = stack[slot - 1];
                        slot -= 1;
                    }
                    stack[slot] = (node.child[i], distances[i]);
                    top += 1;
                }
            }
        }
    }

    /// Collects the places of leaves whose boxes are within `reach` of the box of some points, all of them or, if
    /// they are more than `most`, at least so many; returns false in that case.
    pub fn around(&self, points: &[Vec3], reach: f64, most: usize, out: &mut Vec<u32>) -> bool {
        out.clear();
        if self.nodes.is_empty() {
            return true;
        }
        let mut of_points = Bounds::EMPTY;
        for p in points {
            let at: [f32; 3] = std::array::from_fn(|k| ((p[k] - self.center[k]) * self.scale) as f32);
            of_points.add(at, at);
        }
        let reach = (reach * self.scale) as f32;
        let (low, high) = (of_points.low.map(|x| x - reach), of_points.high.map(|x| x + reach));
        let mut stack = [0u32; STACK];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let entry = stack[top];
            if entry & LEAF_BIT != 0 {
                out.extend(places(entry).map(|place| place as u32));
                if out.len() > most {
                    return false;
                }
                continue;
            }
            let node = &self.nodes[entry as usize];
            let touches = node.touches(low, high);
            for i in 0..4 {
                if touches[i] && node.child[i] != EMPTY {
                    stack[top] = node.child[i];
                    top += 1;
                }
            }
        }
        true
    }
}

/// Relative rounding of f32 box distances, eight times over.
const MARGIN: f64 = 1.0 / (1 << 20) as f64;

fn places(leaf: u32) -> std::ops::Range<usize> {
    let first = (leaf & ((1 << COUNT_SHIFT) - 1)) as usize;
    first..first + 1 + (leaf >> COUNT_SHIFT & 3) as usize
}

fn bounds(triangles: &[Triangle]) -> (Vec3, Vec3) {
    let none = || ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let join = |mut a: (Vec3, Vec3), b: (Vec3, Vec3)| {
        for k in 0..3 {
            a.0[k] = a.0[k].min(b.0[k]);
            a.1[k] = a.1[k].max(b.1[k]);
        }
        a
    };
    let of = |t: &[Triangle]| t.as_flattened().iter().fold(none(), |b, p| join(b, (*p, *p)));
    if triangles.len() > PARALLEL {
        triangles.par_chunks(PARALLEL).map(of).reduce(none, join)
    } else {
        of(triangles)
    }
}

/// Up to four parts of the items, none of them empty.
fn parts(items: &mut [Item], depth: usize) -> ([&mut [Item]; 4], usize) {
    let middle = split(items, depth);
    let (a, b) = items.split_at_mut(middle);
    let mut out: [&mut [Item]; 4] = Default::default();
    let mut count = 0;
    for half in [a, b] {
        if half.len() > LEAF {
            let middle = split(half, depth);
            let (left, right) = half.split_at_mut(middle);
            (out[count], out[count + 1]) = (left, right);
            count += 2;
        } else if !half.is_empty() {
            out[count] = half;
            count += 1;
        }
    }
    (out, count)
}

/// Orders the items so that those of one side come first; returns how many these are.
fn split(items: &mut [Item], depth: usize) -> usize {
    let mut range = Bounds::EMPTY;
    for item in &*items {
        let middle = [0, 1, 2].map(|k| item.middle(k));
        range.add(middle, middle);
    }
    let extent = |k: usize| range.high[k] - range.low[k];
    let axis = (1..3).fold(0, |best, k| if extent(k) > extent(best) { k } else { best });
    if items.len() <= FEW || depth >= SAH_LEVELS || extent(axis) <= 0.0 {
        return halve(items, axis);
    }
    let factor = BINS as f32 / extent(axis);
    let bin_of = |item: &Item| (((item.middle(axis) - range.low[axis]) * factor) as usize).min(BINS - 1);
    let mut bins = [(Bounds::EMPTY, 0usize); BINS];
    for item in &*items {
        let bin = &mut bins[bin_of(item)];
        bin.0.add(item.low, item.high);
        bin.1 += 1;
    }
    let mut right = [0.0f32; BINS];
    let mut sum = (Bounds::EMPTY, 0);
    for i in (1..BINS).rev() {
        sum.0.add(bins[i].0.low, bins[i].0.high);
        sum.1 += bins[i].1;
        right[i] = sum.0.half_area() * sum.1 as f32;
    }
    let (mut best, mut cost) = (0, f32::INFINITY);
    let mut sum = (Bounds::EMPTY, 0);
    for i in 0..BINS - 1 {
        sum.0.add(bins[i].0.low, bins[i].0.high);
        sum.1 += bins[i].1;
        let both = sum.0.half_area() * sum.1 as f32 + right[i + 1];
        if sum.1 > 0 && sum.1 < items.len() && both < cost {
            (best, cost) = (i, both);
        }
    }
    if cost == f32::INFINITY {
        return halve(items, axis);
    }
    let (mut i, mut j) = (0, items.len());
    while i < j {
        if bin_of(&items[i]) <= best {
            i += 1;
        } else {
            j -= 1;
            items.swap(i, j);
        }
    }
    i
}

fn halve(items: &mut [Item], axis: usize) -> usize {
    let half = items.len() / 2;
    // The number decides between equals: the order must not depend on chance.
    items.select_nth_unstable_by(half, |a, b| {
        a.middle(axis).total_cmp(&b.middle(axis)).then_with(|| a.id.cmp(&b.id))
    });
    half
}

fn set_child(node: &mut Node, i: usize, items: &[Item], child: u32) {
    let bounds = Bounds::of(items);
    for k in 0..3 {
        node.low[k][i] = bounds.low[k];
        node.high[k][i] = bounds.high[k];
    }
    node.child[i] = child;
}

fn leaf(first: usize, count: usize) -> u32 {
    LEAF_BIT | ((count - 1) as u32) << COUNT_SHIFT | first as u32
}

/// Appends the tree of some items, the first of which has the place `first`; returns its root.
fn add_nodes(nodes: &mut Vec<Node>, items: &mut [Item], first: usize, depth: usize) -> u32 {
    let at = nodes.len();
    nodes.push(Node::NONE);
    let mut node = Node::NONE;
    let (parts, count) = parts(items, depth);
    let mut place = first;
    for (i, part) in parts.into_iter().take(count).enumerate() {
        let length = part.len();
        let child =
            if length <= LEAF { leaf(place, length) } else { add_nodes(nodes, part, place, depth + 1) };
        set_child(&mut node, i, part, child);
        place += length;
    }
    nodes[at] = node;
    at as u32
}

/// The tree of many items: the parts in parallel, then one behind the other.
fn parallel_nodes(items: &mut [Item], first: usize, depth: usize) -> Vec<Node> {
    if items.len() <= PARALLEL {
        let mut nodes = Vec::new();
        add_nodes(&mut nodes, items, first, depth);
        return nodes;
    }
    let (parts, count) = parts(items, depth);
    let mut place = first;
    let work: Vec<_> = parts
        .into_iter()
        .take(count)
        .map(|part| {
            let start = place;
            place += part.len();
            (start, part)
        })
        .collect();
    let trees: Vec<_> = work
        .into_par_iter()
        .map(|(start, part)| {
            let tree = if part.len() <= LEAF { vec![] } else { parallel_nodes(part, start, depth + 1) };
            (start, part, tree)
        })
        .collect();
    let mut nodes = vec![Node::NONE];
    for (i, (start, part, tree)) in trees.into_iter().enumerate() {
        let offset = nodes.len() as u32;
        let child = if tree.is_empty() { leaf(start, part.len()) } else { offset };
        set_child(&mut nodes[0], i, part, child);
        nodes.extend(tree.into_iter().map(|mut node| {
            node.child = node.child.map(|c| if c & LEAF_BIT == 0 { c + offset } else { c });
            node
        }));
    }
    nodes
}
