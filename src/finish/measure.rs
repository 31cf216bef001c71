//! What collapsing changed, and how far that is from what it was.

use rustc_hash::FxHashMap;

use super::gather::Region;
use crate::build::attribute_error::deviation_above;
use crate::build::content::Content;
use crate::build::store::LocalMesh;
use crate::math::sphere::round_up;
use crate::measure::closest::Triangle;
use crate::measure::overlay::{Bounds, Overlay, Sheet};
use crate::measure::piece::Piece;
use crate::measure::{BoundOptions, outwards};
use crate::mesh::hash;
use crate::model::{ClusterAddress, Dag, Group};

/// A bound may be this part above the largest distance found.
const SLACK: f64 = 0.1;

/// A region after its edges were collapsed, triangle by triangle.
#[derive(Debug)]
pub struct Changes {
    /// The region as it is now, its vertices numbered as before.
    pub after: LocalMesh,
    /// Whether a vertex that is used is another one now.
    pub moved: Vec<bool>,
    /// For each triangle the one that it was, if it is the same.
    pub was: Vec<Option<u32>>,
    /// For each triangle of the region whether it is there no more.
    gone: Vec<bool>,
    /// What went may have nothing in its place: all is compared with all.
    pub pruned: bool,
}

fn corners(mesh: &LocalMesh) -> impl Iterator<Item = [u32; 3]> {
    mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]])
}

impl Changes {
    /// Compares a region with what became of it.
    pub fn new(region: &Region, after: LocalMesh, pruned: bool) -> Self {
        let before = &region.mesh;
        let stride = before.attributes.len() / before.ids.len().max(1);
        let mut moved = vec![true; after.ids.len()];
        for v in 0..before.ids.len() {
            let row = v * stride..(v + 1) * stride;
            moved[v] = before.positions[v] != after.positions[v]
                || before.attributes[row.clone()] != after.attributes[row]
                || before.labels.get(v) != after.labels.get(v);
        }
        let known: FxHashMap<[u32; 3], u32> = corners(before).zip(0..).collect();
        let mut gone = vec![true; region.faces()];
        let was = corners(&after)
            .map(|t| {
                let same = known.get(&t).copied().filter(|_| t.iter().all(|v| !moved[*v as usize]));
                same.into_iter().for_each(|t| gone[t as usize] = false);
                same
            })
            .collect();
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

    /// The triangles that went, and those that came.
    fn sides(&self, region: &Region) -> [LocalMesh; 2] {
        let went = corners(&region.mesh).zip(&self.gone).filter(|(_, gone)| **gone || self.pruned);
        let came = corners(&self.after).zip(&self.was).filter(|(_, was)| was.is_none() || self.pruned);
        [
            part(&region.mesh, went.flat_map(|(t, _)| t).collect()),
            part(&self.after, came.flat_map(|(t, _)| t).collect()),
        ]
    }

    /// A bound of the distance to the source: that of the clusters, and of the way from there. Where nothing is above
    /// `enough`, that.
    pub fn bound(&self, dag: &Dag, region: &Region, enough: f32) -> f32 {
        let [went, came] = self.sides(region);
        let bound_of = |at: &ClusterAddress| {
            let origin = dag.groups.get(dag.record(*at).refined as usize);
            f64::from(origin.map_or(0.0, Group::distance))
        };
        let of_cluster: Vec<f64> = region.clusters.iter().map(bound_of).collect();
        let owners = region.owners.iter().zip(&self.gone).filter(|(_, gone)| **gone || self.pruned);
        let radii: Vec<f64> = owners.map(|(owner, _)| of_cluster[*owner as usize]).collect();
        let goal = BoundOptions { floor: enough.into(), slack: SLACK, ..BoundOptions::default() };
        let (before, after) = (sheet(&went, radii), sheet(&came, Vec::new()));
        let mut bounds = Bounds::new(goal);
        // What stayed is where it was. Where all is here, these are the numbers of what did not.
        let changed = |flags: &mut dyn Iterator<Item = bool>| -> Vec<u32> {
            let all = flags.filter(|changed| *changed || self.pruned).zip(0..);
            all.filter(|(changed, _)| *changed).map(|(_, number)| number).collect()
        };
        if !before.triangles().is_empty() && !after.triangles().is_empty() {
            let mut overlay = Overlay::new(&after);
            for t in changed(&mut self.gone.iter().copied()) {
                let piece = Piece::new(before.triangles()[t as usize]);
                overlay.lay(&mut bounds, &piece, before.radius(t), |_, _| 0);
            }
            let mut overlay = Overlay::new(&before);
            for t in changed(&mut self.was.iter().map(Option::is_none)) {
                overlay.lay(&mut bounds, &Piece::new(after.triangles()[t as usize]), 0.0, |_, _| 0);
            }
        }
        let all = before.triangles().iter().chain(after.triangles()).flatten().flatten();
        let largest = all.fold(0.0f64, |most, x| most.max(x.abs()));
        round_up(outwards(bounds.upper, largest)).max(enough)
    }

    /// A bound of how far attributes deviate from what they were; deviations up to `enough` are not told apart.
    pub fn deviation(&self, region: &Region, content: &Content, free: f32, enough: f32) -> f32 {
        let [went, came] = self.sides(region);
        if went.indices.is_empty() || came.indices.is_empty() {
            return 0.0;
        }
        deviation_above(&went, &came, content, free, enough)
    }
}

/// Some triangles of a mesh with the vertices that they use.
fn part(mesh: &LocalMesh, mut indices: Vec<u32>) -> LocalMesh {
    let stride = mesh.attributes.len() / mesh.ids.len().max(1);
    let mut number = vec![u32::MAX; mesh.ids.len()];
    let mut out = LocalMesh::default();
    for v in &mut indices {
        let at = *v as usize;
        if number[at] == u32::MAX {
            number[at] = out.ids.len() as u32;
            out.ids.push(mesh.ids[at]);
            out.positions.push(mesh.positions[at]);
            out.attributes.extend_from_slice(&mesh.attributes[at * stride..][..stride]);
            out.labels.extend(mesh.labels.get(at));
            out.materials.extend(mesh.materials.get(at));
        }
        *v = number[at];
    }
    out.indices = indices;
    out
}

/// Triangles, each of which stands for something within its radius.
fn sheet(mesh: &LocalMesh, radii: Vec<f64>) -> Sheet {
    let points = hash::first_equal(bytemuck::cast_slice(&mesh.positions), 3);
    let faces: Vec<[u32; 3]> = corners(mesh).collect();
    let place = |v: u32| mesh.positions[v as usize].map(f64::from);
    let triangles: Vec<Triangle> = faces.iter().map(|t| t.map(place)).collect();
    let numbers: Vec<[u32; 3]> = faces.iter().map(|t| t.map(|v| points[v as usize])).collect();
    let radii = if radii.is_empty() { vec![0.0; faces.len()] } else { radii };
    Sheet::new(triangles, &numbers, radii)
}
