//! Terrain as a triangulated irregular network: greedy insertion into a Delaunay triangulation (Garland and Heckbert 1995).
//!
//! The post that is farthest from the triangulation is inserted until none is farther than the tolerance; then the heights of
//! the vertices are moved to where the sum of squares over all posts is least, as far as the tolerance allows. All decisions
//! about places are exact, in integers.
//!
//! Outlines of holes are kept: all of their posts are inserted first. Two posts of a cell's side have no other post in the
//! circle over them, and the diagonal of a cell that lacks a post has none inside its own, so that Delaunay triangulations
//! have these edges, and every triangle is inside or outside as a whole. Along the border of the array, posts are chosen by
//! those of the border alone, so that arrays that share one agree.

use std::collections::BinaryHeap;

use crate::error::{Error, Result};

/// Posts of a side, at most: with it, the in-circle test fits 64 bits.
pub const MOST_POSTS: usize = 8192;
/// Which triangles and edges there are none of.
const NONE: u32 = u32::MAX;
/// Steps of conjugate gradients; heights are then right to a small part of the tolerance.
const FIT_STEPS: usize = 40;
/// Halvings after which a vertex has the height of its post again.
const MOST_HALVINGS: u8 = 6;

/// A rectangle of posts. Rows and columns are 1 apart.
#[derive(Clone, Copy, Debug)]
pub struct Posts<'a> {
    /// Rows of heights.
    pub heights: &'a [f64],
    /// What each post is.
    pub roles: &'a [u8],
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// A post that belongs to no surface.
pub const NO_POST: u8 = 0;
/// A post that the surface is measured at.
pub const MEASURED_POST: u8 = 1;
/// A post at the outline of a hole, which is a vertex.
pub const OUTLINE_POST: u8 = 2;

/// A triangulation of posts.
#[derive(Clone, Debug, Default)]
pub struct Network {
    /// Columns and rows of the vertices.
    pub places: Vec<[u32; 2]>,
    /// Their heights.
    pub heights: Vec<f64>,
    /// Triangles, counter-clockwise where rows go down.
    pub triangles: Vec<[u32; 3]>,
    /// Largest vertical distance of a post.
    pub error: f64,
    /// Sum of squares of the distances of all posts, and how many these are.
    pub squares: f64,
    /// Posts that were measured.
    pub measured: u64,
}

type Point = [i64; 2];

/// Twice the area, positive when a, b, c turn counter-clockwise where rows go down.
fn area(a: Point, b: Point, c: Point) -> i64 {
    (b[1] - a[1]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[1] - a[1])
}

/// Whether p lies inside of the circle through a, b, c, which turn counter-clockwise.
fn in_circle(a: Point, b: Point, c: Point, p: Point) -> bool {
    let [d, e, f] = [a, b, c].map(|q| [q[0] - p[0], q[1] - p[1]]);
    let [dd, ee, ff] = [d, e, f].map(|q| q[0] * q[0] + q[1] * q[1]);
    let determinant =
        d[0] * (e[1] * ff - ee * f[1]) - d[1] * (e[0] * ff - ee * f[0]) + dd * (e[0] * f[1] - e[1] * f[0]);
    // Rows go down.
    determinant < 0
}

struct Triangulation<'a> {
    posts: Posts<'a>,
    tolerance: f64,
    places: Vec<Point>,
    triangles: Vec<u32>,
    /// Of the edge from corner k to the next: that of the triangle behind.
    twins: Vec<u32>,
    /// How often a triangle changed, so that what waits for an older one is known.
    versions: Vec<u32>,
    /// What of triangles is farthest: distance in bits, triangle, version, post.
    waiting: BinaryHeap<(u64, u32, u32, u32)>,
    changed: Vec<u32>,
}

impl<'a> Triangulation<'a> {
    fn new(posts: Posts<'a>, tolerance: f64) -> Self {
        let (w, h) = (posts.width as i64 - 1, posts.height as i64 - 1);
        Self {
            posts,
            tolerance,
            places: vec![[0, 0], [w, 0], [w, h], [0, h]],
            // The diagonal from the first corner to the third.
            triangles: vec![0, 3, 2, 0, 2, 1],
            twins: vec![NONE, NONE, 3, 2, NONE, NONE],
            versions: vec![0, 0],
            waiting: BinaryHeap::new(),
            changed: vec![0, 1],
        }
    }

    fn corners(&self, t: u32) -> [Point; 3] {
        [0, 1, 2].map(|k| self.places[self.triangles[3 * t as usize + k] as usize])
    }

    /// The height of a post; of one without, 0.
    fn post(&self, p: Point) -> f64 {
        let height = self.posts.heights[p[1] as usize * self.posts.width + p[0] as usize];
        if height.is_nan() { 0.0 } else { height }
    }

    fn link(&mut self, a: u32, b: u32) {
        self.twins[a as usize] = b;
        if b != NONE {
            self.twins[b as usize] = a;
        }
    }

    /// Writes a triangle, and behind its edges what belongs there.
    fn write(&mut self, t: u32, corners: [u32; 3], twins: [u32; 3]) {
        if 3 * t as usize == self.triangles.len() {
            self.triangles.extend([0; 3]);
            self.twins.extend([NONE; 3]);
            self.versions.push(0);
        }
        for k in 0..3 {
            self.triangles[3 * t as usize + k] = corners[k];
            self.link(3 * t + k as u32, twins[k]);
        }
        self.versions[t as usize] += 1;
        self.changed.push(t);
    }

    /// Inserts a place that lies in a triangle or on one of its edges, and is no corner of it.
    fn insert(&mut self, t: u32, p: Point) {
        let number = self.places.len() as u32;
        let corners = self.corners(t);
        self.places.push(p);
        let on = (0..3).find(|k| area(corners[*k], corners[(k + 1) % 3], p) == 0);
        let next = |count: usize| (count / 3) as u32;
        let at = |e: u32, k: u32| 3 * (e / 3) + (e % 3 + k) % 3;
        if let Some(k) = on {
            // Edge e from a to b, across from it c; behind it d.
            let e = 3 * t + k as u32;
            let behind = self.twins[e as usize];
            let v = |edge: u32| self.triangles[edge as usize];
            let (a, b, c) = (v(e), v(at(e, 1)), v(at(e, 2)));
            let (of_bc, of_ca) = (self.twins[at(e, 1) as usize], self.twins[at(e, 2) as usize]);
            let t1 = next(self.triangles.len());
            if behind == NONE {
                self.write(t, [number, c, a], [NONE, of_ca, NONE]);
                self.write(t1, [number, b, c], [NONE, of_bc, 3 * t]);
                self.legalize(&[3 * t + 1, 3 * t1 + 1]);
            } else {
                let d = v(at(behind, 2));
                let s = behind / 3;
                let (of_ad, of_db) = (self.twins[at(behind, 1) as usize], self.twins[at(behind, 2) as usize]);
                self.write(t, [number, c, a], [NONE, of_ca, NONE]);
                self.write(t1, [number, b, c], [NONE, of_bc, 3 * t]);
                let t2 = next(self.triangles.len());
                self.write(s, [number, a, d], [3 * t + 2, of_ad, NONE]);
                self.write(t2, [number, d, b], [3 * s + 2, of_db, 3 * t1]);
                self.legalize(&[3 * t + 1, 3 * t1 + 1, 3 * s + 1, 3 * t2 + 1]);
            }
        } else {
            let e = 3 * t as usize;
            let [a, b, c] = [0, 1, 2].map(|k| self.triangles[e + k]);
            let behind = [0, 1, 2].map(|k| self.twins[e + k]);
            let (t1, t2) = (next(self.triangles.len()), next(self.triangles.len()) + 1);
            self.write(t, [number, a, b], [NONE, behind[0], NONE]);
            self.write(t1, [number, b, c], [3 * t + 2, behind[1], NONE]);
            self.write(t2, [number, c, a], [3 * t1 + 2, behind[2], 3 * t]);
            self.legalize(&[3 * t + 1, 3 * t1 + 1, 3 * t2 + 1]);
        }
    }

    /// Flips edges, each across from the new place, until the triangulation is Delaunay again.
    fn legalize(&mut self, edges: &[u32]) {
        let mut stack = edges.to_vec();
        while let Some(e) = stack.pop() {
            let behind = self.twins[e as usize];
            if behind == NONE {
                continue;
            }
            let at = |e: u32, k: u32| 3 * (e / 3) + (e % 3 + k) % 3;
            let v = |edge: u32| self.triangles[edge as usize];
            // Triangle (a, b, p) with the edge from a to b, and (b, a, d) behind.
            let (a, b, p, d) = (v(e), v(at(e, 1)), v(at(e, 2)), v(at(behind, 2)));
            let [pa, pb, pp, pd] = [a, b, p, d].map(|k| self.places[k as usize]);
            if !in_circle(pa, pb, pp, pd) {
                continue;
            }
            let (of_bp, of_pa) = (self.twins[at(e, 1) as usize], self.twins[at(e, 2) as usize]);
            let (of_ad, of_db) = (self.twins[at(behind, 1) as usize], self.twins[at(behind, 2) as usize]);
            let (t, s) = (e / 3, behind / 3);
            self.write(t, [p, a, d], [of_pa, of_ad, NONE]);
            self.write(s, [p, d, b], [3 * t + 2, of_db, of_bp]);
            stack.extend([3 * t + 1, 3 * s + 1]);
        }
    }

    /// Finds what is farthest in each triangle that changed.
    fn look(&mut self) {
        let mut changed = std::mem::take(&mut self.changed);
        changed.sort_unstable();
        changed.dedup();
        for t in changed {
            let corners = self.corners(t);
            let heights = corners.map(|c| self.post(c));
            let (mut most, mut at) = (self.tolerance, NONE);
            let inner = |[x, y]: Point| {
                x > 0 && y > 0 && x < self.posts.width as i64 - 1 && y < self.posts.height as i64 - 1
            };
            self.posts.over(corners, heights, |p, index, off, _| {
                if off > most && inner(p) {
                    (most, at) = (off, index as u32);
                }
            });
            if at != NONE {
                self.waiting.push((most.to_bits(), t, self.versions[t as usize], at));
            }
        }
    }

    /// Inserts the place of a post, wherever it is.
    fn insert_anywhere(&mut self, p: Point, near: &mut u32) {
        let mut t = *near;
        loop {
            let corners = self.corners(t);
            if corners.contains(&p) {
                return;
            }
            match (0..3).find(|k| area(corners[*k], corners[(k + 1) % 3], p) < 0) {
                // In a Delaunay triangulation such a walk ends.
                Some(k) => t = self.twins[3 * t as usize + k] / 3,
                None => break,
            }
        }
        self.insert(t, p);
        *near = t;
    }
}

impl Posts<'_> {
    /// Calls with each post in a triangle: its place and index, how far it is from the plane, and its weights. Posts without a
    /// role are left out.
    fn over(
        &self,
        corners: [Point; 3],
        heights: [f64; 3],
        mut call: impl FnMut(Point, usize, f64, [f64; 3]),
    ) {
        let [a, b, c] = corners;
        let whole = area(a, b, c) as f64;
        let rows = [a[1].min(b[1]).min(c[1]), a[1].max(b[1]).max(c[1])];
        for y in rows[0]..=rows[1] {
            let (mut lo, mut hi) = (a[0].min(b[0]).min(c[0]), a[0].max(b[0]).max(c[0]));
            for (p, q) in [(a, b), (b, c), (c, a)] {
                // area(p, q, (x, y)) = slope · x + rest ≥ 0
                let slope = q[1] - p[1];
                let rest = -slope * p[0] - (q[0] - p[0]) * (y - p[1]);
                match slope {
                    1.. => lo = lo.max(-(rest.div_euclid(slope))),
                    0 if rest < 0 => hi = lo - 1,
                    0 => {}
                    _ => hi = hi.min(rest.div_euclid(-slope)),
                }
            }
            for x in lo..=hi {
                let index = y as usize * self.width + x as usize;
                if self.roles[index] == NO_POST {
                    continue;
                }
                let u = area(b, c, [x, y]) as f64 / whole;
                let v = area(c, a, [x, y]) as f64 / whole;
                let weights = [u, v, 1.0 - u - v];
                let plane = weights[0] * heights[0] + weights[1] * heights[1] + weights[2] * heights[2];
                call([x, y], index, (plane - self.heights[index]).abs(), weights);
            }
        }
    }

    /// Chooses posts between two of the border, which are vertices, by halving where the line is farthest off.
    fn choose(&self, line: &[Point], tolerance: f64, chosen: &mut Vec<Point>) {
        let height = |p: Point| self.heights[p[1] as usize * self.width + p[0] as usize];
        let mut stack = vec![(0, line.len() - 1)];
        while let Some((i, j)) = stack.pop() {
            let (a, b) = (height(line[i]), height(line[j]));
            let off = |k: usize| (a + (b - a) * ((k - i) as f64 / (j - i) as f64) - height(line[k])).abs();
            let farthest = (i + 1..j).max_by(|x, y| off(*x).total_cmp(&off(*y)).then(y.cmp(x)));
            if let Some(k) = farthest.filter(|k| off(*k) > tolerance) {
                chosen.push(line[k]);
                stack.extend([(k, j), (i, k)]);
            }
        }
    }

    /// Posts that are vertices from the start: outlines of holes, and what the border needs.
    fn first(&self, tolerance: f64) -> Vec<Point> {
        let (w, h) = (self.width as i64 - 1, self.height as i64 - 1);
        let role = |p: Point| self.roles[p[1] as usize * self.width + p[0] as usize];
        let mut chosen = Vec::new();
        let sides: [Vec<Point>; 4] = [
            (0..=w).map(|x| [x, 0]).collect(),
            (0..=w).map(|x| [x, h]).collect(),
            (0..=h).map(|y| [0, y]).collect(),
            (0..=h).map(|y| [w, y]).collect(),
        ];
        for side in sides {
            let mut start = 0;
            for k in 1..side.len() {
                if role(side[k]) == OUTLINE_POST || k + 1 == side.len() {
                    // Where a post is missing there is a hole, whose outline is there already.
                    if side[start..=k].iter().all(|p| role(*p) != NO_POST) {
                        self.choose(&side[start..=k], tolerance, &mut chosen);
                    }
                    start = k;
                }
            }
        }
        let all = (0..=h).flat_map(|y| (0..=w).map(move |x| [x, y]));
        chosen.extend(all.filter(|p| role(*p) == OUTLINE_POST));
        chosen
    }

    /// Whether a triangle that is inside or outside as a whole is inside: by the cell at its centre.
    fn inside(&self, corners: [Point; 3]) -> bool {
        let there = |x: i64, y: i64| self.roles[y as usize * self.width + x as usize] != NO_POST;
        // Thrice the centre.
        let [x3, y3] = [0, 1].map(|k| corners.iter().map(|c| c[k]).sum::<i64>());
        let (x, y) = ((x3 / 3).min(self.width as i64 - 2), (y3 / 3).min(self.height as i64 - 2));
        let posts = [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]];
        let missing: Vec<usize> = (0..4).filter(|k| !there(posts[*k][0], posts[*k][1])).collect();
        match missing[..] {
            [] => true,
            // Beyond the diagonal, as seen from the missing one.
            [one] => {
                let away = [0, 1].map(|k| ([x3, y3][k] - 3 * posts[one][k]).abs());
                away[0] + away[1] > 3
            }
            _ => false,
        }
    }
}

/// A triangulation of which no measured post is farther than `tolerance`, unless that takes more than so many triangles.
pub fn heightfield(
    posts: Posts<'_>,
    tolerance: f64,
    most: usize,
    fit: bool,
    check: &dyn Fn() -> bool,
) -> Result<Network> {
    let (w, h) = (posts.width, posts.height);
    if !(2..=MOST_POSTS).contains(&w) || !(2..=MOST_POSTS).contains(&h) {
        let message = format!("expected 2 to {MOST_POSTS} posts along each side, found {h} and {w}");
        return Err(Error::argument("heights", message));
    }
    let mut made = Triangulation::new(posts, tolerance);
    let mut near = 0;
    for p in posts.first(tolerance) {
        made.insert_anywhere(p, &mut near);
    }
    made.look();
    while let Some((_, t, version, post)) = made.waiting.pop() {
        if made.versions[t as usize] != version {
            continue;
        }
        if made.versions.len() >= most {
            break;
        }
        if made.places.len().is_multiple_of(256) && !check() {
            return Err(Error::Cancelled);
        }
        let post = post as usize;
        made.insert(t, [(post % w) as i64, (post / w) as i64]);
        made.look();
    }
    Ok(finished(&made, fit))
}

/// The triangles that are inside, with heights that are fitted, and how far posts are.
fn finished(made: &Triangulation<'_>, fit: bool) -> Network {
    let posts = made.posts;
    let mut numbers = vec![NONE; made.places.len()];
    let mut out = Network::default();
    let mut corners = Vec::new();
    for t in 0..made.versions.len() as u32 {
        let places = made.corners(t);
        if !posts.inside(places) {
            continue;
        }
        let vertices = [0, 1, 2].map(|k| made.triangles[3 * t as usize + k]);
        for v in vertices {
            if numbers[v as usize] == NONE {
                numbers[v as usize] = out.places.len() as u32;
                let place = made.places[v as usize];
                out.places.push(place.map(|x| x as u32));
                out.heights.push(made.post(place));
            }
        }
        out.triangles.push(vertices.map(|v| numbers[v as usize]));
        corners.push(places);
    }
    if fit {
        fit_heights(&posts, &mut out, &corners, made.tolerance);
    }
    let mut seen = vec![false; posts.heights.len()];
    for (triangle, places) in out.triangles.iter().zip(&corners) {
        let heights = triangle.map(|v| out.heights[v as usize]);
        posts.over(*places, heights, |_, index, off, _| {
            if !std::mem::replace(&mut seen[index], true) {
                out.error = out.error.max(off);
                out.squares += off * off;
                out.measured += 1;
            }
        });
    }
    out
}

/// Moves heights to where squares are least, as far as no post gets farther than the tolerance. The border stays.
fn fit_heights(posts: &Posts<'_>, out: &mut Network, corners: &[[Point; 3]], tolerance: f64) {
    let n = out.places.len();
    let mut seen = vec![false; posts.heights.len()];
    // Of each triangle, sums of products of weights, and of weights and what is left of heights.
    let mut products = vec![[0.0; 6]; corners.len()];
    let mut gradient = vec![0.0; n];
    for (t, places) in corners.iter().enumerate() {
        let triangle = out.triangles[t];
        let heights = triangle.map(|v| out.heights[v as usize]);
        posts.over(*places, heights, |_, index, _, weights| {
            if std::mem::replace(&mut seen[index], true) {
                return;
            }
            let [a, b, c] = weights;
            let plane = a * heights[0] + b * heights[1] + c * heights[2];
            for (sum, product) in products[t].iter_mut().zip([a * a, b * b, c * c, a * b, b * c, c * a]) {
                *sum += product;
            }
            for k in 0..3 {
                gradient[triangle[k] as usize] += weights[k] * (posts.heights[index] - plane);
            }
        });
    }
    let free: Vec<f64> = out
        .places
        .iter()
        .map(|[x, y]| {
            let (x, y) = (*x as usize, *y as usize);
            let border = x == 0 || y == 0 || x + 1 == posts.width || y + 1 == posts.height;
            if border { 0.0 } else { 1.0 }
        })
        .collect();
    let moves = least_squares(&out.triangles, &products, gradient, &free);
    let first = out.heights.clone();
    let mut halvings: Vec<u8> = free.iter().map(|f| if *f == 0.0 { MOST_HALVINGS } else { 0 }).collect();
    let place = |v: usize, halvings: u8| {
        let part = if halvings >= MOST_HALVINGS { 0.0 } else { 0.5_f64.powi(i32::from(halvings)) };
        first[v] + moves[v] * part
    };
    (0..n).for_each(|v| out.heights[v] = place(v, halvings[v]));
    let mut dirty = vec![true; n];
    loop {
        let mut changed = vec![false; n];
        for (triangle, places) in out.triangles.iter().zip(corners) {
            if !triangle.iter().any(|v| dirty[*v as usize]) {
                continue;
            }
            let heights = triangle.map(|v| out.heights[v as usize]);
            let mut most = 0.0_f64;
            posts.over(*places, heights, |_, _, off, _| most = most.max(off));
            if most > tolerance {
                triangle.iter().for_each(|v| changed[*v as usize] |= halvings[*v as usize] < MOST_HALVINGS);
            }
        }
        if !changed.contains(&true) {
            return;
        }
        for v in (0..n).filter(|v| changed[*v]) {
            halvings[v] += 1;
            out.heights[v] = place(v, halvings[v]);
        }
        dirty = changed;
    }
}

/// Solves the normal equations by conjugate gradients, scaled by the diagonal.
fn least_squares(
    triangles: &[[u32; 3]],
    products: &[[f64; 6]],
    mut residual: Vec<f64>,
    free: &[f64],
) -> Vec<f64> {
    let n = free.len();
    let apply = |x: &[f64]| {
        let mut y = vec![0.0; n];
        for (t, m) in triangles.iter().zip(products) {
            let [a, b, c] = t.map(|v| v as usize);
            y[a] += m[0] * x[a] + m[3] * x[b] + m[5] * x[c];
            y[b] += m[3] * x[a] + m[1] * x[b] + m[4] * x[c];
            y[c] += m[5] * x[a] + m[4] * x[b] + m[2] * x[c];
        }
        y.iter_mut().zip(free).for_each(|(y, f)| *y *= f);
        y
    };
    let mut diagonal = vec![0.0; n];
    for (t, m) in triangles.iter().zip(products) {
        (0..3).for_each(|k| diagonal[t[k] as usize] += m[k]);
    }
    let scaled = |r: &[f64]| -> Vec<f64> {
        (0..n).map(|v| if diagonal[v] > 0.0 { r[v] / diagonal[v] } else { 0.0 }).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    residual.iter_mut().zip(free).for_each(|(r, f)| *r *= f);
    let mut found = vec![0.0; n];
    let mut direction = scaled(&residual);
    let mut power = dot(&residual, &direction);
    for _ in 0..FIT_STEPS {
        if power <= 0.0 {
            break;
        }
        let ahead = apply(&direction);
        let step = power / dot(&direction, &ahead);
        for v in 0..n {
            found[v] += step * direction[v];
            residual[v] -= step * ahead[v];
        }
        let next = scaled(&residual);
        let grown = dot(&residual, &next);
        for v in 0..n {
            direction[v] = next[v] + direction[v] * (grown / power);
        }
        power = grown;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(
        w: usize,
        h: usize,
        tolerance: f64,
        role: impl Fn(usize, usize) -> u8,
        z: impl Fn(f64, f64) -> f64,
    ) -> Network {
        let places = || (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
        let heights: Vec<f64> = places().map(|(x, y)| z(x as f64, y as f64)).collect();
        let roles: Vec<u8> = places().map(|(x, y)| role(x, y)).collect();
        let posts = Posts { heights: &heights, roles: &roles, width: w, height: h };
        heightfield(posts, tolerance, usize::MAX, true, &|| true).unwrap()
    }

    fn total_area(out: &Network) -> f64 {
        let of = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| out.places[v as usize].map(i64::from));
            let twice = area(a, b, c);
            assert!(twice > 0);
            twice as f64 / 2.0
        };
        out.triangles.iter().map(of).sum()
    }

    #[test]
    fn planes_take_two_triangles() {
        let out = network(33, 17, 1e-9, |_, _| MEASURED_POST, |x, y| 0.5 * x - 0.25 * y);
        assert_eq!(out.triangles.len(), 2);
        assert_eq!(total_area(&out), 32.0 * 16.0);
        assert_eq!(out.measured, 33 * 17);
    }

    #[test]
    fn waves_are_met_within_the_tolerance() {
        let z = |x: f64, y: f64| (x * 0.2).sin() * (y * 0.13).cos();
        let out = network(101, 91, 0.01, |_, _| MEASURED_POST, z);
        assert_eq!(total_area(&out), 100.0 * 90.0);
        assert!(out.error <= 0.01 && out.triangles.len() < 9000, "{} {}", out.error, out.triangles.len());
    }

    #[test]
    fn holes_keep_their_outline() {
        // A square of 5 × 5 posts is missing, with all cells that touch it.
        let missing = |x: usize, y: usize| (10..15).contains(&x) && (20..25).contains(&y);
        let near = |x: usize, y: usize| (9..16).contains(&x) && (19..26).contains(&y);
        let role = |x: usize, y: usize| match (missing(x, y), near(x, y)) {
            (true, _) => NO_POST,
            (_, true) => OUTLINE_POST,
            _ => MEASURED_POST,
        };
        let out = network(41, 41, 0.05, role, |x, y| (x * 0.3).sin() + y * 0.01);
        // Of the cells at the corners of the hole, each keeps a half.
        assert_eq!(total_area(&out), 1600.0 - 36.0 + 2.0);
    }
}
