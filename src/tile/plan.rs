//! Which tiles there are: errors of levels, and boxes with about as many triangles as asked for.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::math::Aabb;
use crate::model::rule::SOURCE_ERROR;
use crate::model::{ClusterAddress, Dag, InterruptCheck, WINDOW_PAGES};

/// How many times more triangles a level has than the coarser one, about: a surface has four times the triangles where its
/// boxes have half the size.
const FACES_PER_LEVEL: u64 = 4;
/// Where the next level would have this part of the source, it is the source.
const NEARLY_ALL: f64 = 0.6;
/// Most halvings of a box.
const MAX_DEPTH: u32 = 64;

/// A box and what a cut has in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// The first level that it belongs to. Where the next levels change nothing, it stands for them, too.
    pub level: u32,
    /// The tile that it replaces a part of; nothing at the top.
    pub parent: Option<u32>,
    /// Its box, internal units: points on the lower planes belong to it, those on the upper ones to its neighbours.
    pub bounds: Aabb,
    /// How far what it has is from the source at most, internal units, without the rounding of positions.
    pub error: f32,
    /// How far attributes are off, internal units.
    pub attribute_error: f32,
    /// Nothing in it is simplified.
    pub whole: bool,
    /// Clusters that reach into the box, in page order. There may be none where a finer level has nothing.
    pub clusters: Vec<ClusterAddress>,
}

/// Where a halving meets a side of a box: across `axis` at `value`, for as far along the third axis as it goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// The axis that it is across.
    pub axis: usize,
    /// Where.
    pub value: f32,
    /// From where to where along the axis that is neither this one nor that of the side.
    pub reach: [f32; 2],
}

/// How a mesh is laid out in tiles.
#[derive(Clone, Debug, PartialEq)]
pub enum Layout {
    /// At most about so many triangles in each. The errors of levels follow.
    Triangles(u32),
    /// Boxes of one size on each level.
    Grid {
        /// The box of all, internal units.
        bounds: Aabb,
        /// For each level, coarsest first, the error of its cut, internal units, and how often its boxes are halved across
        /// each axis.
        levels: Vec<(f32, u32)>,
    },
}

/// All tiles of a mesh.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The errors that the cuts of levels are made for, coarsest first, internal units.
    pub levels: Vec<f32>,
    /// Tiles, parents before what replaces them.
    pub tiles: Vec<Tile>,
    boxes: Vec<Halved>,
}

/// A box of the tree.
#[derive(Clone, Debug)]
struct Halved {
    bounds: Aabb,
    depth: u32,
    /// Axis, plane, and the boxes below and above.
    halves: Option<(usize, f32, [usize; 2])>,
    /// The tile that stands there on the level before.
    tile: Option<u32>,
    /// What stood there when the box around it was halved.
    before: Option<u32>,
}

/// What is kept of a cluster.
struct Entry {
    at: ClusterAddress,
    bounds: Aabb,
    own: f32,
    parent: f32,
    refined: u32,
    triangles: u8,
}

impl Entry {
    fn overlaps(&self, other: &Aabb) -> bool {
        (0..3).all(|k| self.bounds.min[k] <= other.max[k] && other.min[k] <= self.bounds.max[k])
    }

    fn is_drawn(&self, error: f32) -> bool {
        self.own <= error && error < self.parent
    }
}

/// Lays out the tiles of a mesh. Pages that are not in memory are read a window after the other and do not stay.
pub fn plan(dag: &Dag, layout: &Layout, proceed: InterruptCheck<'_>) -> Result<Plan> {
    if dag.pose.is_some() {
        return Err(Error::argument("mesh", "its levels are those at rest; give a mesh of the pose"));
    }
    let entries = entries(dag, proceed)?;
    let (levels, bounds) = match layout {
        Layout::Triangles(most) => {
            let mut bounds = entries.iter().fold(Aabb::EMPTY, |all, entry| all.union(&entry.bounds));
            // So that nothing lies on an upper plane that has no neighbour.
            bounds.max = bounds.max.map(f32::next_up);
            (levels(&entries, u64::from(*most)), bounds)
        }
        Layout::Grid { bounds, levels } => (levels.iter().map(|level| level.0).collect(), *bounds),
    };
    let root = Halved { bounds, depth: 0, halves: None, tile: None, before: None };
    let mut grown = Growing { dag, entries: &entries, layout, tiles: Vec::new(), boxes: vec![root] };
    for (level, error) in levels.iter().enumerate() {
        let drawn = (0..entries.len()).filter(|i| entries[*i].is_drawn(*error)).collect();
        grown.descend(0, drawn, level as u32);
    }
    let Growing { tiles, boxes, .. } = grown;
    Ok(Plan { levels, tiles, boxes })
}

fn entries(dag: &Dag, proceed: InterruptCheck<'_>) -> Result<Vec<Entry>> {
    let pages: Vec<usize> = (0..dag.pages.table.len()).collect();
    let mut out = Vec::with_capacity(dag.cluster_count());
    for pages in pages.chunks(WINDOW_PAGES) {
        let window = dag.pages.window(pages.iter().copied(), proceed)?;
        for page in pages {
            for (slot, record) in window.records(*page).iter().enumerate() {
                let at = |sign: f32| std::array::from_fn(|k| record.center[k] + sign * record.extent[k]);
                out.push(Entry {
                    at: ClusterAddress::new(*page, slot),
                    bounds: Aabb { min: at(-1.0).map(f32::next_down), max: at(1.0).map(f32::next_up) },
                    own: record.error,
                    parent: dag.groups[record.group as usize].error,
                    refined: record.refined,
                    triangles: record.triangle_count,
                });
            }
        }
    }
    Ok(out)
}

/// The errors of levels. The first has so many triangles at most, where a cut has as few.
fn levels(entries: &[Entry], triangles: u64) -> Vec<f32> {
    // Where the error passes one of these, the cut has so many triangles more, or fewer.
    let mut steps: Vec<(f32, i64)> = entries
        .iter()
        .flat_map(|e| [(e.own.max(0.0), i64::from(e.triangles)), (e.parent, -i64::from(e.triangles))])
        .filter(|(error, _)| error.is_finite())
        .collect();
    steps.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let mut cuts: Vec<(f32, u64)> = Vec::new();
    let mut faces = 0;
    for (error, step) in steps {
        faces += step;
        match cuts.last_mut() {
            Some(last) if last.0 == error => last.1 = faces.max(0) as u64,
            _ => cuts.push((error, faces.max(0) as u64)),
        }
    }
    let source = cuts.first().map_or(0, |cut| cut.1);
    // The finest cut with at most so many triangles, or the coarsest of all.
    let finest = |most: u64| cuts.iter().find(|cut| cut.1 <= most).or(cuts.last()).copied();
    let mut out = Vec::new();
    let mut next = finest(triangles);
    while let Some((error, faces)) = next {
        if error <= 0.0 || out.last().is_some_and(|last| error >= *last) {
            break;
        }
        out.push(error);
        let most = faces.max(triangles) * FACES_PER_LEVEL;
        next = if most as f64 > NEARLY_ALL * source as f64 { None } else { finest(most) };
    }
    out.push(0.0);
    out
}

struct Growing<'a> {
    dag: &'a Dag,
    entries: &'a [Entry],
    layout: &'a Layout,
    tiles: Vec<Tile>,
    boxes: Vec<Halved>,
}

impl Growing<'_> {
    /// Puts the clusters of a level that reach into a box into tiles.
    fn descend(&mut self, number: usize, inside: Vec<usize>, level: u32) {
        if self.boxes[number].halves.is_none() {
            // Where nothing was it stays so; what becomes nothing is replaced by it.
            if inside.is_empty() && self.boxes[number].tile.is_none() || self.stands(number, &inside) {
                return;
            }
            if !self.halve(number, &inside, level) {
                let tile = self.tile(number, &inside, level);
                self.boxes[number].tile = Some(self.tiles.len() as u32);
                self.tiles.push(tile);
                return;
            }
            self.boxes[number].tile = None;
        }
        if let Some((_, _, halves)) = self.boxes[number].halves {
            for half in halves {
                let bounds = self.boxes[half].bounds;
                let of_half = inside.iter().copied().filter(|i| self.entries[*i].overlaps(&bounds)).collect();
                self.descend(half, of_half, level);
            }
        }
    }

    /// Whether the tile that stands in a box has just these clusters.
    fn stands(&self, number: usize, inside: &[usize]) -> bool {
        let known = self.boxes[number].tile.filter(|_| matches!(self.layout, Layout::Triangles(_)));
        known.is_some_and(|tile| {
            let clusters = self.tiles[tile as usize].clusters.iter().copied();
            clusters.eq(inside.iter().map(|i| self.entries[*i].at))
        })
    }

    /// The axis across which a box of a level is halved, if it is.
    fn axis(&self, number: usize, inside: &[usize], level: u32) -> Option<usize> {
        let Halved { bounds, depth, .. } = &self.boxes[number];
        match self.layout {
            Layout::Triangles(most) => {
                let has = |entry: &Entry| {
                    let center = entry.bounds.center();
                    (0..3).all(|k| bounds.min[k] <= center[k] && center[k] < bounds.max[k])
                };
                let entries = inside.iter().map(|i| &self.entries[*i]);
                let triangles: u64 = entries.filter(|e| has(e)).map(|e| u64::from(e.triangles)).sum();
                let side = |k: usize| bounds.max[k] - bounds.min[k];
                // The longest side.
                let axis = (0..3).fold(0, |best, k| if side(k) > side(best) { k } else { best });
                (triangles > u64::from(*most) && *depth < MAX_DEPTH).then_some(axis)
            }
            Layout::Grid { levels, .. } => {
                (*depth < 3 * levels[level as usize].1).then_some((depth % 3) as usize)
            }
        }
    }

    /// Halves a box that is too large for a level.
    fn halve(&mut self, number: usize, inside: &[usize], level: u32) -> bool {
        let Some(axis) = self.axis(number, inside, level) else { return false };
        let Halved { bounds, depth, .. } = self.boxes[number];
        let middle = bounds.center()[axis];
        if !(bounds.min[axis] < middle && middle < bounds.max[axis]) {
            return false;
        }
        let (mut below, mut above) = (bounds, bounds);
        (below.max[axis], above.min[axis]) = (middle, middle);
        let before = self.replaced_in(number);
        let first = self.boxes.len();
        for bounds in [below, above] {
            self.boxes.push(Halved { bounds, depth: depth + 1, halves: None, tile: None, before });
        }
        self.boxes[number].halves = Some((axis, middle, [first, first + 1]));
        true
    }

    /// The tile that what comes into a box replaces.
    fn replaced_in(&self, number: usize) -> Option<u32> {
        self.boxes[number].tile.or(self.boxes[number].before)
    }

    fn tile(&self, number: usize, inside: &[usize], level: u32) -> Tile {
        let made = || inside.iter().filter_map(|i| self.dag.groups.get(self.entries[*i].refined as usize));
        Tile {
            level,
            parent: self.replaced_in(number),
            bounds: self.boxes[number].bounds,
            error: made().map(|group| group.distance()).fold(0.0, f32::max),
            attribute_error: made().map(|group| group.attribute_error).fold(0.0, f32::max),
            whole: inside.iter().all(|i| self.entries[*i].own == SOURCE_ERROR),
            clusters: inside.iter().map(|i| self.entries[*i].at).collect(),
        }
    }
}

impl Plan {
    /// Whether a box has a neighbour beyond its lower (0) or upper (1) plane across an axis.
    pub fn is_inner(&self, bounds: &Aabb, axis: usize, upper: bool) -> bool {
        let all = &self.boxes[0].bounds;
        if upper { bounds.max[axis] < all.max[axis] } else { bounds.min[axis] > all.min[axis] }
    }

    /// Where halvings on either side meet a plane within a box: `bounds` is flat along `side`.
    pub fn crossings(&self, bounds: &Aabb, side: usize) -> Vec<Crossing> {
        let mut out = Vec::new();
        let mut stack = vec![0];
        while let Some(number) = stack.pop() {
            let found = &self.boxes[number];
            let Some((axis, value, halves)) = found.halves else { continue };
            let touches =
                |k: usize| found.bounds.min[k] <= bounds.max[k] && bounds.min[k] <= found.bounds.max[k];
            if !(0..3).all(touches) {
                continue;
            }
            stack.extend(halves);
            if axis != side && bounds.min[axis] < value && value < bounds.max[axis] {
                let third = 3 - axis - side;
                let reach = [found.bounds.min[third], found.bounds.max[third]];
                out.push(Crossing { axis, value, reach });
            }
        }
        out
    }
}
