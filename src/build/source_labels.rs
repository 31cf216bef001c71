//! The labels of the source at a point. Labels taken from the level before would let lines between labels drift by
//! up to half a triangle at each level.

use glam::DVec3;

use super::collapse::wedges::nearest;
use super::dag::BuildCluster;
use super::store::VertexStore;
use crate::measure::TriangleTree;

/// The surface of the source with its labels.
#[derive(Debug)]
pub struct SourceLabels {
    tree: TriangleTree,
    /// Labels at the corners of each triangle.
    labels: Vec<[u32; 3]>,
    /// Material of each triangle.
    materials: Vec<u32>,
}

impl SourceLabels {
    /// The surface of the clusters of the source.
    pub fn new(store: &VertexStore, clusters: &[BuildCluster]) -> Self {
        let corners = |cluster: &BuildCluster| -> Vec<[u32; 3]> {
            let vertex = |v: u8| cluster.mesh.vertices[usize::from(v)];
            cluster.mesh.triangles.iter().map(|t| t.map(vertex)).collect()
        };
        let faces: Vec<[u32; 3]> = clusters.iter().flat_map(corners).collect();
        let points = faces.iter().map(|f| f.map(|v| store.positions[v as usize])).collect();
        let of =
            |cluster: &BuildCluster| std::iter::repeat_n(cluster.mesh.material, cluster.mesh.triangles.len());
        Self {
            tree: TriangleTree::of(points),
            labels: faces.iter().map(|f| f.map(|v| store.labels[v as usize])).collect(),
            materials: clusters.iter().flat_map(of).collect(),
        }
    }

    /// The label nearest to `p`, on triangles of a material that do not face away from `normal`: the other side of
    /// a thin wall may be nearer. `None` where there is no such triangle. `near` is a triangle to start from, and
    /// becomes the nearest one.
    pub fn label(&self, p: [f32; 3], normal: &[f32], material: Option<u32>, near: &mut u32) -> Option<u32> {
        let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
        let normal = vector([normal[0], normal[1], normal[2]]);
        let fits = |t: u32, corners: &[[f32; 3]; 3]| {
            let [a, b, c] = corners.map(vector);
            material.is_none_or(|material| self.materials[t as usize] == material)
                && (b - a).cross(c - a).dot(normal) >= 0.0
        };
        *near = self.tree.nearest_where(p, *near, fits)?;
        let (corners, labels) = (self.tree.triangle(*near).map(vector), self.labels[*near as usize]);
        let at = nearest(vector(p), corners).map(|x| x as f32);
        Some(label_at(labels, at))
    }
}

/// The label at barycentric coordinates: that of the nearest corner, equal ones added.
pub fn label_at(labels: [u32; 3], at: [f32; 3]) -> u32 {
    let share = |k: usize| (0..3).filter(|j| labels[*j] == labels[k]).map(|j| at[j]).sum::<f32>();
    labels[(1..3).fold(0, |best, k| if share(k) > share(best) { k } else { best })]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::clusterize::ClusterMesh;

    /// Two walls, a tenth apart, that face away from each other, each of four quads in a row with a label of its own.
    fn walls() -> SourceLabels {
        let (mut positions, mut labels, mut clusters) = (Vec::new(), Vec::new(), Vec::new());
        for side in 0..2u32 {
            for quad in 0..4u32 {
                let (x, z) = (quad as f32, 0.1 * side as f32);
                let first = positions.len() as u32;
                positions.extend([[x, 0.0, z], [x + 1.0, 0.0, z], [x + 1.0, 1.0, z], [x, 1.0, z]]);
                labels.extend([10 * side + quad; 4]);
                let triangles =
                    if side == 1 { vec![[0, 1, 2], [0, 2, 3]] } else { vec![[0, 2, 1], [0, 3, 2]] };
                let mesh = ClusterMesh { vertices: (first..first + 4).collect(), triangles, material: side };
                clusters.push(BuildCluster::of_source(mesh, &positions));
            }
        }
        let store = VertexStore { positions, labels, ..VertexStore::default() };
        SourceLabels::new(&store, &clusters)
    }

    #[test]
    fn labels_are_those_of_the_side_that_is_meant() {
        let walls = walls();
        let label = |p, normal: [f32; 3], material| walls.label(p, &normal, material, &mut 0);
        for quad in 0..4u32 {
            let p = [quad as f32 + 0.4, 0.7, 0.08];
            assert_eq!(label(p, [0.0, 0.0, 1.0], None), Some(10 + quad));
            assert_eq!(label(p, [0.0, 0.0, -1.0], None), Some(quad));
            // What has no direction may be of any; materials are kept apart.
            assert_eq!(label(p, [0.0; 3], None), Some(10 + quad));
            assert_eq!(label(p, [0.0; 3], Some(0)), Some(quad));
        }
        assert_eq!(label([0.0; 3], [0.0, 0.0, 1.0], Some(0)), None);
        assert_eq!(label([0.0; 3], [0.0; 3], Some(7)), None);
    }

    #[test]
    fn the_nearest_corner_counts_and_equal_ones_together() {
        assert_eq!(label_at([1, 2, 3], [0.2, 0.5, 0.3]), 2);
        assert_eq!(label_at([1, 2, 1], [0.3, 0.4, 0.3]), 1);
        assert_eq!(label_at([1, 2, 3], [0.4, 0.4, 0.2]), 1);
    }
}
