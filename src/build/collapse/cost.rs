//! What the collapse of an edge costs, and where its point goes.

use glam::DVec3;

use super::forms::{MOST_FOLDED, Sums};
use super::quadric::Quadric;
use super::surface::Edge;
use super::{Collapser, Entry};

/// A collapse that makes a thin face costs as much more as a distance of this part of the edge's length.
const THIN_COST: f64 = 0.003;

/// Deviations of attributes up to this part of their limit are rounding.
const ALIKE: f64 = 1.0e-3;

/// Farthest that a point is placed from the middle of its edge, in lengths of the edge.
const REACH: f64 = 2.0;

impl Collapser {
    /// Whether collapsing an edge to a place changes the shape by at most `reach`, and attributes by rounding
    /// alone.
    pub(super) fn is_lossless(&mut self, edge: u32, place: DVec3, reach: f64) -> bool {
        if self.forms.farthest(&self.surface, edge, place) > reach
            || !self.forms.edge(&self.surface, edge, &mut self.sums)
        {
            return false;
        }
        self.sums.attribute.at(place) <= ALIKE * ALIKE * self.attribute_limit * self.sums.area
    }

    /// The cost of an edge whose collapse makes a thin face.
    pub(super) fn thin_cost(&self, edge: u32, cost: f64) -> f64 {
        let ends = self.surface.edges[edge as usize].ends.map(|p| self.surface.positions[p as usize]);
        let squared = THIN_COST * THIN_COST * ends[0].distance_squared(ends[1]);
        cost + self.policy.evened(self.area_around(edge) * squared, squared)
    }

    /// The area of the faces around an edge.
    fn area_around(&self, edge: u32) -> f64 {
        let ends = self.surface.edges[edge as usize].ends;
        let faces = ends.into_iter().flat_map(|p| self.surface.around(p));
        faces.map(|(f, _)| self.forms.plane(f).1).sum()
    }

    pub(super) fn block(&mut self, edge: u32) {
        self.queue.remove(edge);
        self.blocked[edge as usize] = true;
        self.surface.edges[edge as usize].ends.iter().for_each(|p| self.waiting[*p as usize] = true);
    }

    /// Evaluates an edge and queues it at its cost.
    pub(super) fn update(&mut self, edge: u32) {
        self.entries[edge as usize] = Entry { seen: self.count, ..Entry::default() };
        self.blocked[edge as usize] = false;
        if self.surface.edges[edge as usize].ends.iter().all(|p| self.surface.locked[*p as usize]) {
            // Locked points never change: it needs no second look.
            self.queue.remove(edge);
            return;
        }
        if self.fixed(edge) == [true; 2] || !self.forms.edge(&self.surface, edge, &mut self.sums) {
            self.block(edge);
            return;
        }
        let folded = self.is_folded(edge, &self.sums);
        self.entries[edge as usize].priced = !folded;
        self.enqueue(edge, false);
    }

    /// Adds the distances around the fold that an edge lies on to its cost, and queues it again.
    pub(super) fn price_fold(&mut self, edge: u32) {
        self.entries[edge as usize].priced = true;
        if self.forms.edge(&self.surface, edge, &mut self.sums) {
            self.enqueue(edge, true);
        } else {
            self.block(edge);
        }
    }

    /// Queues an edge whose sums were just found.
    fn enqueue(&mut self, edge: u32, folded: bool) {
        let (place, cost) = self.best_place(edge, &self.sums, folded);
        self.entries[edge as usize].place = place;
        self.queue.set(edge, self.total(edge, &self.sums, cost) as f32);
    }

    /// Which ends of an edge stay where they are: locked ones, and those on a line between materials unless the
    /// edge is part of that line. So such lines only collapse along themselves.
    #[inline]
    pub(super) fn fixed(&self, edge: u32) -> [bool; 2] {
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

    /// The larger drift of the ends of an edge.
    pub(super) fn drift_of(&self, edge: u32) -> f64 {
        let [a, b] = self.surface.edges[edge as usize].ends.map(|p| self.drift[p as usize]);
        a.max(b)
    }

    /// The cost of collapsing an edge to `p`, without what [`Self::total`] adds.
    #[inline(always)]
    fn cost(&self, sums: &Sums, ends: [DVec3; 2], p: DVec3) -> f64 {
        let moved = 0.5 * (p.distance_squared(ends[0]) + p.distance_squared(ends[1]));
        let geometry = sums.geometry.at(p).max(0.0);
        let limit = self.attribute_limit * sums.area;
        let deviation = self.policy.attribute_weight * sums.attribute.at(p).max(0.0);
        // Approaches the limit without reaching it: a larger deviation always costs more.
        let attribute = if limit > 0.0 { deviation * (limit / (deviation + limit)) } else { 0.0 };
        geometry + attribute + self.policy.shape_weight * sums.area * moved
    }

    /// The cost that decides which edge comes first.
    #[inline]
    fn total(&self, edge: u32, sums: &Sums, cost: f64) -> f64 {
        let total = cost + self.policy.drift_weight * self.drift_of(edge) * sums.area;
        if sums.area > 0.0 { self.policy.evened(total, total / sums.area) } else { total }
    }

    /// The best place for the collapse of an edge, and its cost. The place may fold the surface over. `folded`: the
    /// cost includes distances.
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

    /// The quadric that a placed point minimizes, without volume and shape.
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

    /// Whether the cost of an edge includes distances around a fold.
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
    pub(super) fn other_place(&mut self, edge: u32) -> Option<(DVec3, f64)> {
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
}
