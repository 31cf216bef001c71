//! What stands in the way of a collapse: rings, along which the surface is cut, and openings, which are closed.

use super::surface::{Opening, Ring};
use super::{Collapser, Entry};

/// What stands in the way of a collapse.
pub enum Obstacle {
    /// The surface is cut along it, and closed.
    Ring(Ring),
    /// It is closed.
    Opening(Opening),
}

impl Collapser {
    /// What stands in the way of an edge, if it can be removed.
    pub(super) fn obstacle(&mut self, edge: u32) -> Option<Obstacle> {
        if !self.policy.cuts {
            return None;
        }
        if let Some(ring) = self.surface.ring(edge) {
            return Some(Obstacle::Ring(ring));
        }
        let fits = |found: &Opening| {
            // Lines between materials stay, and the new face faces where its neighbours do.
            found.points.iter().all(|p| self.rank.get(*p as usize).is_none_or(|rank| *rank == 0))
                && self.forms.faces_along(&self.surface, &self.rows, found)
        };
        self.surface.opening(edge).filter(fits).map(Obstacle::Opening)
    }

    /// The area of a face between points, and the square of a third of its height, which counts as its distance.
    pub(super) fn closing(&self, points: [u32; 3]) -> (f64, f64) {
        let [a, b, c] = points.map(|p| self.surface.positions[p as usize]);
        let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
        let area = 0.5 * (b - a).cross(c - a).length();
        (area, if longest > 0.0 { 4.0 * area * area / longest / 9.0 } else { 0.0 })
    }

    /// Closes an opening.
    pub(super) fn close(&mut self, opening: &Opening) {
        self.count += 1;
        self.ring.clear();
        self.surface.close(opening);
        self.forms.add_faces(self.surface.faces.len());
        for p in opening.points {
            self.update_faces(p);
            self.waiting[p as usize] = true;
        }
        self.ring.iter().for_each(|p| self.forms.touch(*p));
        self.update_around();
        let component = self.components.close_opening(&self.surface, opening.points[0]);
        self.queue_component(component);
    }

    /// Cuts the surface along a ring and closes both sides.
    pub(super) fn cut(&mut self, ring: &Ring) {
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
            self.update_faces(p);
            self.waiting[p as usize] = true;
        }
        self.ring.iter().for_each(|p| self.forms.touch(*p));
        for edge in edges - 3..edges {
            self.update(edge as u32);
        }
        self.update_around();
        let known = self.components.all.len();
        self.components.cut_ring(&self.surface, [ring.points[0], new[0]]);
        if self.components.all.len() > known {
            self.component_queue.extend(self.components.all.len());
            self.queue_component(known as u32);
        }
        let component = self.components.at(ring.points[0]);
        self.queue_component(component);
    }

    /// The vertex that a wedge is, or is a copy of.
    pub(super) fn origin(&self, wedge: u32) -> u32 {
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
        self.components.copy_point(old);
        self.surface.copy_point(old)
    }

    /// Joins cuts along a ring whose points have not moved since. The faces that close the two sides would lie in
    /// one place, and edges there would have four faces.
    pub(super) fn rejoin(&mut self) {
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
}
