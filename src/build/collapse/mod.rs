//! Simplifying a mesh by collapsing edges, cheapest first, with *memoryless* quadrics.
//!
//! The cost of a collapse is measured against the faces around its edge as they are now, not against planes
//! remembered from the source (Lindstrom and Turk, "Fast and Memory Efficient Polygonal Simplification", 1998;
//! Hoppe 1999): about a fifth less error than remembered quadrics at the same number of triangles. A collapse
//! changes the costs of some 40 edges around it. Costs mostly rise, so an edge is evaluated again only when it
//! comes to the front of the queue: about four edges for each collapse. Evaluating all of them at once
//! (`Policy::eager`) takes twice the time for the same error.
//!
//! `policy` holds what is minimized and the options, `start` takes a mesh in. `surface` says which collapses are legal,
//! `cost` what they cost and where their point goes, by the quadrics of `forms`; `wedges` says what attributes become.
//! `obstacles` cuts and closes what stands in the way.

pub mod components;
mod cost;
pub mod forms;
mod obstacles;
mod policy;
pub mod quadric;
pub mod queue;
pub mod sheets;
mod start;
pub mod surface;
pub mod wedges;

use glam::DVec3;
use rustc_hash::FxHashSet;

use self::components::Components;
use self::forms::{Forms, Sums};
use self::obstacles::Obstacle;
pub use self::policy::{Cost, Policy};
use self::queue::Queue;
use self::surface::{NONE, Opening, Ring, Surface};
use self::wedges::Merge;
use super::store::LocalMesh;

/// How far to collapse.
#[derive(Clone, Copy, Debug)]
pub struct Limit {
    /// Triangles to stop at.
    pub target: usize,
    /// The cost to stop at, see [`Collapsed::cost`].
    pub cost: f64,
    /// The largest distance of a new point to the planes around its edge, and to those that stand on borders and
    /// creases there, in the unit of the positions. Where this is finite, attributes deviate by rounding alone.
    /// Goes with policies that do not cut.
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
    /// The largest root mean square distance of a new point to the planes of the faces it replaced, or of a removed
    /// component to the rest, in the unit of the positions: an estimate, not a bound.
    pub error: f32,
    /// The same without removed components.
    pub moved: f32,
    /// The largest cost of a collapse: an area times a squared distance, times the root of the root of such a distance
    /// where [`Policy::even`] is set, in the unit of the positions. Costs of different meshes compare.
    pub cost: f64,
    /// For each collapse the largest cost so far, and the triangles that were left.
    pub trace: Vec<(f64, u32)>,
    /// Whether the limit of the cost ended it.
    pub stopped: bool,
}

/// Collapses edges until a limit is reached or no edge may collapse.
///
/// Points (distinct positions) of `mesh` with `locked` set on a vertex stay, as do the attributes of their vertices.
/// `rows` holds the attributes of each vertex, `weights` one weight for each float of a row: a unit of it as a part of
/// the mesh's extent (the longest side of its box).
///
/// Sheets that touch are separated, so that vertices may be added at the end, see [`LocalMesh::copies`]. Edges
/// never get more faces than they have. Triangles with two corners at one position are dropped.
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

/// Collapses that can be resumed: see [`collapse`].
pub struct Collapses {
    collapser: Collapser,
    /// The unit of costs inside.
    unit: f64,
}

impl Collapses {
    /// Evaluates all edges of a mesh.
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

    /// The cost of the next step as far as it is known; none where nothing may collapse.
    pub fn next_cost(&self) -> Option<f64> {
        let edge = self.collapser.queue.peek().map(|(_, cost)| cost);
        let component = self.collapser.component_queue.peek().map(|(_, cost)| cost);
        let least = edge.into_iter().chain(component).min_by(f32::total_cmp)?;
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

/// The largest values of the steps so far.
#[derive(Clone, Copy, Debug, Default)]
struct Worst {
    /// Squared distances of collapses, and those of removed components and closed openings.
    moved: f64,
    gone: f64,
    cost: f32,
}

/// What is known of an edge in the queue.
#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    /// Number of collapses when it was evaluated.
    seen: u32,
    /// Its best place folds the surface; its cost is that of the next best.
    second: bool,
    /// Its cost includes that of a thin face.
    thin: bool,
    /// Its cost includes that of the ring or opening in its way.
    ring: bool,
    /// Its cost includes the distances around the fold that it lies on. They take long, so they are found when it
    /// comes to the front.
    priced: bool,
    /// Its best place, whether it folds the surface or not.
    place: DVec3,
}

/// A position as a key: both zeros are one.
fn bits(position: [f32; 3]) -> [u32; 3] {
    position.map(|x| (x + 0.0).to_bits())
}

struct Collapser {
    policy: Policy,
    worst: Worst,
    /// The connected components, and the order in which they may be removed.
    components: Components,
    component_queue: Queue,
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
    /// The same as [`bits`]: a point that moved onto another one would be joined to it.
    taken: FxHashSet<[u32; 3]>,
    rows: Vec<f32>,
    stride: usize,
    merge: Merge,
    /// Number of materials that meet at each point, less one, and at most two: inside one material, on a line
    /// between two, where lines meet. Empty when there are no materials.
    rank: Vec<u8>,
    /// Sum of the squared distances of the collapses behind each point.
    drift: Vec<f64>,
    /// Sums of the edge evaluated last.
    sums: Sums,
    ring: Vec<u32>,
    pending: Vec<u32>,
}

impl Collapser {
    /// Collapses up to a limit, which is in its own units; returns whether the cost was the limit.
    fn run(&mut self, limit: Limit) -> bool {
        let Limit { target, cost: limit, distance: reach } = limit;
        let mut stopped = false;
        while self.surface.alive > target {
            let component = self.component_queue.peek();
            let next = self.queue.peek();
            if let Some((component, cost)) = component
                && next.is_none_or(|(_, next)| cost <= next)
            {
                let Some(squared) = self.remove_component(component, cost, target, limit, next.is_none())
                else {
                    continue;
                };
                self.worst.gone = self.worst.gone.max(squared);
                self.record(cost);
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
                self.update(edge);
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
            if reach < f64::INFINITY && !self.is_lossless(edge, position, reach) {
                self.block(edge);
                continue;
            }
            if !thin && self.forms.thins(&self.surface, edge, position) {
                self.entries[edge as usize].thin = true;
                self.queue.set(edge, self.thin_cost(edge, f64::from(cost)) as f32);
                continue;
            }
            let squared = self.forms.squared_distance(&self.surface, edge, position);
            let drift = self.drift_of(edge) + squared;
            match self.apply(edge, position) {
                Some(point) => {
                    self.worst.moved = self.worst.moved.max(squared);
                    self.record(cost);
                    self.drift[point as usize] = drift;
                    self.update_around();
                }
                None => self.block(edge),
            }
        }
        stopped
    }

    /// Records a step.
    fn record(&mut self, cost: f32) {
        self.worst.cost = self.worst.cost.max(cost);
        self.trace.push((self.worst.cost.into(), self.surface.alive as u32));
    }

    /// Queues a component that may be removed, at no cost: the cost is found when it comes to the front.
    fn queue_component(&mut self, component: u32) {
        if self.components.is_removable(component) && self.components.several() {
            self.component_queue.set(component, 0.0);
        }
    }

    /// Removes a component that came to the front, or queues it at its cost. Returns the mean squared distance of
    /// what was removed.
    fn remove_component(
        &mut self,
        component: u32,
        cost: f32,
        target: usize,
        limit: f64,
        last: bool,
    ) -> Option<f64> {
        let Some(alive) =
            self.components.is_removable(component).then(|| self.components.all[component as usize].alive)
        else {
            self.component_queue.remove(component);
            return None;
        };
        let Some((sum, area)) = self.components.distance(&self.surface, component) else {
            self.component_queue.remove(component);
            return None;
        };
        let squared = if area > 0.0 { sum / area } else { 0.0 };
        // For each pair of triangles what a collapse costs, which removes two.
        let now = self.policy.evened(2.0 * sum / f64::from(alive), squared);
        if now as f32 > cost {
            self.component_queue.set(component, now as f32);
            return None;
        }
        self.component_queue.remove(component);
        let fits = self.surface.alive >= target + alive as usize;
        if f64::from(cost) > limit || !(fits || last) {
            return None;
        }
        let faces = std::mem::take(&mut self.components.all[component as usize].faces);
        for f in faces {
            let face = &self.surface.faces[f as usize];
            if !face.alive() || self.components.at(face.points[0]) != component {
                continue;
            }
            let edges = face.edges;
            edges.into_iter().for_each(|e| self.queue.remove(e));
            self.surface.remove_face(f as usize);
        }
        self.components.remove(&self.surface, component);
        Some(squared)
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
            // The position as it will be stored.
            place = (self.center + position * self.extent).as_vec3().to_array();
            at = (DVec3::from_array(place.map(f64::from)) - self.center) / self.extent;
        }
        // Faces keep facing `up` after rounding too.
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
        self.update_faces(keep);
        if !self.components.all.is_empty() {
            let component = self.components.at(keep);
            let alive = &mut self.components.all[component as usize].alive;
            *alive -= gone;
            if !self.component_queue.holds(component) {
                self.queue_component(component);
            }
        }
        for p in &self.ring {
            self.forms.touch(*p);
        }
        Some(keep)
    }

    /// Updates the faces around a point that changed, and lists their points.
    fn update_faces(&mut self, point: u32) {
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

    /// Evaluates again the edges at the listed points: all of them, or those that were blocked.
    fn update_around(&mut self) {
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
            self.update(self.pending[k]);
        }
    }

    /// The mesh as it is now.
    fn finish(mut self, mesh: &LocalMesh) -> LocalMesh {
        self.rejoin();
        let mut out = LocalMesh { attributes: Vec::new(), ..mesh.with_copies(&self.copies) };
        out.indices = Vec::with_capacity(3 * self.surface.alive);
        // A point may have several copies as wedges: the first of them names the position.
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
                // Where wedges of the source are there too, theirs names it: this one is a copy from there.
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
