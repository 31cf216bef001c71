//! What collapsing changed in a region, and bounds of the distance to what it was.

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::gather::Region;
use crate::build::attribute_error::deviation_above;
use crate::build::content::{Content, up};
use crate::build::relax::{fit, sheet};
use crate::build::store::LocalMesh;
use crate::math::sphere::round_up;
use crate::measure::closest::Triangle;
use crate::measure::overlay::{Bounds, NO_TRIANGLE, Overlay, Sheet};
use crate::measure::piece::Piece;
use crate::measure::{BoundOptions, outwards};
use crate::model::{ClusterAddress, Dag, Group};

/// A bound may be this part above the largest distance found.
const SLACK: f64 = 0.1;

/// A region after its edges were collapsed, triangle by triangle.
#[derive(Debug)]
pub struct Changes {
    /// The region as it is now, its vertices numbered as before.
    pub after: LocalMesh,
    /// Whether a vertex that is used is a new one.
    pub moved: Vec<bool>,
    /// For each triangle the one of the region that it still is, if any.
    pub was: Vec<Option<u32>>,
    /// For each triangle of the region whether it is gone.
    gone: Vec<bool>,
    /// Components were removed, so that whole surfaces have to be compared.
    pub pruned: bool,
}

fn corners(mesh: &LocalMesh) -> impl Iterator<Item = [u32; 3]> {
    mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]])
}

impl Changes {
    /// Compares a region with its simplification.
    pub fn new(region: &Region, mut after: LocalMesh, pruned: bool) -> Self {
        let before = &region.mesh;
        // Vertices behind the copies are new.
        let mut moved = vec![true; after.ids.len()];
        for (v, moved) in moved.iter_mut().enumerate().take(before.ids.len() + after.copies.len()) {
            *moved = after.differs(before, v);
        }
        after.join_copies(|_, v| moved[v]);
        let known: FxHashMap<[u32; 3], u32> = corners(before).zip(0..).collect();
        let mut gone = vec![true; region.faces()];
        let was = corners(&after)
            .map(|t| {
                let same = known.get(&t).copied().filter(|_| t.iter().all(|v| !moved[*v as usize]));
                same.into_iter().for_each(|t| gone[t as usize] = false);
                same
            })
            .collect();
        let pruned = pruned || lost_a_part(before, &after);
        Self { after, moved, was, gone, pruned }
    }

    /// The clusters that lost triangles.
    pub fn touched(&self, region: &Region) -> Vec<ClusterAddress> {
        let owners = region.owners.iter().zip(&self.gone).filter(|(_, gone)| **gone).map(|(owner, _)| *owner);
        let mut owners: Vec<u32> = owners.collect();
        owners.sort_unstable();
        owners.dedup();
        owners.into_iter().map(|owner| region.clusters[owner as usize]).collect()
    }

    /// The removed triangles and the new ones; all of both where components were removed.
    fn sides(&self, region: &Region) -> [Side; 2] {
        let went = corners(&region.mesh).zip(&self.gone);
        let came = corners(&self.after).zip(&self.was).map(|(t, was)| (t, was.is_none()));
        let side = |mesh: &LocalMesh, triangles: Vec<([u32; 3], bool)>| {
            let here = || triangles.iter().filter(|(_, changed)| *changed || self.pruned);
            let (part, vertices) = part(mesh, here().flat_map(|(t, _)| *t).collect());
            Side { part, vertices, changed: here().map(|(_, changed)| *changed).collect() }
        };
        [side(&region.mesh, went.map(|(t, gone)| (t, *gone)).collect()), side(&self.after, came.collect())]
    }

    /// Relaxes the new triangles to fit the removed ones best; samples farther than `reach` do not count.
    pub fn relax(&mut self, region: &Region, reach: f64) {
        let [went, came] = self.sides(region);
        if self.pruned || went.part.indices.is_empty() || came.part.indices.is_empty() {
            return;
        }
        let mut held = vec![false; self.after.ids.len()];
        let stays = corners(&self.after).zip(&self.was).filter(|(_, was)| was.is_some());
        stays.flat_map(|(t, _)| t).for_each(|v| held[v as usize] = true);
        held.iter_mut().zip(&self.after.locked).for_each(|(held, locked)| *held |= locked);
        let bits = |p: [f32; 3]| p.map(|x| (x + 0.0).to_bits());
        let places: FxHashSet<[u32; 3]> =
            (0..held.len()).filter(|v| held[*v]).map(|v| bits(self.after.positions[v])).collect();
        let mut mesh = came.part;
        mesh.locked = mesh.positions.iter().map(|p| places.contains(&bits(*p))).collect();
        let up = up_of(&mesh);
        fit(&mut mesh, &went.part, reach, up);
        for (v, position) in came.vertices.iter().zip(&mesh.positions) {
            let v = *v as usize;
            self.moved[v] |= self.after.positions[v] != *position;
            self.after.positions[v] = *position;
        }
    }

    /// Relaxes the whole surface to fit a finer one best; samples farther than `reach` do not count.
    pub fn relax_to(&mut self, finer: &Region, reach: f64) {
        let before = self.after.positions.clone();
        let up = up_of(&self.after);
        fit(&mut self.after, &finer.mesh, reach, up);
        for (v, position) in before.iter().enumerate() {
            self.moved[v] |= self.after.positions[v] != *position;
        }
        self.compare();
    }

    /// Finds again which triangles are unchanged, after vertices moved.
    fn compare(&mut self) {
        for (t, was) in self.after.indices.chunks_exact(3).zip(&mut self.was) {
            if t.iter().any(|v| self.moved[*v as usize])
                && let Some(was) = was.take()
            {
                self.gone[was as usize] = true;
            }
        }
    }

    /// A bound of the distance of the whole to the source, by way of a finer cut; at least `enough`.
    pub fn bound_to(&self, dag: &Dag, finer: &Region, enough: f32) -> f32 {
        let all = |mesh: &LocalMesh| -> Side {
            let (part, vertices) = part(mesh, mesh.indices.clone());
            Side { changed: vec![true; part.indices.len() / 3], part, vertices }
        };
        let [from, onto] = [all(&finer.mesh), all(&self.after)];
        // The two share no vertex numbers.
        let onto = Side { vertices: Vec::new(), ..onto };
        between(&from, &finer.radii(dag), &onto, enough).max(enough)
    }

    /// A bound of the distance to the source: the clusters' own and the distance from them; at least `enough`.
    pub fn bound(&self, dag: &Dag, region: &Region, enough: f32) -> f32 {
        let [went, came] = self.sides(region);
        if went.part.indices.is_empty() || came.part.indices.is_empty() {
            return enough;
        }
        let all = region.radii(dag);
        let radii = all.into_iter().zip(&self.gone).filter(|(_, gone)| **gone || self.pruned);
        let radii: Vec<f64> = radii.map(|(radius, _)| radius).collect();
        between(&went, &radii, &came, enough).max(enough)
    }

    /// A bound of the deviation of attributes from the clusters'; deviations up to `enough` are not told apart.
    pub fn deviation(&self, region: &Region, content: &Content, free: f32, enough: f32) -> f32 {
        let [went, came] = self.sides(region);
        if went.part.indices.is_empty() || came.part.indices.is_empty() {
            return 0.0;
        }
        deviation_above(&went.part, &came.part, content, free, enough)
    }
}

/// Some triangles of one of the two surfaces.
struct Side {
    part: LocalMesh,
    /// The vertices of the region that its vertices are, if both sides are of one.
    vertices: Vec<u32>,
    /// Which of its triangles the other one does not have.
    changed: Vec<bool>,
}

/// Whether a connected component of a mesh has no vertex left.
fn lost_a_part(before: &LocalMesh, after: &LocalMesh) -> bool {
    let mut parents: Vec<u32> = (0..before.ids.len() as u32).collect();
    let find = |parents: &mut [u32], mut v: u32| {
        while parents[v as usize] != v {
            parents[v as usize] = parents[parents[v as usize] as usize];
            v = parents[v as usize];
        }
        v
    };
    let points = |t: [u32; 3]| t.map(|v| before.position_ids[v as usize]);
    for [a, b, c] in corners(before).map(points) {
        for other in [b, c] {
            let (root, other) = (find(&mut parents, a), find(&mut parents, other));
            parents[root.max(other) as usize] = root.min(other);
        }
    }
    let mut left = vec![false; parents.len()];
    for v in &after.indices {
        if let Some(point) = before.position_ids.get(after.origin(*v as usize)) {
            left[find(&mut parents, *point) as usize] = true;
        }
    }
    corners(before).map(points).any(|t| !left[find(&mut parents, t[0]) as usize])
}

impl Region {
    /// How far each of its triangles may be from the source.
    fn radii(&self, dag: &Dag) -> Vec<f64> {
        let bound_of = |at: &ClusterAddress| {
            let origin = dag.groups.get(dag.record(*at).refined as usize);
            f64::from(origin.map_or(0.0, Group::distance))
        };
        let of_cluster: Vec<f64> = self.clusters.iter().map(bound_of).collect();
        self.owners.iter().map(|owner| of_cluster[*owner as usize]).collect()
    }
}

/// The direction that all faces of a mesh face, if there is one.
fn up_of(mesh: &LocalMesh) -> Option<DVec3> {
    up(&mesh.positions, bytemuck::cast_slice(&mesh.indices))
}

/// A bound of the two-sided (Hausdorff) distance of two surfaces. Each triangle of the first stands for any surface
/// within its radius. Distances up to `enough` are not told apart.
fn between(a: &Side, radii: &[f64], b: &Side, enough: f32) -> f32 {
    let none = vec![0.0; b.changed.len()];
    // Both directions in parallel.
    let (mut there, mut back) = rayon::join(
        || Laying::new(a, radii, sheet(&b.part, none.clone()), b),
        || Laying::new(b, &none, sheet(&a.part, radii.to_vec()), a),
    );
    let floor = f64::from(enough).max(there.known.max(back.known) * (1.0 + SLACK));
    let goal = BoundOptions { floor, slack: SLACK, ..BoundOptions::default() };
    let (there, back) = rayon::join(|| there.bound(goal), || back.bound(goal));
    let all = a.part.positions.iter().chain(&b.part.positions).flatten();
    let largest = all.fold(0.0f64, |most, x| most.max(f64::from(x.abs())));
    round_up(outwards(there.max(back), largest))
}

/// The changed triangles of one side, to be overlaid with the other side.
struct Laying {
    /// Each triangle, its radius, and where the search on the other side starts.
    pieces: Vec<(Triangle, f64, u32)>,
    sheet: Sheet,
    /// About the largest distance of a point: smaller ones need not be told apart.
    known: f64,
}

impl Laying {
    fn new(from: &Side, radii: &[f64], sheet: Sheet, onto: &Side) -> Self {
        // Where a vertex is on both sides, so are triangles near it.
        let most = from.vertices.iter().chain(&onto.vertices).max().map_or(0, |v| *v as usize + 1);
        let mut start = vec![NO_TRIANGLE; most];
        for (t, number) in corners(&onto.part).zip(0..) {
            let vertices = t.iter().filter_map(|v| onto.vertices.get(*v as usize));
            vertices.for_each(|v| start[*v as usize] = number);
        }
        let (mut pieces, mut known, mut hint) = (Vec::new(), 0.0f64, 0);
        let changed = corners(&from.part).zip(radii).zip(&from.changed).filter(|(_, changed)| **changed);
        for ((t, radius), _) in changed {
            let starts = t.iter().filter_map(|v| from.vertices.get(*v as usize)).map(|v| start[*v as usize]);
            hint = starts.into_iter().find(|start| *start != NO_TRIANGLE).unwrap_or(hint);
            let triangle = t.map(|v| from.part.positions[v as usize].map(f64::from));
            let center = Piece::new(triangle).center();
            let far =
                |t: u32| sheet.place(center, t).1.iter().map(|x| x * x).sum::<f64>().sqrt() + sheet.radius(t);
            hint = sheet.locate(center, hint);
            let mut distance = far(hint);
            if distance + radius > known {
                let other = sheet.nearest(center, hint);
                if far(other) < distance {
                    (hint, distance) = (other, far(other));
                }
                known = known.max(distance + radius);
            }
            pieces.push((triangle, *radius, hint));
        }
        Self { pieces, sheet, known }
    }

    /// The largest bound.
    fn bound(&mut self, goal: BoundOptions) -> f64 {
        let mut bounds = Bounds::new(goal);
        let mut overlay = Overlay::new(&self.sheet);
        for (triangle, radius, hint) in &self.pieces {
            overlay.hint = *hint;
            overlay.lay(&mut bounds, &Piece::new(*triangle), *radius, |_, _| 0);
        }
        bounds.upper
    }
}

/// Some triangles of a mesh with the vertices that they use, and which these are.
fn part(mesh: &LocalMesh, mut indices: Vec<u32>) -> (LocalMesh, Vec<u32>) {
    let stride = mesh.attributes.len() / mesh.ids.len().max(1);
    let mut number = vec![u32::MAX; mesh.ids.len()];
    let mut out = LocalMesh::default();
    let mut vertices = Vec::new();
    for v in &mut indices {
        let at = *v as usize;
        if number[at] == u32::MAX {
            number[at] = out.ids.len() as u32;
            out.ids.push(mesh.ids[at]);
            vertices.push(*v);
            out.positions.push(mesh.positions[at]);
            out.attributes.extend_from_slice(&mesh.attributes[at * stride..][..stride]);
            out.labels.extend(mesh.labels.get(at));
            out.materials.extend(mesh.materials.get(at));
        }
        *v = number[at];
    }
    out.indices = indices;
    (out, vertices)
}
