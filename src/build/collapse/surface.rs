//! The mesh while edges collapse: faces by *point* (distinct position) and by *wedge* (attribute vertex at a
//! point), the faces around each point as linked corners, and when a collapse keeps the topology.
//!
//! The condition is the link condition of Dey, Edelsbrunner, Guha and Nekhayev, "Topology Preserving Edge
//! Contraction" (1999): edges without exactly two faces are coned with a point of their own, so that borders and
//! lines where several sheets meet survive as well. Every collapse that passes keeps the Euler characteristic and
//! gives no edge more faces than one of the edges it came from.

use glam::DVec3;

/// No corner, point, wedge or edge.
pub const NONE: u32 = u32::MAX;

/// A triangle; edge `k` runs from corner `k` to the next one.
#[derive(Clone, Copy, Debug)]
pub struct Face {
    /// Points of the corners; [`NONE`] once the face is gone.
    pub points: [u32; 3],
    /// Wedges of the corners.
    pub wedges: [u32; 3],
    /// Edges.
    pub edges: [u32; 3],
    /// Bit k: edge k is a rim or a crease.
    lines: u32,
}

impl Face {
    /// Whether an edge, by its number in the face, is a rim or a crease.
    #[inline]
    pub fn has_line(&self, side: usize) -> bool {
        self.lines >> side & 1 != 0
    }

    /// Whether any edge is a rim or a crease.
    #[inline]
    pub fn has_lines(&self) -> bool {
        self.lines != 0
    }

    /// Whether the face is still there.
    pub fn alive(&self) -> bool {
        self.points[0] != NONE
    }

    /// Whether an edge is one of the face's.
    #[inline]
    pub fn has_edge(&self, edge: u32) -> bool {
        self.edges.contains(&edge)
    }
}

/// Two points that share faces.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    /// The two points; [`NONE`] once the edge is gone.
    pub ends: [u32; 2],
    /// Number of faces.
    pub faces: u32,
    /// The faces where they are two at most; the rest [`NONE`].
    sides: [u32; 2],
    /// Whether attributes change across: two faces with different wedges at one end.
    pub crease: bool,
}

impl Edge {
    /// Border, or a line where more than two sheets meet.
    #[inline]
    pub fn rim(&self) -> bool {
        self.faces != 2
    }
}

/// Three edges in a ring without a face.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ring {
    /// Its points.
    pub points: [u32; 3],
    /// The edges from each point to the next.
    pub edges: [u32; 3],
    /// The corners at each point on one side of the ring.
    pub fans: [Vec<u32>; 3],
    /// The face at each edge on that side.
    pub sides: [u32; 3],
}

/// Three rims in a ring around nothing, as the face that closes it runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Opening {
    /// Its points.
    pub points: [u32; 3],
    /// A wedge at each.
    pub wedges: [u32; 3],
    /// The edges from each point to the next.
    pub edges: [u32; 3],
}

/// The mesh.
#[derive(Debug, Default)]
pub struct Surface {
    /// Where the points are.
    pub positions: Vec<DVec3>,
    /// Points that stay.
    pub locked: Vec<bool>,
    /// Triangles, also those that are gone.
    pub faces: Vec<Face>,
    /// Number of triangles left.
    pub alive: usize,
    /// Edges, also those that are gone.
    pub edges: Vec<Edge>,
    /// Points around which the surface is not one disc or half disc.
    singular: Vec<bool>,
    /// Whether any point has several wedges.
    seams: bool,
    /// First corner (3 · face + corner) at each point, and the next one after each corner.
    first: Vec<u32>,
    next: Vec<u32>,
    /// Stamps of points for the link condition.
    marks: Vec<u32>,
    stamp: u32,
    /// Edges that a collapse joins: the one that goes, the one that stays.
    joined: Vec<(u32, u32)>,
}

impl Surface {
    /// Takes in a mesh: `corners` holds the wedges of each triangle, `point_of` the point of each wedge. Triangles
    /// with two corners at one point are left out.
    pub fn new(positions: Vec<DVec3>, locked: Vec<bool>, point_of: &[u32], corners: &[u32]) -> Self {
        let count = positions.len();
        let mut new =
            Self { positions, locked, first: vec![NONE; count], marks: vec![0; count], ..Self::default() };
        for t in corners.chunks_exact(3) {
            let wedges = [t[0], t[1], t[2]];
            let points = wedges.map(|w| point_of[w as usize]);
            if points[0] != points[1] && points[1] != points[2] && points[2] != points[0] {
                new.faces.push(Face { points, wedges, edges: [NONE; 3], lines: 0 });
            }
        }
        new.alive = new.faces.len();
        new.next = vec![NONE; 3 * new.faces.len()];
        // Backwards, so that the faces of a point come in their own order.
        for corner in (0..3 * new.faces.len()).rev() {
            let point = new.faces[corner / 3].points[corner % 3] as usize;
            new.next[corner] = std::mem::replace(&mut new.first[point], corner as u32);
        }
        new.number_edges();
        let mut wedge_at = vec![NONE; count];
        for (p, w) in new.faces.iter().flat_map(|f| f.points.into_iter().zip(f.wedges)) {
            let known = &mut wedge_at[p as usize];
            new.seams |= *known != NONE && *known != w;
            *known = w;
        }
        if new.seams {
            (0..new.edges.len() as u32).for_each(|e| new.find_crease(e));
        }
        (0..new.faces.len()).for_each(|f| new.find_lines(f));
        let mut fan = Vec::new();
        new.singular = (0..count as u32).map(|p| new.is_singular(p, &mut fan)).collect();
        new
    }

    fn number_edges(&mut self) {
        // For each point the last one that asked, and the edge to it.
        let mut edge_to = vec![(NONE, NONE); self.positions.len()];
        for p in 0..self.positions.len() as u32 {
            let mut corner = self.first[p as usize];
            while corner != NONE {
                let (f, k) = (corner as usize / 3, corner as usize % 3);
                for (side, other) in [(k, (k + 1) % 3), ((k + 2) % 3, (k + 2) % 3)] {
                    let q = self.faces[f].points[other];
                    if q < p {
                        continue;
                    }
                    let known = &mut edge_to[q as usize];
                    if known.0 != p {
                        *known = (p, self.edges.len() as u32);
                        self.edges.push(Edge { ends: [p, q], faces: 0, sides: [NONE; 2], crease: false });
                    }
                    self.faces[f].edges[side] = known.1;
                    let edge = &mut self.edges[known.1 as usize];
                    if let Some(free) = edge.sides.get_mut(edge.faces as usize) {
                        *free = f as u32;
                    }
                    edge.faces += 1;
                }
                corner = self.next[corner as usize];
            }
        }
    }

    /// Faces at a point, each with the corner that lies there.
    #[inline]
    pub fn around(&self, point: u32) -> Around<'_> {
        self.around_from(self.first[point as usize])
    }

    /// The same from a corner on.
    #[inline]
    fn around_from(&self, corner: u32) -> Around<'_> {
        Around { next: &self.next, corner }
    }

    /// Faces at an edge.
    #[inline]
    pub fn beside(&self, edge: u32) -> impl Iterator<Item = usize> {
        let Edge { ends, faces, sides, .. } = self.edges[edge as usize];
        let (few, from) = if faces <= 2 { (sides, NONE) } else { ([NONE; 2], self.first[ends[0] as usize]) };
        let few = few.into_iter().filter(|f| *f != NONE).map(|f| f as usize);
        few.chain(self.around_from(from).filter(move |(f, _)| self.faces[*f].has_edge(edge)).map(|(f, _)| f))
    }

    /// Updates whether an edge is an attribute seam.
    fn find_crease(&mut self, edge: u32) {
        let [a, b] = self.edges[edge as usize].ends;
        let mut first = None;
        let mut crease = false;
        for f in self.beside(edge) {
            let face = &self.faces[f];
            let wedge = |p| face.points.iter().position(|q| *q == p).map(|k| face.wedges[k]);
            let pair = (wedge(a), wedge(b));
            crease |= *first.get_or_insert(pair) != pair;
        }
        self.edges[edge as usize].crease = crease;
    }

    /// Updates which edges of a face are rims or creases.
    fn find_lines(&mut self, face: usize) {
        let edges = self.faces[face].edges.map(|e| self.edges[e as usize]);
        self.faces[face].lines = (0..3).map(|k| u32::from(edges[k].rim() || edges[k].crease) << k).sum();
    }

    /// Updates which edges around a point are rims or creases.
    fn find_lines_around(&mut self, point: u32) {
        if self.seams {
            let mut corner = self.first[point as usize];
            while corner != NONE {
                let (f, k) = (corner as usize / 3, corner as usize % 3);
                self.find_crease(self.faces[f].edges[k]);
                self.find_crease(self.faces[f].edges[(k + 2) % 3]);
                corner = self.next[corner as usize];
            }
        }
        let mut corner = self.first[point as usize];
        while corner != NONE {
            self.find_lines(corner as usize / 3);
            corner = self.next[corner as usize];
        }
    }

    /// Whether the faces around a point form anything but one cycle, one path, or pages between two spines.
    fn is_singular(&self, point: u32, fan: &mut Vec<[u32; 2]>) -> bool {
        fan.clear();
        fan.extend(self.around(point).map(|(f, k)| {
            let edges = &self.faces[f].edges;
            [edges[k], edges[(k + 2) % 3]]
        }));
        // A rim edge comes once per face of it.
        let mut rims: [Option<u32>; 2] = [None; 2];
        for e in fan.iter().flatten().filter(|e| self.edges[**e as usize].rim()) {
            if rims.contains(&Some(*e)) {
                continue;
            }
            match rims.iter_mut().find(|r| r.is_none()) {
                Some(free) => *free = Some(*e),
                None => return true,
            }
        }
        let [a, b] = rims.map(|r| r.map(|e| self.edges[e as usize].faces));
        if a != b {
            return true;
        }
        // Grow from the first face across shared edges; what is left is another fan.
        let mut done = fan.len().min(1);
        let mut at = 0;
        while at < done {
            let [a, b] = fan[at];
            let mut other = done;
            while other < fan.len() {
                if fan[other].contains(&a) || fan[other].contains(&b) {
                    fan.swap(done, other);
                    done += 1;
                }
                other += 1;
            }
            at += 1;
        }
        done < fan.len()
    }

    /// Whether sheets may touch at a point: it is singular, or more than two faces meet at an edge of it.
    pub fn is_pinched(&self, point: u32) -> bool {
        let crowded = |(f, k): (usize, usize)| {
            let edges = &self.faces[f].edges;
            [edges[k], edges[(k + 2) % 3]].iter().any(|e| self.edges[*e as usize].faces > 2)
        };
        self.singular[point as usize] || self.around(point).any(crowded)
    }

    /// Whether collapsing an edge onto its locked end would join that end to another locked point by a chord. The
    /// group on the other side may make the same chord.
    pub fn makes_chord(&mut self, edge: u32) -> bool {
        let ends = self.edges[edge as usize].ends;
        let [a, b] = ends.map(|p| self.locked[p as usize]);
        if a == b {
            return false;
        }
        let (stays, goes) = if a { (ends[0], ends[1]) } else { (ends[1], ends[0]) };
        self.next_stamp();
        let mut marks = std::mem::take(&mut self.marks);
        marks[stays as usize] = self.stamp;
        for (f, _) in self.around(stays) {
            self.faces[f].points.iter().for_each(|p| marks[*p as usize] = self.stamp);
        }
        let new = |p: &u32| *p != goes && self.locked[*p as usize] && marks[*p as usize] != self.stamp;
        let chord = self.around(goes).any(|(f, _)| self.faces[f].points.iter().any(new));
        self.marks = marks;
        chord
    }

    /// New stamps that no mark has.
    fn next_stamp(&mut self) {
        if self.stamp >= u32::MAX - 3 {
            self.marks.fill(0);
            self.stamp = 0;
        }
        self.stamp += 3;
    }

    /// Whether collapsing an edge keeps the topology.
    pub fn can_collapse(&mut self, edge: u32) -> bool {
        let Edge { ends: [a, b], faces, .. } = self.edges[edge as usize];
        let mut rim = [a, b].map(|p| self.singular[p as usize]);
        if rim == [true; 2] {
            return false;
        }
        self.next_stamp();
        let [near, opposite, common] = [0, 1, 2].map(|k| self.stamp + k);
        let mut marks = std::mem::take(&mut self.marks);
        let mut fits = true;
        for (f, k) in self.around(a) {
            let face = &self.faces[f];
            let (out, back) = (face.edges[k], face.edges[(k + 2) % 3]);
            rim[0] |= self.edges[out as usize].rim() || self.edges[back as usize].rim();
            let ends = [face.points[(k + 1) % 3], face.points[(k + 2) % 3]];
            let at_edge = out == edge || back == edge;
            for p in ends {
                let mark = &mut marks[p as usize];
                if at_edge && p != b {
                    // Two faces over the same point would leave an edge to it without any.
                    fits &= *mark != opposite;
                    *mark = opposite;
                } else if *mark != opposite {
                    *mark = near;
                }
            }
            if at_edge {
                // The two other edges become one; were both rims, it would be left without faces or gain some.
                let others = face.edges.iter().filter(|e| **e != edge);
                fits &= others.filter(|e| self.edges[**e as usize].rim()).count() < 2;
            }
        }
        for (f, k) in self.around(b) {
            let face = &self.faces[f];
            let (out, back) = (face.edges[k], face.edges[(k + 2) % 3]);
            rim[1] |= self.edges[out as usize].rim() || self.edges[back as usize].rim();
            let ends = [face.points[(k + 1) % 3], face.points[(k + 2) % 3]];
            for p in ends.into_iter().filter(|p| *p != a) {
                let mark = &mut marks[p as usize];
                // Near both ends without a face between.
                fits &= *mark != near;
                if *mark == opposite {
                    *mark = common;
                }
            }
            // Faces a c d and b c d would become duplicates.
            if out != edge && back != edge && ends.iter().all(|p| marks[*p as usize] == common) {
                let across = face.edges[(k + 1) % 3];
                fits &= !self.around(a).any(|(g, j)| self.faces[g].edges[(j + 1) % 3] == across);
            }
        }
        self.marks = marks;
        fits && (faces != 2 || rim != [true; 2])
    }

    /// Collapses an edge that passed [`Self::can_collapse`] onto its end `keep`, which moves to `position`. Wedges
    /// are left as they are. `gone` is called with every removed edge.
    pub fn collapse(&mut self, edge: u32, keep: u32, position: DVec3, mut gone: impl FnMut(u32)) {
        let ends = self.edges[edge as usize].ends;
        let other = if ends[0] == keep { ends[1] } else { ends[0] };
        let mut joined = std::mem::take(&mut self.joined);
        joined.clear();
        let mut rest = NONE;
        let mut last = NONE;
        let mut corner = self.first[other as usize];
        while corner != NONE {
            let (f, k) = (corner as usize / 3, corner as usize % 3);
            let next = self.next[corner as usize];
            let face = self.faces[f];
            if let Some(side) = face.edges.iter().position(|e| *e == edge) {
                let (ahead, behind) = (face.edges[(side + 1) % 3], face.edges[(side + 2) % 3]);
                let (stays, goes) = if face.points[side] == keep { (behind, ahead) } else { (ahead, behind) };
                self.join(stays, goes, f as u32);
                joined.push((goes, stays));
                self.unlink(face.points[(side + 2) % 3], f);
                self.unlink(keep, f);
                self.faces[f].points = [NONE; 3];
                self.alive -= 1;
            } else {
                if last == NONE {
                    last = corner;
                }
                self.next[corner as usize] = rest;
                rest = corner;
                self.faces[f].points[k] = keep;
            }
            corner = next;
        }
        for e in joined.iter().map(|(goes, _)| *goes).chain([edge]) {
            self.edges[e as usize].ends = [NONE; 2];
            gone(e);
        }
        let mut corner = rest;
        while corner != NONE {
            let (f, k) = (corner as usize / 3, corner as usize % 3);
            for side in [k, (k + 2) % 3] {
                let e = self.faces[f].edges[side];
                match joined.iter().find(|(goes, _)| *goes == e) {
                    Some((_, stays)) => self.faces[f].edges[side] = *stays,
                    None => {
                        let ends = &mut self.edges[e as usize].ends;
                        ends.iter_mut().filter(|p| **p == other).for_each(|p| *p = keep);
                    }
                }
            }
            corner = self.next[corner as usize];
        }
        if last != NONE {
            self.next[last as usize] = self.first[keep as usize];
            self.first[keep as usize] = rest;
        }
        for (_, stays) in &joined {
            self.find_sides(*stays, keep);
        }
        self.first[other as usize] = NONE;
        self.positions[keep as usize] = position;
        self.singular[keep as usize] |= self.singular[other as usize];
        self.joined = joined;
    }

    /// Gives the faces of the edge `goes` to `stays`, but for the face between them.
    fn join(&mut self, stays: u32, goes: u32, between: u32) {
        let Edge { faces, sides, .. } = self.edges[goes as usize];
        let edge = &mut self.edges[stays as usize];
        let other = |sides: [u32; 2]| if sides[0] == between { sides[1] } else { sides[0] };
        // Of more than two nobody knows which are left.
        let known = edge.faces <= 2 && faces <= 2;
        edge.sides = if known { [other(edge.sides), other(sides)] } else { [NONE; 2] };
        edge.faces = edge.faces + faces - 2;
    }

    /// Finds the faces of an edge at a point, where they are two at most and not known.
    fn find_sides(&mut self, edge: u32, point: u32) {
        let Edge { faces, sides, .. } = self.edges[edge as usize];
        if faces > 2 || sides.iter().filter(|f| **f != NONE).count() == faces as usize {
            return;
        }
        let mut found = [NONE; 2];
        let at_edge = self.around(point).filter(|(f, _)| self.faces[*f].has_edge(edge));
        found.iter_mut().zip(at_edge).for_each(|(found, (f, _))| *found = f as u32);
        self.edges[edge as usize].sides = found;
    }

    /// Gives the corners at a point the second of each pair of wedges for the first: the last step of a collapse.
    pub fn rename_wedges(&mut self, point: u32, renamed: &[(u32, u32)]) {
        let mut corner = self.first[point as usize];
        while corner != NONE {
            let wedge = &mut self.faces[corner as usize / 3].wedges[corner as usize % 3];
            if let Some((_, name)) = renamed.iter().find(|(w, _)| w == wedge) {
                *wedge = *name;
            }
            corner = self.next[corner as usize];
        }
        self.find_lines_around(point);
    }

    /// The smallest ring of three edges without a face that stands in the way of collapsing an edge: through it and a
    /// point near both of its ends. None where anything but such rings does, or where they are not free.
    pub fn ring(&mut self, edge: u32) -> Option<Ring> {
        let Edge { ends: [a, b], faces, .. } = self.edges[edge as usize];
        if faces != 2 || ![a, b].into_iter().all(|p| self.is_plain(p)) {
            return None;
        }
        self.next_stamp();
        let near = self.stamp;
        for corner in self.corners_at(a) {
            self.faces[corner / 3].points.into_iter().for_each(|p| self.marks[p as usize] = near);
        }
        for f in self.beside(edge).collect::<Vec<_>>() {
            self.faces[f].points.into_iter().for_each(|p| self.marks[p as usize] = 0);
        }
        let near_both = |p: &u32| self.marks[*p as usize] == near;
        let points = self.around(b).flat_map(|(f, _)| self.faces[f].points).filter(near_both);
        let corners = |p: u32| [a, b, p].map(|p| self.positions[p as usize]);
        let area = |p: u32| {
            let [a, b, c] = corners(p);
            (b - a).cross(c - a).length_squared()
        };
        let apart =
            |p: &u32| [a, b].iter().all(|q| self.positions[*p as usize] != self.positions[*q as usize]);
        let at =
            points.filter(|p| apart(p) && self.is_plain(*p)).min_by(|p, q| area(*p).total_cmp(&area(*q)))?;
        let to = |p: u32, q: u32| {
            let edges = self.around(p).flat_map(|(f, k)| {
                let edges = self.faces[f].edges;
                [edges[k], edges[(k + 2) % 3]]
            });
            edges.into_iter().find(|e| self.edges[*e as usize].ends.contains(&q))
        };
        let (points, edges) = ([a, b, at], [edge, to(b, at)?, to(at, a)?]);
        // One side of it, from the first edge on.
        let start = self.edges[edge as usize].sides[0] as usize;
        let of_b = self.fan_between(b, start, edges[0], edges[1])?;
        let next = *of_b.last()? as usize / 3;
        let of_c = self.fan_between(at, next, edges[1], edges[2])?;
        let last = *of_c.last()? as usize / 3;
        let of_a = self.fan_between(a, start, edges[0], edges[2])?;
        if *of_a.last()? as usize / 3 != last {
            return None;
        }
        Some(Ring {
            points,
            edges,
            fans: [of_a, of_b, of_c],
            sides: [start as u32, next as u32, last as u32],
        })
    }

    /// The smallest opening of three edges of which one is the border: such a border has no edge that could collapse.
    /// None where two of its points are locked: others may have faces there.
    pub fn opening(&self, edge: u32) -> Option<Opening> {
        let Edge { faces: 1, sides, .. } = self.edges[edge as usize] else { return None };
        let face = &self.faces[sides.into_iter().find(|f| *f != NONE)? as usize];
        let k = face.edges.iter().position(|e| *e == edge)?;
        let [a, b] = [k, (k + 1) % 3].map(|k| (face.points[k], face.wedges[k]));
        // Rims that run to a point, with where they come from.
        let rims_to = |point: u32| {
            self.around(point).filter_map(|(f, k)| {
                let from = (k + 2) % 3;
                let Face { points, wedges, edges, .. } = &self.faces[f];
                let is_rim = self.edges[edges[from] as usize].faces == 1 && edges[from] != edge;
                is_rim.then_some(((points[from], wedges[from]), edges[from]))
            })
        };
        // A face by itself is no opening.
        let closed = rims_to(a.0).filter(|(c, _)| !face.points.contains(&c.0)).filter_map(|(c, to_a)| {
            let (_, to_c) = rims_to(c.0).find(|(from, _)| from.0 == b.0)?;
            let all = [b, a, c];
            Some(Opening { points: all.map(|p| p.0), wedges: all.map(|p| p.1), edges: [edge, to_a, to_c] })
        });
        let free =
            |opening: &Opening| opening.points.iter().filter(|p| self.locked[**p as usize]).count() < 2;
        let size = |opening: &Opening| {
            let [a, b, c] = opening.points.map(|p| self.positions[p as usize]);
            (b - a).cross(c - a).length_squared()
        };
        closed.filter(free).min_by(|p, q| size(p).total_cmp(&size(q)))
    }

    /// Closes an opening with a face.
    pub fn close(&mut self, opening: &Opening) {
        let new = self.faces.len() as u32;
        for edge in opening.edges.map(|e| e as usize) {
            let edge = &mut self.edges[edge];
            edge.sides.iter_mut().filter(|f| **f == NONE).for_each(|f| *f = new);
            edge.faces = 2;
        }
        self.push_face(opening.points, opening.wedges, opening.edges, false);
        opening.points.into_iter().for_each(|p| self.find_lines_around(p));
    }

    /// Whether a point is free, and all around it is one sheet without seams.
    pub fn is_plain(&self, point: u32) -> bool {
        let plain = |(f, k): (usize, usize)| {
            let edges = &self.faces[f].edges;
            [edges[k], edges[(k + 2) % 3]].iter().all(|e| {
                let edge = &self.edges[*e as usize];
                edge.faces == 2 && !edge.crease
            })
        };
        let p = point as usize;
        !self.locked[p] && !self.singular[p] && self.around(point).all(plain)
    }

    /// Corners at a point.
    fn corners_at(&self, point: u32) -> Vec<usize> {
        self.around(point).map(|(f, k)| 3 * f + k).collect()
    }

    /// The corners at a point from a face at one edge on, until the face at another edge.
    fn fan_between(&self, point: u32, start: usize, from: u32, to: u32) -> Option<Vec<u32>> {
        let mut corners = Vec::new();
        let (mut face, mut across) = (start, from);
        loop {
            let k = self.faces[face].points.iter().position(|p| *p == point)?;
            corners.push((3 * face + k) as u32);
            let edges = &self.faces[face].edges;
            let [out, back] = [edges[k], edges[(k + 2) % 3]];
            let next = if out == across { back } else { out };
            if next == to {
                return Some(corners);
            }
            let sides = self.edges[next as usize].sides;
            let other = if sides[0] as usize == face { sides[1] } else { sides[0] };
            if next == from || other == NONE {
                return None;
            }
            (face, across) = (other as usize, next);
        }
    }

    /// Cuts the surface along a ring and closes both sides with a face: the corners of its fans move to points of their
    /// own, `new`, which have no faces yet, with the wedges `named`. Three edges and two faces are added.
    pub fn cut_ring(&mut self, ring: &Ring, new: [u32; 3], named: [u32; 3]) {
        let old_wedges: [u32; 3] = std::array::from_fn(|i| {
            let corner = ring.fans[i][0] as usize;
            self.faces[corner / 3].wedges[corner % 3]
        });
        let first_edge = self.edges.len() as u32;
        let new_edges = [0, 1, 2].map(|i| first_edge + i);
        for i in 0..3 {
            for corner in &ring.fans[i] {
                let (f, k) = (*corner as usize / 3, *corner as usize % 3);
                self.unlink(ring.points[i], f);
                self.faces[f].points[k] = new[i];
                self.faces[f].wedges[k] = named[i];
                self.next[*corner as usize] = std::mem::replace(&mut self.first[new[i] as usize], *corner);
                for side in [k, (k + 2) % 3] {
                    let e = self.faces[f].edges[side];
                    if !ring.edges.contains(&e) {
                        let ends = &mut self.edges[e as usize].ends;
                        ends.iter_mut().filter(|p| **p == ring.points[i]).for_each(|p| *p = new[i]);
                    }
                }
            }
        }
        let closing = [self.faces.len() as u32, self.faces.len() as u32 + 1];
        let start = &self.faces[ring.sides[0] as usize];
        let forward = (0..3).any(|k| start.points[k] == new[0] && start.points[(k + 1) % 3] == new[1]);
        for i in 0..3 {
            let (edge, side) = (ring.edges[i], ring.sides[i]);
            self.edges.push(Edge {
                ends: [new[i], new[(i + 1) % 3]],
                faces: 2,
                sides: [side, closing[1]],
                crease: false,
            });
            self.edges[edge as usize].sides.iter_mut().filter(|f| **f == side).for_each(|f| *f = closing[0]);
            self.faces[side as usize]
                .edges
                .iter_mut()
                .filter(|e| **e == edge)
                .for_each(|e| *e = new_edges[i]);
        }
        // The face that closes a side runs against what is there.
        self.push_face(ring.points, old_wedges, ring.edges, !forward);
        self.push_face(new, named, new_edges, forward);
    }

    /// Adds a face, with its edges from each corner to the next; turned over if asked for.
    fn push_face(&mut self, points: [u32; 3], wedges: [u32; 3], edges: [u32; 3], turned: bool) {
        let order = |x: [u32; 3]| if turned { [x[0], x[2], x[1]] } else { x };
        let edges = if turned { [edges[2], edges[1], edges[0]] } else { edges };
        let first = 3 * self.faces.len() as u32;
        self.faces.push(Face { points: order(points), wedges: order(wedges), edges, lines: 0 });
        for (k, p) in (0..).zip(order(points)) {
            self.next.push(std::mem::replace(&mut self.first[p as usize], first + k));
        }
        self.alive += 1;
    }

    /// Adds a point at the place of another, without faces.
    pub fn copy_point(&mut self, point: u32) -> u32 {
        self.positions.push(self.positions[point as usize]);
        self.locked.push(false);
        self.singular.push(false);
        self.first.push(NONE);
        self.marks.push(0);
        self.positions.len() as u32 - 1
    }

    /// Gives all corners at a point one wedge.
    pub fn name(&mut self, point: u32, wedge: u32) {
        for corner in self.corners_at(point) {
            self.faces[corner / 3].wedges[corner % 3] = wedge;
        }
    }

    /// Takes a face away, with what hangs on it; its edges stay numbered and may have no faces left.
    pub fn remove_face(&mut self, face: usize) {
        let points = self.faces[face].points;
        points.into_iter().for_each(|p| self.unlink(p, face));
        self.faces[face].points = [NONE; 3];
        self.alive -= 1;
    }

    /// Takes a face out of the list of a point.
    fn unlink(&mut self, point: u32, face: usize) {
        let mut before = NONE;
        let mut corner = self.first[point as usize];
        while corner != NONE {
            let next = self.next[corner as usize];
            if corner as usize / 3 == face {
                match before {
                    NONE => self.first[point as usize] = next,
                    before => self.next[before as usize] = next,
                }
                return;
            }
            before = corner;
            corner = next;
        }
    }
}

/// Corners around a point; see [`Surface::around`].
#[derive(Clone, Debug)]
pub struct Around<'a> {
    next: &'a [u32],
    corner: u32,
}

impl Iterator for Around<'_> {
    type Item = (usize, usize);

    #[inline]
    fn next(&mut self) -> Option<(usize, usize)> {
        let corner = self.corner as usize;
        self.corner = *self.next.get(corner)?;
        Some((corner / 3, corner % 3))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Two faces lie on each other at the edge from 0 to 1, and 2 is near both ends without a face between.
    #[test]
    fn an_edge_of_two_faces_over_one_point_stays() {
        let over = [[5u32, 0, 1], [1, 0, 5]];
        let rest = [[6, 1, 0], [6, 2, 1], [4, 0, 2], [2, 0, 4], [6, 7, 0], [0, 7, 2]];
        let corners = [&over[..], &rest].concat();
        let points: Vec<u32> = (0..8).collect();
        let mut surface = Surface::new(vec![DVec3::ZERO; 8], vec![false; 8], &points, corners.as_flattened());
        let edge = surface.edges.iter().position(|e| e.ends == [0, 1]).unwrap();
        assert!(!surface.can_collapse(edge as u32));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// Whatever is collapsed, also where many sheets meet.
        #[test]
        fn faces_beside_an_edge_are_those_that_have_it(
            corners in prop::collection::vec(prop::array::uniform3(0u32..12), 1..60),
            order in prop::collection::vec(0usize..1000, 20),
        ) {
            let positions: Vec<DVec3> = (0..12).map(|p| DVec3::splat(f64::from(p))).collect();
            let points: Vec<u32> = (0..12).collect();
            let mut surface = Surface::new(positions, vec![false; 12], &points, corners.as_flattened());
            for choice in order {
                let living = |e: &u32| surface.edges[*e as usize].ends[0] != NONE;
                let edges: Vec<u32> = (0..surface.edges.len() as u32).filter(living).collect();
                for e in &edges {
                    let has = |(f, face): (usize, &Face)| (face.alive() && face.has_edge(*e)).then_some(f);
                    let expected: Vec<usize> = surface.faces.iter().enumerate().filter_map(has).collect();
                    let mut found: Vec<usize> = surface.beside(*e).collect();
                    found.sort_unstable();
                    prop_assert_eq!(found, expected);
                }
                if edges.is_empty() {
                    break;
                }
                let edge = edges[choice % edges.len()];
                if surface.can_collapse(edge) {
                    let keep = surface.edges[edge as usize].ends[0];
                    surface.collapse(edge, keep, DVec3::ZERO, |_| {});
                } else if let Some(opening) = surface.opening(edge) {
                    for (k, e) in opening.edges.into_iter().enumerate() {
                        let ends = [opening.points[k], opening.points[(k + 1) % 3]];
                        prop_assert!(ends.iter().all(|p| surface.edges[e as usize].ends.contains(p)));
                        prop_assert_eq!(surface.edges[e as usize].faces, 1);
                    }
                    surface.close(&opening);
                }
            }
        }
    }
}
