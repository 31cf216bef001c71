//! Simplifying a mesh by collapsing edges, cheapest first, with *memoryless* quadrics.
//!
//! The cost of a collapse is measured against the faces around its edge as they are now, not against planes
//! remembered from the source (Lindstrom and Turk, "Fast and Memory Efficient Polygonal Simplification", 1998; Hoppe
//! 1999): about a fifth less error than remembered quadrics at the same number of triangles. A collapse changes the
//! costs of some 40 edges around it. As costs mostly rise, each is looked at again only when it comes to the front of
//! the queue, about four for each collapse; looking at all of them at once (`Policy::eager`) was measured to take
//! twice the time for the same error. What may collapse is decided by `surface`, what it costs and where it goes by
//! `forms`, what attributes become by `wedges`.

pub mod forms;
pub mod parts;
pub mod quadric;
pub mod queue;
pub mod sheets;
pub mod surface;
pub mod wedges;

use glam::DVec3;
use rustc_hash::FxHashSet;

use self::forms::{Channel, Forms, MOST_FOLDED, Sums};
use self::parts::Parts;
use self::quadric::Quadric;
use self::queue::Queue;
use self::surface::{Edge, NONE, Opening, Ring, Surface};
use self::wedges::Merge;
use super::store::LocalMesh;
use crate::math::Aabb;

/// What is minimized.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cost {
    /// Squared distances to the planes around as they are now, weighted by area.
    #[default]
    Memoryless,
    /// Squared distances to all planes that ever were around (Garland and Heckbert 1997).
    GarlandHeckbert,
    /// Squared volumes against the faces around as they are now (Lindstrom and Turk 1998).
    LindstromTurk,
}

/// How to collapse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Policy {
    /// What is minimized.
    pub cost: Cost,
    /// Weight of a border against the surface: of squared distance to the plane that stands on it, times its length
    /// squared.
    pub border_weight: f64,
    /// The same for an edge across which attributes change.
    pub crease_weight: f64,
    /// Weight of the squared mean signed distance when a point is placed: keeps the volume.
    pub volume_weight: f64,
    /// Weight of the squared deviation of attributes against squared distance in the cost of a collapse.
    pub attribute_weight: f64,
    /// The same where a point is placed: enough to decide where the shape does not.
    pub attribute_pull: f64,
    /// Weight of the squared deviation of normals, which mostly follow the shape, against that of other attributes.
    /// With 1 the shape of scans is up to a tenth worse and pictures of them at one pixel up to 0.1 dB better.
    pub normal_weight: f64,
    /// Attributes cost less than this part of the mean edge length, however much they deviate.
    pub attribute_limit: f64,
    /// Weight of the squared distances that past collapses left at the ends of an edge: keeps them from adding up.
    pub drift_weight: f64,
    /// Raises costs by the fourth root of the mean squared distance: small parts far off count more, which lowers the
    /// largest deviation and leaves the mean as it is.
    pub even: bool,
    /// Weight of the squared distance that the ends of an edge move, whichever way: decides where nothing else does.
    pub shape_weight: f64,
    /// Cosine of the largest turn of a face.
    pub turn: f64,
    /// Collapses that make a face thinner than this wait, area against sides (an equilateral triangle has 0.289), unless
    /// it is so: they cost more, as if they moved the surface by a small part of the length of their edge.
    pub thin: f64,
    /// Whether sheets that touch are taken apart, rings are cut and parts go as a whole. Otherwise the topology is kept.
    pub cuts: bool,
    /// A direction that faces go on facing where they do.
    pub up: Option<DVec3>,
    /// Look at every edge again whose surroundings changed, at once; otherwise when it comes to the front.
    pub eager: bool,
}

impl Default for Policy {
    fn default() -> Self {
        Self {
            cost: Cost::default(),
            border_weight: 2.0,
            crease_weight: 0.5,
            volume_weight: 0.0,
            attribute_weight: 0.025,
            attribute_pull: 0.02,
            normal_weight: 0.2,
            attribute_limit: 0.5,
            drift_weight: 0.3,
            even: true,
            shape_weight: 1.0e-9,
            turn: 0.2,
            thin: 0.02,
            cuts: true,
            up: None,
            eager: false,
        }
    }
}

impl Policy {
    /// The power of a length that a cost is.
    fn power(&self) -> f64 {
        if self.even { 4.5 } else { 4.0 }
    }

    /// A cost by the mean squared distance behind it: see [`Policy::even`].
    #[inline]
    fn evened(&self, cost: f64, squared: f64) -> f64 {
        if self.even { cost * squared.sqrt().sqrt() } else { cost }
    }

    /// What a collapse costs, [`Collapsed::cost`], as a length.
    pub fn length_of(&self, cost: f64) -> f64 {
        cost.powf(1.0 / self.power())
    }
}

/// The first columns of an attribute row hold the normal.
const NORMAL_COLUMNS: usize = 3;

/// What a collapse that makes a thin face costs more: this part of the length of the edge, as a distance.
const THIN_COST: f64 = 0.003;

/// Attributes that deviate by no more than this part of their limit are the same but for rounding.
const ALIKE: f64 = 1.0e-3;

/// Farthest that a point is placed from the middle of its edge, in lengths of the edge.
const REACH: f64 = 2.0;

/// How far to collapse.
#[derive(Clone, Copy, Debug)]
pub struct Limit {
    /// Triangles to stop at.
    pub target: usize,
    /// The cost to stop at, see [`Collapsed::cost`].
    pub cost: f64,
    /// Points go no farther from any plane around their edge, nor from the planes that stand on borders and lines, and
    /// attributes deviate no more than by rounding where this is finite. In the unit of the positions. Goes with policies
    /// that do not cut.
    pub distance: f64,
}

impl Limit {
    /// Down to so many triangles, whatever it costs.
    pub fn triangles(target: usize) -> Self {
        Self { target, cost: f64::INFINITY, distance: f64::INFINITY }
    }
}

/// What is left of a mesh.
#[derive(Debug)]
pub struct Collapsed {
    /// Its vertices in their places, some moved and with new attributes, and the triangles that are left.
    pub mesh: LocalMesh,
    /// The largest root of the mean squared distance of a new point to the planes of the faces it replaced, in the unit
    /// of the positions, or of a part that went to what is left: an estimate, not a bound.
    pub error: f32,
    /// The same without parts that went.
    pub moved: f32,
    /// The largest cost of a collapse: an area times a squared distance, times the root of the root of such a distance
    /// where [`Policy::even`] is set, in the unit of the positions. Costs of different meshes compare.
    pub cost: f64,
    /// For each collapse the largest cost so far, and the triangles that were left.
    pub trace: Vec<(f64, u32)>,
    /// Whether it stopped at the cost to stop at.
    pub stopped: bool,
}

/// Collapses edges until a limit is reached or no edge may collapse.
///
/// Points (distinct positions) of `mesh` with `locked` set on a vertex stay, as do the attributes of their vertices.
/// `rows` holds the attributes of each vertex, `weights` one weight for each float of a row: a unit of it as a part of
/// the mesh's extent (the longest side of its box).
///
/// Sheets that touch are taken apart, so that vertices may be added at the end, see [`LocalMesh::copies`]. Edges never
/// get more faces than they have. Triangles with two corners at one position are dropped.
pub fn collapse(
    mesh: &LocalMesh,
    locked: &[bool],
    rows: Vec<f32>,
    weights: &[f32],
    limit: Limit,
    policy: &Policy,
) -> Collapsed {
    let mut collapses = Collapses::new(mesh, locked, rows, weights, policy);
    let stopped = collapses.proceed(limit);
    Collapsed { stopped, ..collapses.finish(mesh) }
}

/// Collapses that can go on where they stopped: see [`collapse`].
pub struct Collapses {
    collapser: Collapser,
    /// What costs and distances inside are multiples of.
    unit: f64,
}

impl Collapses {
    /// Takes in a mesh, and finds what its edges cost.
    pub fn new(mesh: &LocalMesh, locked: &[bool], rows: Vec<f32>, weights: &[f32], policy: &Policy) -> Self {
        let mut collapser = Collapser::new(mesh, locked, rows, weights, *policy);
        collapser.start();
        let unit = collapser.extent.powf(policy.power());
        Self { collapser, unit }
    }

    /// Collapses until a limit is reached or no edge may collapse; true where the cost was the limit.
    pub fn proceed(&mut self, limit: Limit) -> bool {
        let (cost, distance) = (limit.cost / self.unit, limit.distance / self.collapser.extent);
        self.collapser.run(Limit { cost, distance, ..limit })
    }

    /// Triangles that are left.
    pub fn triangles(&self) -> usize {
        self.collapser.surface.alive
    }

    /// What the next step costs as far as that is known; none where nothing may collapse.
    pub fn next_cost(&self) -> Option<f64> {
        let edge = self.collapser.queue.peek().map(|(_, cost)| cost);
        let part = self.collapser.part_queue.peek().map(|(_, cost)| cost);
        let least = edge.into_iter().chain(part).min_by(f32::total_cmp)?;
        Some(f64::from(least) * self.unit)
    }

    /// What is left of the mesh.
    pub fn finish(mut self, mesh: &LocalMesh) -> Collapsed {
        let collapser = &mut self.collapser;
        let Worst { moved, gone, .. } = collapser.worst;
        let length = |squared: f64| (squared.sqrt() * collapser.extent) as f32;
        let (error, moved) = (length(moved.max(gone)), length(moved));
        let mut trace = std::mem::take(&mut collapser.trace);
        trace.iter_mut().for_each(|(cost, _)| *cost *= self.unit);
        let cost = trace.last().map_or(0.0, |(cost, _)| *cost);
        Collapsed { mesh: self.collapser.finish(mesh), error, moved, cost, trace, stopped: false }
    }
}

/// The largest of what steps did so far.
#[derive(Clone, Copy, Debug, Default)]
struct Worst {
    /// Squared distances that collapses moved, and those of parts that went.
    moved: f64,
    gone: f64,
    cost: f32,
}

/// What is known of an edge in the queue.
#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    /// Number of collapses when it was looked at.
    seen: u32,
    /// Its best place folds the surface; its cost is that of the next best.
    second: bool,
    /// It waited as it makes a thin face.
    thin: bool,
    /// It waited for a ring or an opening in its way.
    ring: bool,
    /// Distances around the fold that it lies on are part of its cost. They take long, and edges that never come to the
    /// front do without.
    priced: bool,
    /// Its best place, whether it folds the surface or not.
    place: DVec3,
}

/// What stands in the way of a collapse.
enum Obstacle {
    /// The surface is cut along it, and closed.
    Ring(Ring),
    /// It is closed.
    Opening(Opening),
}

/// A position as it may be looked up: both zeros are one.
fn bits(position: [f32; 3]) -> [u32; 3] {
    position.map(|x| (x + 0.0).to_bits())
}

/// See [`Collapser::rank`].
fn ranks(mesh: &LocalMesh, point_of: &[u32], points: usize) -> Vec<u8> {
    if mesh.materials.windows(2).all(|pair| pair[0] == pair[1]) {
        return Vec::new();
    }
    let mut at_points: Vec<(u32, u32)> =
        point_of.iter().copied().zip(mesh.materials.iter().copied()).collect();
    at_points.sort_unstable();
    at_points.dedup();
    let mut ranks = vec![0; points];
    at_points.windows(2).filter(|pair| pair[0].0 == pair[1].0).for_each(|pair| {
        let rank = &mut ranks[pair[0].0 as usize];
        *rank = 2.min(*rank + 1);
    });
    ranks
}

struct Collapser {
    policy: Policy,
    worst: Worst,
    /// What hangs together, and in which order it may go.
    parts: Parts,
    part_queue: Queue,
    /// Rings along which the surface was cut: their points, and the copies of these.
    rings: Vec<[[u32; 3]; 2]>,
    /// The vertex that each further one is a copy of, and how many there were.
    copies: Vec<u32>,
    vertices: usize,
    /// See [`Collapsed::trace`].
    trace: Vec<(f64, u32)>,
    /// Internal = center + extent · local.
    center: DVec3,
    extent: f64,
    attribute_limit: f64,
    surface: Surface,
    forms: Forms,
    queue: Queue,
    entries: Vec<Entry>,
    /// Edges taken out of the queue until something around them changes.
    blocked: Vec<bool>,
    /// Points at which any edge may be blocked.
    waiting: Vec<bool>,
    /// Number of collapses when the faces at a point last changed.
    changed: Vec<u32>,
    /// Collapses so far.
    count: u32,
    /// Internal positions of the points.
    places: Vec<[f32; 3]>,
    /// The same as [`bits`]: no point may come to lie on another one, which would join them.
    taken: FxHashSet<[u32; 3]>,
    rows: Vec<f32>,
    stride: usize,
    merge: Merge,
    /// Number of materials that meet at each point, less one, and at most two: inside one material, on a line
    /// between two, where lines meet. Empty when there are no materials.
    rank: Vec<u8>,
    /// Squared distances that collapses left at each point, added up.
    drift: Vec<f64>,
    /// Sums of the edge weighed last.
    sums: Sums,
    ring: Vec<u32>,
    pending: Vec<u32>,
}

impl Collapser {
    fn new(mesh: &LocalMesh, locked: &[bool], mut rows: Vec<f32>, weights: &[f32], policy: Policy) -> Self {
        let bounds = Aabb::of_points(&mesh.positions);
        let [min, max] = [bounds.min, bounds.max].map(|p| DVec3::from_array(p.map(f64::from)));
        let extent = Some((max - min).max_element()).filter(|e| *e > 0.0 && e.is_finite()).unwrap_or(1.0);
        let center = Some((min + max) * 0.5).filter(|c| c.is_finite()).unwrap_or(DVec3::ZERO);
        let mut point_of = vec![NONE; mesh.positions.len()];
        let mut places: Vec<[f32; 3]> = Vec::new();
        let mut is_locked = Vec::new();
        for v in 0..mesh.positions.len() {
            let first = mesh.position_ids[v] as usize;
            if point_of[first] == NONE {
                point_of[first] = places.len() as u32;
                places.push(mesh.positions[first]);
                is_locked.push(false);
            }
            point_of[v] = point_of[first];
            is_locked[point_of[v] as usize] |= locked[v];
        }
        let local = |p: &[f32; 3]| (DVec3::from_array(p.map(f64::from)) - center) / extent;
        let mut surface =
            Surface::new(places.iter().map(local).collect(), is_locked, &point_of, &mesh.indices);
        let stride = weights.len();
        let mut copies = Vec::new();
        if policy.cuts
            && let Some(apart) = sheets::take_apart(&surface, mesh.positions.len())
        {
            let Surface { mut positions, mut locked, .. } = surface;
            for (p, q, part) in apart.places {
                let place = positions[p as usize].lerp(positions[q as usize], part);
                let internal = (center + place * extent).as_vec3().to_array();
                let is_copy = part == 0.0;
                places.push(if is_copy { places[p as usize] } else { internal });
                positions.push(if is_copy { positions[p as usize] } else { local(&internal) });
            }
            for (v, w, part) in apart.wedges {
                let row = |w: u32, j: usize| rows[w as usize * stride + j];
                let mixed = |j: usize| row(v, j) + part as f32 * (row(w, j) - row(v, j));
                let new: Vec<f32> = (0..stride).map(mixed).collect();
                rows.extend(new);
                copies.push((v as usize).checked_sub(mesh.positions.len()).map_or(v, |copy| copies[copy]));
            }
            point_of.extend(&apart.points);
            locked.resize(positions.len(), false);
            surface = Surface::new(positions, locked, &point_of, &apart.corners);
        }
        let channels = (0..stride)
            .filter(|k| weights[*k] > 0.0)
            .map(|column| {
                let factor = if column < NORMAL_COLUMNS { policy.normal_weight.sqrt() } else { 1.0 };
                Channel { column, weight: f64::from(weights[column]) * factor }
            })
            .collect();
        let forms = Forms::new(&surface, &rows, stride, point_of.len(), channels, policy);
        let area: f64 = (0..surface.faces.len()).map(|f| forms.plane(f).1).sum();
        let mean = area / surface.faces.len().max(1) as f64;
        Self {
            policy,
            worst: Worst::default(),
            center,
            extent,
            attribute_limit: policy.attribute_limit * policy.attribute_limit * mean * 4.0 / 3f64.sqrt(),
            queue: Queue::default(),
            entries: vec![Entry::default(); surface.edges.len()],
            blocked: vec![false; surface.edges.len()],
            waiting: vec![false; places.len()],
            changed: vec![0; places.len()],
            rank: ranks(mesh, &point_of, places.len()),
            parts: if policy.cuts { Parts::of(&surface) } else { Parts::default() },
            part_queue: Queue::default(),
            rings: Vec::new(),
            copies,
            trace: Vec::new(),
            vertices: mesh.positions.len(),
            drift: vec![0.0; places.len()],
            count: 0,
            taken: places.iter().copied().map(bits).collect(),
            places,
            rows,
            stride,
            merge: Merge::default(),
            sums: Sums::default(),
            ring: Vec::new(),
            pending: Vec::new(),
            surface,
            forms,
        }
    }

    /// Finds what all edges and parts cost.
    fn start(&mut self) {
        self.queue.reset(self.surface.edges.len());
        for edge in 0..self.surface.edges.len() as u32 {
            self.look(edge);
        }
        self.part_queue.reset(self.parts.all.len());
        (0..self.parts.all.len() as u32).for_each(|part| self.queue_part(part));
    }

    /// Collapses up to a limit, which is in its own units; returns whether the cost was the limit.
    fn run(&mut self, limit: Limit) -> bool {
        let Limit { target, cost: limit, distance: reach } = limit;
        let mut stopped = false;
        while self.surface.alive > target {
            let part = self.part_queue.peek();
            let next = self.queue.peek();
            if let Some((part, cost)) = part
                && next.is_none_or(|(_, next)| cost <= next)
            {
                let Some(squared) = self.leave_out(part, cost, target, limit, next.is_none()) else {
                    continue;
                };
                self.worst.gone = self.worst.gone.max(squared);
                self.took(cost);
                continue;
            }
            let Some((edge, cost)) = next else { break };
            if f64::from(cost) > limit {
                stopped = true;
                break;
            }
            let [a, b] = self.surface.edges[edge as usize].ends;
            let Entry { seen, second, thin, ring, priced, place: mut position } = self.entries[edge as usize];
            if seen < self.changed[a as usize].max(self.changed[b as usize]) {
                self.look(edge);
                continue;
            }
            if !priced {
                self.price_fold(edge);
                continue;
            }
            if !self.surface.can_collapse(edge) {
                match self.obstacle(edge) {
                    None => self.block(edge),
                    Some(Obstacle::Ring(found)) if ring => self.cut(&found),
                    Some(Obstacle::Opening(found)) if ring => {
                        self.worst.gone = self.worst.gone.max(self.closing(found.points).1);
                        self.close(&found);
                    }
                    Some(Obstacle::Ring(Ring { points, .. }) | Obstacle::Opening(Opening { points, .. })) => {
                        let (area, squared) = self.closing(points);
                        let later = f64::from(cost) + self.policy.evened(area * squared, squared);
                        self.entries[edge as usize].ring = true;
                        self.queue.set(edge, later as f32);
                    }
                }
                continue;
            }
            if self.surface.makes_chord(edge) {
                self.block(edge);
                continue;
            }
            if second || self.forms.folds(&self.surface, &self.rows, edge, position) {
                let Some((place, next)) = self.other_place(edge) else {
                    self.block(edge);
                    continue;
                };
                if !second && next as f32 > cost {
                    self.entries[edge as usize].second = true;
                    self.queue.set(edge, next as f32);
                    continue;
                }
                position = place;
            }
            if reach < f64::INFINITY && !self.keeps_all(edge, position, reach) {
                self.block(edge);
                continue;
            }
            if !thin && self.forms.thins(&self.surface, edge, position) {
                self.entries[edge as usize].thin = true;
                self.queue.set(edge, self.later(edge, f64::from(cost)) as f32);
                continue;
            }
            let squared = self.forms.squared_distance(&self.surface, edge, position);
            let drift = self.past(edge) + squared;
            match self.apply(edge, position) {
                Some(point) => {
                    self.worst.moved = self.worst.moved.max(squared);
                    self.took(cost);
                    self.drift[point as usize] = drift;
                    self.look_around();
                }
                None => self.block(edge),
            }
        }
        stopped
    }

    /// Takes down a step.
    fn took(&mut self, cost: f32) {
        self.worst.cost = self.worst.cost.max(cost);
        self.trace.push((self.worst.cost.into(), self.surface.alive as u32));
    }

    /// Whether an edge collapses to a place without a change of more than `reach` in the shape, or than rounding in what
    /// it carries.
    fn keeps_all(&mut self, edge: u32, place: DVec3, reach: f64) -> bool {
        if self.forms.farthest(&self.surface, edge, place) > reach
            || !self.forms.edge(&self.surface, edge, &mut self.sums)
        {
            return false;
        }
        self.sums.attribute.at(place) <= ALIKE * ALIKE * self.attribute_limit * self.sums.area
    }

    /// What an edge costs that makes a thin face.
    fn later(&self, edge: u32, cost: f64) -> f64 {
        let ends = self.surface.edges[edge as usize].ends.map(|p| self.surface.positions[p as usize]);
        let squared = THIN_COST * THIN_COST * ends[0].distance_squared(ends[1]);
        cost + self.policy.evened(self.sums_area(edge) * squared, squared)
    }

    /// The area of the faces around an edge.
    fn sums_area(&self, edge: u32) -> f64 {
        let ends = self.surface.edges[edge as usize].ends;
        let faces = ends.into_iter().flat_map(|p| self.surface.around(p));
        faces.map(|(f, _)| self.forms.plane(f).1).sum()
    }

    /// Puts a part in its place if it may go as a whole, as if it cost nothing: what it costs is worked out in front.
    fn queue_part(&mut self, part: u32) {
        if self.parts.may_go(part) && self.parts.several() {
            self.part_queue.set(part, 0.0);
        }
    }

    /// Leaves out a part that came to the front, or puts it where it belongs. Returns the mean squared distance of what
    /// is left out.
    fn leave_out(&mut self, part: u32, cost: f32, target: usize, limit: f64, last: bool) -> Option<f64> {
        let Some(alive) = self.parts.may_go(part).then(|| self.parts.all[part as usize].alive) else {
            self.part_queue.remove(part);
            return None;
        };
        let Some((sum, area)) = self.parts.apart(&self.surface, part) else {
            self.part_queue.remove(part);
            return None;
        };
        let squared = if area > 0.0 { sum / area } else { 0.0 };
        // As much for each pair of triangles as for a collapse, which takes two.
        let now = self.policy.evened(2.0 * sum / f64::from(alive), squared);
        if now as f32 > cost {
            self.part_queue.set(part, now as f32);
            return None;
        }
        self.part_queue.remove(part);
        let fits = self.surface.alive >= target + alive as usize;
        if f64::from(cost) > limit || !(fits || last) {
            return None;
        }
        let faces = std::mem::take(&mut self.parts.all[part as usize].faces);
        for f in faces {
            let face = &self.surface.faces[f as usize];
            if !face.alive() || self.parts.at(face.points[0]) != part {
                continue;
            }
            let edges = face.edges;
            edges.into_iter().for_each(|e| self.queue.remove(e));
            self.surface.remove_face(f as usize);
        }
        self.parts.went(&self.surface, part);
        Some(squared)
    }

    fn block(&mut self, edge: u32) {
        self.queue.remove(edge);
        self.blocked[edge as usize] = true;
        self.surface.edges[edge as usize].ends.iter().for_each(|p| self.waiting[*p as usize] = true);
    }

    /// Works out what an edge costs now and puts it in its place.
    fn look(&mut self, edge: u32) {
        self.entries[edge as usize] = Entry { seen: self.count, ..Entry::default() };
        self.blocked[edge as usize] = false;
        if self.surface.edges[edge as usize].ends.iter().all(|p| self.surface.locked[*p as usize]) {
            // For good: it waits for nothing.
            self.queue.remove(edge);
            return;
        }
        if self.fixed(edge) == [true; 2] || !self.forms.edge(&self.surface, edge, &mut self.sums) {
            self.block(edge);
            return;
        }
        let folded = self.is_folded(edge, &self.sums);
        self.entries[edge as usize].priced = !folded;
        self.put(edge, false);
    }

    /// Adds what distances around the fold that an edge lies on cost, and puts it in its place.
    fn price_fold(&mut self, edge: u32) {
        self.entries[edge as usize].priced = true;
        if self.forms.edge(&self.surface, edge, &mut self.sums) {
            self.put(edge, true);
        } else {
            self.block(edge);
        }
    }

    /// Puts an edge whose sums were just found in its place.
    fn put(&mut self, edge: u32, folded: bool) {
        let (place, cost) = self.best_place(edge, &self.sums, folded);
        self.entries[edge as usize].place = place;
        self.queue.set(edge, self.total(edge, &self.sums, cost) as f32);
    }

    /// Which ends of an edge stay where they are: locked ones, and those on a line between materials that the edge
    /// is no part of, so that such lines move along themselves alone.
    #[inline]
    fn fixed(&self, edge: u32) -> [bool; 2] {
        let Edge { ends, crease, .. } = self.surface.edges[edge as usize];
        let rank = |p: u32| self.rank.get(p as usize).copied().unwrap_or(0);
        ends.map(|p| self.surface.locked[p as usize] || rank(p) > u8::from(crease))
    }

    /// The ends of an edge, and the one that stays.
    #[inline]
    fn ends(&self, edge: u32) -> ([DVec3; 2], Option<DVec3>) {
        let ends = self.surface.edges[edge as usize].ends;
        let at = ends.map(|p| self.surface.positions[p as usize]);
        let fixed = self.fixed(edge).iter().position(|fixed| *fixed);
        (at, fixed.map(|k| at[k]))
    }

    /// What past collapses left at the ends of an edge.
    fn past(&self, edge: u32) -> f64 {
        let [a, b] = self.surface.edges[edge as usize].ends.map(|p| self.drift[p as usize]);
        a.max(b)
    }

    /// What it costs to put the point that an edge becomes at `p`, apart from [`Self::total`].
    #[inline(always)]
    fn cost(&self, sums: &Sums, ends: [DVec3; 2], p: DVec3) -> f64 {
        let moved = 0.5 * (p.distance_squared(ends[0]) + p.distance_squared(ends[1]));
        let geometry = sums.geometry.at(p).max(0.0);
        let limit = self.attribute_limit * sums.area;
        let deviation = self.policy.attribute_weight * sums.attribute.at(p).max(0.0);
        // Nears the limit without reaching it: what deviates more always costs more.
        let attribute = if limit > 0.0 { deviation * (limit / (deviation + limit)) } else { 0.0 };
        geometry + attribute + self.policy.shape_weight * sums.area * moved
    }

    /// The cost that decides which edge comes first.
    #[inline]
    fn total(&self, edge: u32, sums: &Sums, cost: f64) -> f64 {
        let total = cost + self.policy.drift_weight * self.past(edge) * sums.area;
        if sums.area > 0.0 { self.policy.evened(total, total / sums.area) } else { total }
    }

    /// The best place for the point that an edge becomes, whether it folds the surface or not, and its cost; `folded` with
    /// distances.
    fn best_place(&self, edge: u32, sums: &Sums, folded: bool) -> (DVec3, f64) {
        let (ends, locked) = self.ends(edge);
        if let Some(place) = locked {
            return (place, self.price(edge, sums, ends, place, folded, f64::INFINITY));
        }
        let middle = (ends[0] + ends[1]) * 0.5;
        let mut whole = self.to_minimize(sums);
        if self.policy.volume_weight > 0.0 && sums.area > 0.0 {
            whole.add_square(sums.volume, self.policy.volume_weight / sums.area);
        }
        let reach = REACH * REACH * ends[0].distance_squared(ends[1]);
        let best = whole
            .minimum_near(middle, self.policy.shape_weight * sums.area)
            .filter(|offset| offset.length_squared() <= reach);
        if folded {
            let [along, ..] = self.places_on(ends, sums);
            let places = [best.map_or(along, |offset| middle + offset), middle, ends[0], ends[1]];
            return self
                .cheapest(edge, places, sums, ends, true, |_| true)
                .unwrap_or((middle, f64::INFINITY));
        }
        best.map(|offset| (middle + offset, self.cost(sums, ends, middle + offset)))
            .or_else(|| self.cheapest(edge, self.places_on(ends, sums), sums, ends, false, |_| true))
            .unwrap_or((middle, f64::INFINITY))
    }

    /// What the place of a point minimizes, apart from volume and shape.
    fn to_minimize(&self, sums: &Sums) -> Quadric {
        sums.geometry + sums.attribute.scaled(self.policy.attribute_pull)
    }

    /// Places on an edge: the minimum along it, the middle, the ends.
    fn places_on(&self, ends: [DVec3; 2], sums: &Sums) -> [DVec3; 4] {
        let along = ends[1] - ends[0];
        let whole = self.to_minimize(sums);
        let t = whole.minimum_along(ends[0], along).unwrap_or(0.5).clamp(0.0, 1.0);
        [ends[0] + along * t, ends[0] + along * 0.5, ends[0], ends[1]]
    }

    /// Whether distances around an edge are looked up.
    #[inline]
    fn is_folded(&self, edge: u32, sums: &Sums) -> bool {
        let faces = || {
            let ends = self.surface.edges[edge as usize].ends;
            ends.into_iter().flat_map(|p| self.surface.around(p)).take(MOST_FOLDED + 1).count()
        };
        self.policy.cuts && self.forms.is_folded(&self.surface, edge, sums) && faces() <= MOST_FOLDED
    }

    /// The cost of a place; around a fold by the distances of the faces before and after. Exact up to `most`.
    fn price(&self, edge: u32, sums: &Sums, ends: [DVec3; 2], p: DVec3, folded: bool, most: f64) -> f64 {
        let cost = self.cost(sums, ends, p);
        if folded && cost <= most { cost.max(self.forms.apart(&self.surface, edge, p, most)) } else { cost }
    }

    fn cheapest(
        &self,
        edge: u32,
        places: [DVec3; 4],
        sums: &Sums,
        ends: [DVec3; 2],
        folded: bool,
        fits: impl Fn(DVec3) -> bool,
    ) -> Option<(DVec3, f64)> {
        let mut best: Option<(DVec3, f64)> = None;
        for p in places {
            let most = best.map_or(f64::INFINITY, |(_, price)| price);
            let price = self.price(edge, sums, ends, p, folded, most);
            if (best.is_none() || price < most) && fits(p) {
                best = Some((p, price));
            }
        }
        best
    }

    /// The best place on an edge that does not fold the surface, and its cost.
    fn other_place(&mut self, edge: u32) -> Option<(DVec3, f64)> {
        if !self.forms.edge(&self.surface, edge, &mut self.sums) {
            return None;
        }
        let sums = &self.sums;
        let (ends, locked) = self.ends(edge);
        let places = match locked {
            Some(place) => [place; 4],
            None => self.places_on(ends, sums),
        };
        let folded = self.is_folded(edge, sums);
        let fits = |p| !self.forms.folds(&self.surface, &self.rows, edge, p);
        self.cheapest(edge, places, sums, ends, folded, fits)
            .map(|(place, cost)| (place, self.total(edge, sums, cost)))
    }

    /// Collapses an edge to a place; returns the point that is left. None if its wedges do not match or another
    /// point lies there.
    fn apply(&mut self, edge: u32, position: DVec3) -> Option<u32> {
        let [a, b] = self.surface.edges[edge as usize].ends;
        let fixed = self.fixed(edge);
        let (keep, other) = if fixed[1] { (b, a) } else { (a, b) };
        let surface = &mut self.surface;
        let (mut place, mut at) = (self.places[keep as usize], surface.positions[keep as usize]);
        if fixed == [false; 2] {
            // Continue with the position as it will be stored.
            place = (self.center + position * self.extent).as_vec3().to_array();
            at = (DVec3::from_array(place.map(f64::from)) - self.center) / self.extent;
        }
        // What is stored must face it too.
        if self.policy.up.is_some() && self.forms.folds(surface, &self.rows, edge, at) {
            return None;
        }
        let left = [a, b].map(|p| bits(self.places[p as usize]));
        if !left.contains(&bits(place)) && self.taken.contains(&bits(place)) {
            return None;
        }
        if !self.merge.find(surface, &self.forms, &self.rows, self.stride, edge, keep, at) {
            return None;
        }
        left.iter().for_each(|p| {
            self.taken.remove(p);
        });
        self.taken.insert(bits(place));
        self.places[keep as usize] = place;
        let queue = &mut self.queue;
        let before = surface.alive;
        surface.collapse(edge, keep, at, |e| queue.remove(e));
        self.forms.merge(keep, other);
        let gone = (before - surface.alive) as u32;
        if !self.rank.is_empty() {
            self.rank[keep as usize] = self.rank[keep as usize].max(self.rank[other as usize]);
        }
        self.waiting[keep as usize] |= self.waiting[other as usize];
        self.merge.apply(surface, &mut self.rows, self.stride, keep);
        self.count += 1;
        self.ring.clear();
        self.take_in(keep);
        if !self.parts.all.is_empty() {
            let part = self.parts.at(keep);
            let alive = &mut self.parts.all[part as usize].alive;
            *alive -= gone;
            if !self.part_queue.holds(part) {
                self.queue_part(part);
            }
        }
        for p in &self.ring {
            self.forms.touch(*p);
        }
        Some(keep)
    }

    /// Takes in that a point, and so the faces around it, changed.
    fn take_in(&mut self, point: u32) {
        let surface = &self.surface;
        for (f, k) in surface.around(point) {
            self.forms.set_face(surface, &self.rows, f);
            for p in [(k + 1) % 3, (k + 2) % 3].map(|j| surface.faces[f].points[j]) {
                if self.changed[p as usize] != self.count {
                    self.changed[p as usize] = self.count;
                    self.ring.push(p);
                }
            }
        }
        if self.changed[point as usize] != self.count {
            self.changed[point as usize] = self.count;
            self.ring.push(point);
        }
    }

    /// What stands in the way of an edge, if it can be settled.
    fn obstacle(&mut self, edge: u32) -> Option<Obstacle> {
        if !self.policy.cuts {
            return None;
        }
        if let Some(ring) = self.surface.ring(edge) {
            return Some(Obstacle::Ring(ring));
        }
        let fits = |found: &Opening| {
            // Lines between materials stay, and the new face faces what its neighbours do.
            found.points.iter().all(|p| self.rank.get(*p as usize).is_none_or(|rank| *rank == 0))
                && self.forms.faces_along(&self.surface, &self.rows, found)
        };
        self.surface.opening(edge).filter(fits).map(Obstacle::Opening)
    }

    /// The area of a face between points, and how far it is squared, as if that were a third of its height off.
    fn closing(&self, points: [u32; 3]) -> (f64, f64) {
        let [a, b, c] = points.map(|p| self.surface.positions[p as usize]);
        let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
        let area = 0.5 * (b - a).cross(c - a).length();
        (area, if longest > 0.0 { 4.0 * area * area / longest / 9.0 } else { 0.0 })
    }

    /// Closes an opening.
    fn close(&mut self, opening: &Opening) {
        self.count += 1;
        self.ring.clear();
        self.surface.close(opening);
        self.forms.add_faces(self.surface.faces.len());
        for p in opening.points {
            self.take_in(p);
            self.waiting[p as usize] = true;
        }
        self.ring.iter().for_each(|p| self.forms.touch(*p));
        self.look_around();
        let part = self.parts.take_in_closed(&self.surface, opening.points[0]);
        self.queue_part(part);
    }

    /// Cuts the surface along a ring and closes both sides.
    fn cut(&mut self, ring: &Ring) {
        self.count += 1;
        self.ring.clear();
        let new = ring.points.map(|old| self.copy_point(old));
        let named: [u32; 3] = std::array::from_fn(|i| {
            let corner = ring.fans[i][0] as usize;
            let old = self.surface.faces[corner / 3].wedges[corner % 3];
            self.copies.push(self.origin(old));
            let row = old as usize * self.stride..(old as usize + 1) * self.stride;
            self.rows.extend_from_within(row);
            self.forms.add_wedge();
            (self.vertices + self.copies.len()) as u32 - 1
        });
        self.surface.cut_ring(ring, new, named);
        self.rings.push([ring.points, new]);
        self.forms.add_faces(self.surface.faces.len());
        let edges = self.surface.edges.len();
        self.entries.resize(edges, Entry::default());
        self.blocked.resize(edges, false);
        self.queue.extend(edges);
        for p in ring.points.into_iter().chain(new) {
            self.take_in(p);
            self.waiting[p as usize] = true;
        }
        self.ring.iter().for_each(|p| self.forms.touch(*p));
        for edge in edges - 3..edges {
            self.look(edge as u32);
        }
        self.look_around();
        let known = self.parts.all.len();
        self.parts.take_in_cut(&self.surface, [ring.points[0], new[0]]);
        if self.parts.all.len() > known {
            self.part_queue.extend(self.parts.all.len());
            self.queue_part(known as u32);
        }
        let part = self.parts.at(ring.points[0]);
        self.queue_part(part);
    }

    /// The vertex that a wedge is, or is a copy of.
    fn origin(&self, wedge: u32) -> u32 {
        (wedge as usize).checked_sub(self.vertices).map_or(wedge, |copy| self.copies[copy])
    }

    fn copy_point(&mut self, old: u32) -> u32 {
        let p = old as usize;
        self.waiting.push(false);
        self.changed.push(self.changed[p]);
        self.places.push(self.places[p]);
        if !self.rank.is_empty() {
            self.rank.push(self.rank[p]);
        }
        self.drift.push(self.drift[p]);
        self.forms.add_point();
        self.parts.copy_point(old);
        self.surface.copy_point(old)
    }

    /// Looks again at the edges that touch the ring: all of them, or those that were blocked.
    fn look_around(&mut self) {
        self.pending.clear();
        for p in &self.ring {
            if !std::mem::take(&mut self.waiting[*p as usize]) && !self.policy.eager {
                continue;
            }
            for (f, k) in self.surface.around(*p) {
                let edges = &self.surface.faces[f].edges;
                for edge in [edges[k], edges[(k + 2) % 3]] {
                    if !self.policy.eager && !self.blocked[edge as usize] {
                        continue;
                    }
                    let entry = &mut self.entries[edge as usize];
                    if entry.seen != self.count {
                        entry.seen = self.count;
                        self.pending.push(edge);
                    }
                }
            }
        }
        for k in 0..self.pending.len() {
            self.look(self.pending[k]);
        }
    }

    /// Joins again what was cut along a ring and has not moved since: the faces that close both sides lie in one place, and
    /// edges there would have four of them.
    fn rejoin(&mut self) {
        for [old, new] in std::mem::take(&mut self.rings) {
            let face = |points: [u32; 3]| {
                let mut around = self.surface.around(points[0]).map(|(f, _)| f);
                around.find(|f| points.iter().all(|p| self.surface.faces[*f].points.contains(p)))
            };
            let (Some(front), Some(back)) = (face(old), face(new)) else { continue };
            let name = |f: usize, point: u32| {
                let face = &self.surface.faces[f];
                (0..3).find(|k| face.points[*k] == point).map(|k| face.wedges[k])
            };
            let row = |w: u32| &self.rows[w as usize * self.stride..][..self.stride];
            let names: [Option<u32>; 3] = std::array::from_fn(|i| {
                let (w, copy) = (name(front, old[i])?, name(back, new[i])?);
                let is_copy = |(f, k): (usize, usize)| self.surface.faces[f].wedges[k] == copy;
                let same = self.places[old[i] as usize] == self.places[new[i] as usize]
                    && self.origin(copy) == self.origin(w)
                    && row(copy) == row(w);
                (same && self.surface.around(new[i]).all(is_copy)).then_some(w)
            });
            let [Some(a), Some(b), Some(c)] = names else { continue };
            self.surface.remove_face(front);
            self.surface.remove_face(back);
            for (point, name) in new.into_iter().zip([a, b, c]) {
                self.surface.name(point, name);
            }
        }
    }

    /// The mesh as it is now.
    fn finish(mut self, mesh: &LocalMesh) -> LocalMesh {
        self.rejoin();
        let mut out = LocalMesh { attributes: Vec::new(), ..mesh.with_copies(&self.copies) };
        out.indices = Vec::with_capacity(3 * self.surface.alive);
        // Copies at one point, which may have several wedges, are told by the first of them.
        let count = if self.copies.is_empty() { 0 } else { self.places.len() };
        let (mut first, mut has_other) = (vec![NONE; count], vec![false; count]);
        for face in self.surface.faces.iter().filter(|f| f.alive()) {
            for (w, p) in face.wedges.iter().zip(face.points) {
                out.positions[*w as usize] = self.places[p as usize];
                if *w as usize >= self.vertices {
                    first[p as usize] = first[p as usize].min(*w);
                } else if count > 0 {
                    has_other[p as usize] = true;
                }
            }
            out.indices.extend(face.wedges);
        }
        for face in self.surface.faces.iter().filter(|f| f.alive()) {
            for (w, p) in face.wedges.iter().zip(face.points).filter(|(w, _)| **w as usize >= self.vertices) {
                // Others that came there are told by their place, which is where this is a copy from.
                let there = mesh.position_ids[self.origin(*w) as usize];
                out.position_ids[*w as usize] = if has_other[p as usize] { there } else { first[p as usize] };
            }
        }
        out.attributes = self.rows;
        out
    }
}

#[cfg(test)]
mod tests;
