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
pub mod quadric;
pub mod queue;
pub mod surface;
pub mod wedges;

use glam::DVec3;
use rustc_hash::FxHashSet;

use self::forms::{Channel, Forms, Sums};
use self::quadric::Quadric;
use self::queue::Queue;
use self::surface::{Edge, NONE, Surface};
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
    /// Faces get no thinner than this, area against sides (an equilateral triangle has 0.289), unless they are so.
    pub thin: f64,
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
            eager: false,
        }
    }
}

/// The first columns of an attribute row hold the normal.
const NORMAL_COLUMNS: usize = 3;

/// Farthest that a point is placed from the middle of its edge, in lengths of the edge.
const REACH: f64 = 2.0;

/// Collapses edges until at most `target` triangles are left or no edge may collapse.
///
/// Points (distinct positions) of `mesh` with `locked` set on a vertex stay, as do the attributes of their vertices.
/// `rows` holds the attributes of each vertex, `weights` one weight for each float of a row: a unit of it as a part of
/// the mesh's extent (the longest side of its box). Returns the mesh with its vertices in their places, some moved and
/// with new attributes, the triangles that are left; and the largest root of the mean squared distance of a new point
/// to the planes of the faces it replaced, in the unit of the positions: an estimate, not a bound.
///
/// Topology by position is kept, for any input; triangles with two corners at one position are dropped.
pub fn collapse(
    mesh: &LocalMesh,
    locked: &[bool],
    rows: Vec<f32>,
    weights: &[f32],
    target: usize,
    policy: &Policy,
) -> (LocalMesh, f32) {
    let mut collapser = Collapser::new(mesh, locked, rows, weights, *policy);
    let error = collapser.run(target);
    (collapser.finish(mesh), error)
}

/// What is known of an edge in the queue.
#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    /// Number of collapses when it was looked at.
    seen: u32,
    /// Its best place folds the surface; its cost is that of the next best.
    second: bool,
    /// Its best place, whether it folds the surface or not.
    place: DVec3,
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
    fn new(mesh: &LocalMesh, locked: &[bool], rows: Vec<f32>, weights: &[f32], policy: Policy) -> Self {
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
        let surface = Surface::new(places.iter().map(local).collect(), is_locked, &point_of, &mesh.indices);
        let stride = weights.len();
        let channels = (0..stride)
            .filter(|k| weights[*k] > 0.0)
            .map(|column| {
                let factor = if column < NORMAL_COLUMNS { policy.normal_weight.sqrt() } else { 1.0 };
                Channel { column, weight: f64::from(weights[column]) * factor }
            })
            .collect();
        let forms = Forms::new(&surface, &rows, stride, mesh.positions.len(), channels, policy);
        let area: f64 = (0..surface.faces.len()).map(|f| forms.plane(f).1).sum();
        let mean = area / surface.faces.len().max(1) as f64;
        Self {
            policy,
            center,
            extent,
            attribute_limit: policy.attribute_limit * policy.attribute_limit * mean * 4.0 / 3f64.sqrt(),
            queue: Queue::default(),
            entries: vec![Entry::default(); surface.edges.len()],
            blocked: vec![false; surface.edges.len()],
            waiting: vec![false; places.len()],
            changed: vec![0; places.len()],
            rank: ranks(mesh, &point_of, places.len()),
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

    /// Collapses down to `target` triangles; returns the error.
    fn run(&mut self, target: usize) -> f32 {
        self.queue.reset(self.surface.edges.len());
        for edge in 0..self.surface.edges.len() as u32 {
            self.look(edge);
        }
        let mut worst = 0.0f64;
        while self.surface.alive > target {
            let Some((edge, cost)) = self.queue.peek() else { break };
            let [a, b] = self.surface.edges[edge as usize].ends;
            let Entry { seen, second, place: mut position, .. } = self.entries[edge as usize];
            if seen < self.changed[a as usize].max(self.changed[b as usize]) {
                self.look(edge);
                continue;
            }
            if !self.surface.can_collapse(edge) {
                self.block(edge);
                continue;
            }
            if second || self.forms.folds(&self.surface, edge, position) {
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
            let squared = self.forms.squared_distance(&self.surface, edge, position);
            worst = worst.max(squared);
            let drift = self.past(edge) + squared;
            match self.apply(edge, position) {
                Some(point) => {
                    self.drift[point as usize] = drift;
                    self.look_around();
                }
                None => self.block(edge),
            }
        }
        (worst.sqrt() * self.extent) as f32
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
        let (place, cost) = self.best_place(edge, &self.sums);
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
        if self.policy.even && sums.area > 0.0 { total * (total / sums.area).sqrt().sqrt() } else { total }
    }

    /// The best place for the point that an edge becomes, whether it folds the surface or not, and its cost.
    fn best_place(&self, edge: u32, sums: &Sums) -> (DVec3, f64) {
        let (ends, locked) = self.ends(edge);
        if let Some(place) = locked {
            return (place, self.cost(sums, ends, place));
        }
        let middle = (ends[0] + ends[1]) * 0.5;
        let mut whole = self.to_minimize(sums);
        if self.policy.volume_weight > 0.0 && sums.area > 0.0 {
            whole.add_square(sums.volume, self.policy.volume_weight / sums.area);
        }
        let reach = REACH * REACH * ends[0].distance_squared(ends[1]);
        whole
            .minimum_near(middle, self.policy.shape_weight * sums.area)
            .filter(|offset| offset.length_squared() <= reach)
            .map(|offset| (middle + offset, self.cost(sums, ends, middle + offset)))
            .or_else(|| self.cheapest(self.places_on(ends, sums), sums, ends, |_| true))
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

    fn cheapest(
        &self,
        places: [DVec3; 4],
        sums: &Sums,
        ends: [DVec3; 2],
        fits: impl Fn(DVec3) -> bool,
    ) -> Option<(DVec3, f64)> {
        let mut priced = places.map(|p| (p, self.cost(sums, ends, p)));
        priced.sort_by(|a, b| a.1.total_cmp(&b.1));
        priced.into_iter().find(|(p, _)| fits(*p))
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
        self.cheapest(places, sums, ends, |p| !self.forms.folds(&self.surface, edge, p))
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
        surface.collapse(edge, keep, at, |e| queue.remove(e));
        self.forms.merge(keep, other);
        if !self.rank.is_empty() {
            self.rank[keep as usize] = self.rank[keep as usize].max(self.rank[other as usize]);
        }
        self.waiting[keep as usize] |= self.waiting[other as usize];
        self.merge.apply(surface, &mut self.rows, self.stride, keep);
        self.count += 1;
        self.ring.clear();
        for (f, k) in surface.around(keep) {
            self.forms.set_face(surface, &self.rows, f);
            for p in [(k + 1) % 3, (k + 2) % 3].map(|j| surface.faces[f].points[j]) {
                if self.changed[p as usize] != self.count {
                    self.changed[p as usize] = self.count;
                    self.ring.push(p);
                }
            }
        }
        self.changed[keep as usize] = self.count;
        self.ring.push(keep);
        for p in &self.ring {
            self.forms.touch(*p);
        }
        Some(keep)
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

    /// The mesh as it is now.
    fn finish(self, mesh: &LocalMesh) -> LocalMesh {
        let mut out = LocalMesh {
            ids: mesh.ids.clone(),
            positions: mesh.positions.clone(),
            attributes: self.rows,
            labels: mesh.labels.clone(),
            materials: mesh.materials.clone(),
            position_ids: mesh.position_ids.clone(),
            locked: mesh.locked.clone(),
            indices: Vec::with_capacity(3 * self.surface.alive),
        };
        for face in self.surface.faces.iter().filter(|f| f.alive()) {
            for (w, p) in face.wedges.iter().zip(face.points) {
                out.positions[*w as usize] = self.places[p as usize];
            }
            out.indices.extend(face.wedges);
        }
        out
    }
}

#[cfg(test)]
mod tests;
