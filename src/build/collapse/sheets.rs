//! Separating sheets that only touch. Where four faces meet at a non-manifold edge, or two fans at a point, each
//! sheet gets points of its own. Then each sheet is a manifold that collapses as any other (the cutting of Guéziec,
//! Taubin, Lazarus and Horn, "Cutting and Stitching: Converting Sets of Polygons to Manifold Surfaces", 2001).
//! Sheets whose points did not move meet again in the result, since equal positions are one.
//!
//! Faces at an edge are paired such that they run along it in opposite directions, the flattest pair first. A face
//! without a partner, as at a T of three sheets, joins the last pair, so that nothing opens. Locked points are not
//! separated.

use glam::DVec3;

use super::surface::{NONE, Surface};

/// A place between two others: the first, the second, and how far from one to the other.
pub type Between = (u32, u32, f64);

/// What a surface becomes.
#[derive(Debug, Default)]
pub struct Apart {
    /// Wedges of each face, three for each.
    pub corners: Vec<u32>,
    /// What wedges each new wedge is made of.
    pub wedges: Vec<Between>,
    /// The point of each new wedge: the number of an old one, or above them.
    pub points: Vec<u32>,
    /// What points each new point is made of.
    pub places: Vec<Between>,
}

/// Faces with the same vertices at an edge are paired before others.
const SAME: f64 = 4.0;

/// Sets of corners.
struct Sets(Vec<u32>);

impl Sets {
    fn find(&mut self, mut corner: u32) -> u32 {
        while self.0[corner as usize] != corner {
            let parent = self.0[corner as usize];
            self.0[corner as usize] = self.0[parent as usize];
            corner = parent;
        }
        corner
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// Separates sheets; `wedges` is the number of wedges. `None` where no sheets touch.
pub fn take_apart(surface: &Surface, wedges: usize) -> Option<Apart> {
    let crowded = |e: u32| surface.edges[e as usize].faces > 2;
    let free = |p: &u32| !surface.locked[*p as usize];
    if !(0..surface.positions.len() as u32).any(|p| free(&p) && surface.is_pinched(p)) {
        return None;
    }
    let mut sets = Sets((0..3 * surface.faces.len() as u32).collect());
    let corner_at = |f: usize, p: u32| {
        let k = surface.faces[f].points.iter().position(|q| *q == p).unwrap_or(0);
        (3 * f + k) as u32
    };
    let mut beside = Vec::new();
    // Edges of several sheets, and which faces are one.
    let mut several: Vec<(u32, Vec<Vec<usize>>)> = Vec::new();
    for e in 0..surface.edges.len() as u32 {
        let ends = surface.edges[e as usize].ends;
        beside.clear();
        beside.extend(surface.beside(e));
        let mut join = |f: usize, g: usize| {
            ends.into_iter().for_each(|p| sets.join(corner_at(f, p), corner_at(g, p)));
        };
        if crowded(e) {
            let sheets = sheets(surface, e, &beside);
            sheets.iter().flat_map(|sheet| sheet.windows(2)).for_each(|w| join(w[0], w[1]));
            several.push((e, sheets));
        } else {
            beside.windows(2).for_each(|w| join(w[0], w[1]));
        }
    }
    let mut parts =
        Apart { corners: surface.faces.iter().flat_map(|face| face.wedges).collect(), ..Apart::default() };
    let mut known: Vec<(u32, u32)> = Vec::new();
    let mut renamed: Vec<(u32, u32, u32)> = Vec::new();
    for p in (0..surface.positions.len() as u32).filter(free) {
        known.clear();
        renamed.clear();
        for (f, k) in surface.around(p) {
            let set = sets.find((3 * f + k) as u32);
            let point = match known.iter().find(|(other, _)| *other == set) {
                Some((_, point)) => *point,
                None => {
                    let mut point = p;
                    if !known.is_empty() {
                        point = (surface.positions.len() + parts.places.len()) as u32;
                        parts.places.push((p, p, 0.0));
                    }
                    known.push((set, point));
                    point
                }
            };
            if point == p {
                continue;
            }
            let wedge = &mut parts.corners[3 * f + k];
            *wedge = match renamed.iter().find(|(w, s, _)| (w, s) == (wedge, &set)) {
                Some((.., name)) => *name,
                None => {
                    let name = (wedges + parts.wedges.len()) as u32;
                    renamed.push((*wedge, set, name));
                    parts.wedges.push((*wedge, *wedge, 0.0));
                    parts.points.push(point);
                    name
                }
            };
        }
    }
    // Sheets that meet at an edge and at both of its ends would have two edges between the same points: all but one of
    // them get a point between.
    let mut middles: Vec<[u32; 3]> = Vec::new();
    for (e, sheets) in several {
        let ends = surface.edges[e as usize].ends;
        let mut of_ends = |f: usize| ends.map(|p| sets.find(corner_at(f, p)));
        let known: Vec<[u32; 2]> = sheets.iter().map(|sheet| of_ends(sheet[0])).collect();
        for (i, sheet) in sheets.iter().enumerate() {
            let before = known[..i].iter().filter(|other| **other == known[i]).count();
            let locked = ends.iter().all(|p| surface.locked[*p as usize]);
            if before == 0 || locked {
                continue;
            }
            let part = before as f64 / (before + 1) as f64;
            let point = (surface.positions.len() + parts.places.len()) as u32;
            parts.places.push((ends[0], ends[1], part));
            let mut last = None;
            for f in sheet.iter().copied() {
                let side = surface.faces[f].edges.iter().position(|edge| *edge == e).unwrap_or(0);
                let at = |p: u32| parts.corners[corner_at(f, p) as usize];
                let between = (at(ends[0]), at(ends[1]), part);
                if last != Some(between) {
                    parts.wedges.push(between);
                    parts.points.push(point);
                    last = Some(between);
                }
                if middles.is_empty() {
                    middles.resize(surface.faces.len(), [NONE; 3]);
                }
                middles[f][side] = (wedges + parts.wedges.len()) as u32 - 1;
            }
        }
    }
    if !middles.is_empty() {
        let corners = std::mem::take(&mut parts.corners);
        let faces = corners.chunks_exact(3).zip(&middles);
        faces.for_each(|(c, m)| divide([c[0], c[1], c[2]], *m, &mut parts.corners));
    }
    (!parts.places.is_empty()).then_some(parts)
}

/// A triangle with points between its corners, on the side from each to the next, or [`NONE`], as triangles.
fn divide(corners: [u32; 3], middles: [u32; 3], out: &mut Vec<u32>) {
    let count = middles.iter().filter(|m| **m != NONE).count();
    // Turned such that the first side has one, and with two the second as well.
    let first = (0..3).find(|k| {
        let next = middles[(k + 1) % 3] != NONE;
        middles[*k] != NONE && (count != 2 || next)
    });
    let k = first.unwrap_or(0);
    let [a, b, c] = [0, 1, 2].map(|j| corners[(k + j) % 3]);
    let [ab, bc, ca] = [0, 1, 2].map(|j| middles[(k + j) % 3]);
    match count {
        0 => out.extend(corners),
        1 => out.extend([ab, b, c, ab, c, a]),
        2 => out.extend([ab, b, bc, ab, bc, c, ab, c, a]),
        _ => out.extend([ab, b, bc, bc, c, ca, ca, a, ab, ab, bc, ca]),
    }
}

/// The faces of an edge by sheets: in pairs, and one that has no partner with the last of them.
fn sheets(surface: &Surface, edge: u32, beside: &[usize]) -> Vec<Vec<usize>> {
    let [a, b] = surface.edges[edge as usize].ends;
    let runs_forward = |f: &usize| {
        let points = surface.faces[*f].points;
        (0..3).any(|k| points[k] == a && points[(k + 1) % 3] == b)
    };
    let (forward, backward): (Vec<usize>, Vec<usize>) = beside.iter().partition(|f| runs_forward(f));
    let normal = |f: usize| {
        let [p, q, r] = surface.faces[f].points.map(|p| surface.positions[p as usize]);
        (q - p).cross(r - p).normalize_or_zero()
    };
    let of = |faces: &[usize]| faces.iter().map(|f| normal(*f)).collect::<Vec<DVec3>>();
    let (ahead, back) = (of(&forward), of(&backward));
    // A single sheet stays one.
    let meet = |f: usize, g: usize| {
        [a, b].iter().all(|p| {
            let wedge = |f: usize| {
                let face = &surface.faces[f];
                face.points.iter().position(|q| q == p).map(|k| face.wedges[k])
            };
            wedge(f) == wedge(g)
        })
    };
    let mut ranked: Vec<(f64, usize, usize)> = (0..forward.len())
        .flat_map(|i| (0..backward.len()).map(move |j| (i, j)))
        .map(|(i, j)| (-ahead[i].dot(back[j]) - f64::from(meet(forward[i], backward[j])) * SAME, i, j))
        .collect();
    ranked.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    let mut taken = [vec![false; forward.len()], vec![false; backward.len()]];
    let mut out = Vec::new();
    for (_, i, j) in ranked {
        if !taken[0][i] && !taken[1][j] {
            (taken[0][i], taken[1][j]) = (true, true);
            out.push(vec![forward[i], backward[j]]);
        }
    }
    let left = |faces: Vec<usize>, taken: &[bool]| -> Vec<usize> {
        faces.into_iter().zip(taken).filter(|(_, taken)| !**taken).map(|(f, _)| f).collect()
    };
    let mut rest = left(forward, &taken[0]);
    rest.extend(left(backward, &taken[1]));
    out.extend(rest.chunks_exact(2).map(<[usize]>::to_vec));
    let single = rest.chunks_exact(2).remainder();
    out.last_mut().into_iter().for_each(|last| last.extend(single));
    out
}
