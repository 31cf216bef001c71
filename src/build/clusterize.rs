//! Splitting triangles into clusters.
//!
//! Large inputs are first cut into blocks by a k-d tree over triangle centroids: blocks fit in cache, and both
//! cores work from the start. The blocks depend on the input alone, never on the number of threads. Within a
//! block the halving goes on down to clusters, or meshoptimizer grows them, or METIS cuts the graph of triangles,
//! see [`Clusterizer`].

use meshopt::{VertexDataAdapter, build_meshlets_flex};
use rayon::prelude::*;

#[cfg(feature = "metis")]
use super::graph::{self, Graph};
use super::store::{LocalMesh, VertexStore};
use crate::config::{BuildOptions, Clusterizer};
use crate::math::median::{Place, median_split};
#[cfg(feature = "metis")]
use crate::mesh::hash;

/// Triangles of a block. Cluster borders are somewhat longer along block borders: at this size that costs
/// below half a per cent of the clusters.
const BLOCK_TRIANGLES: usize = 1 << 15;
/// A cluster grown along the surface may be closed early once it has this part of the triangles allowed.
const MIN_FILL: f32 = 1.0 / 3.0;
/// One that grew this much beyond its expected radius is closed early.
const SPLIT_FACTOR: f32 = 2.0;

/// Part of the triangles allowed that METIS aims at: it balances, and what exceeds the limit is halved.
#[cfg(feature = "metis")]
const GRAPH_FILL: f32 = 0.985;

/// The triangles of one cluster over vertex identities.
#[derive(Clone, Debug, PartialEq)]
pub struct ClusterMesh {
    /// Identities.
    pub vertices: Vec<u32>,
    /// Corners as indices into `vertices`.
    pub triangles: Vec<[u8; 3]>,
    /// Material of all triangles; zero when there are none.
    pub material: u32,
}

/// Clusters of a whole mesh; `materials` holds one for each vertex, or none at all.
pub fn clusterize(
    store: &VertexStore,
    faces: &[[u32; 3]],
    materials: &[u32],
    options: &BuildOptions,
) -> Vec<ClusterMesh> {
    let corners = |f: [u32; 3]| f.map(|v| store.positions[v as usize]);
    let place = |f: usize| Place { point: tripled_centroid(corners(faces[f])), number: f as u32 };
    let mut places: Vec<Place> = (0..faces.len()).into_par_iter().map(place).collect();
    let material = |f: &Place| materials.get(faces[f.number as usize][0] as usize).copied().unwrap_or(0);
    if !materials.is_empty() {
        places.par_sort_by_key(material);
    }
    let of_one: Vec<&mut [Place]> = places.chunk_by_mut(|a, b| material(a) == material(b)).collect();
    of_one
        .into_par_iter()
        .flat_map(|places| split_blocks(places, BLOCK_TRIANGLES))
        .map(|block| {
            // The order inside a block is the caller's, which keeps what locality it has.
            block.sort_unstable_by_key(|f| f.number);
            let local = LocalMesh::of_faces(store, block.iter().map(|f| faces[f.number as usize]));
            of_material(&local, material(&block[0]), options)
        })
        .flatten_iter()
        .collect()
}

/// Clusters of a group's own mesh, each of one material.
pub fn clusterize_local(mesh: &LocalMesh, options: &BuildOptions) -> Vec<ClusterMesh> {
    if mesh.materials.is_empty() {
        return of_material(mesh, 0, options);
    }
    let clusters = |(material, part): (u32, LocalMesh)| of_material(&part, material, options);
    mesh.materials_apart().flat_map(clusters).collect()
}

fn of_material(mesh: &LocalMesh, material: u32, options: &BuildOptions) -> Vec<ClusterMesh> {
    let mut clusters = match options.clusterizer {
        Clusterizer::Median => Halving::new(mesh, options).clusters(),
        Clusterizer::Flex => grow(mesh, options),
        #[cfg(feature = "metis")]
        Clusterizer::Metis => Halving::new(mesh, options).of_graph(),
    };
    clusters.iter_mut().for_each(|cluster| cluster.material = material);
    clusters
}

/// meshoptimizer's flexible builder.
fn grow(mesh: &LocalMesh, options: &BuildOptions) -> Vec<ClusterMesh> {
    let bytes: &[u8] = bytemuck::cast_slice(&mesh.positions);
    // The adapter fails on a misfit of bytes and stride only, which a slice of [f32; 3] cannot have.
    let Ok(adapter) = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0) else { return Vec::new() };
    let (vertices, most) = (options.cluster_vertices, options.cluster_triangles);
    let least = ((most as f32 * MIN_FILL) as usize).max(1);
    build_meshlets_flex(&mesh.indices, &adapter, vertices, least, most, 0.0, SPLIT_FACTOR)
        .iter()
        .map(|m| ClusterMesh {
            vertices: m.vertices.iter().map(|v| mesh.ids[*v as usize]).collect(),
            triangles: m.triangles.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
            material: 0,
        })
        .collect()
}

/// Halves triangles at medians until they fit a cluster. Every cut leaves whole clusters on one side, so that all
/// but the last are full.
struct Halving<'a> {
    mesh: &'a LocalMesh,
    options: &'a BuildOptions,
    /// Triangles that probably fit a cluster.
    capacity: usize,
    places: Vec<Place>,
    /// The cluster being made: for each vertex of the mesh its number in it.
    slots: Vec<u8>,
    vertices: Vec<u32>,
    clusters: Vec<ClusterMesh>,
}

impl<'a> Halving<'a> {
    const FREE: u8 = u8::MAX;

    fn new(mesh: &'a LocalMesh, options: &'a BuildOptions) -> Self {
        let corners = |t: &[u32]| [0, 1, 2].map(|k| mesh.positions[t[k] as usize]);
        let triangles = mesh.indices.chunks_exact(3).zip(0..);
        let place = |(t, number)| Place { point: tripled_centroid(corners(t)), number };
        let places: Vec<Place> = triangles.map(place).collect();
        let vertices = mesh.positions.len();
        // Where triangles share few vertices, those run out first.
        let fit = options.cluster_vertices * places.len() / vertices.max(1);
        let capacity = fit.clamp(1, options.cluster_triangles);
        let slots = vec![Self::FREE; vertices];
        Self { mesh, options, capacity, places, slots, vertices: Vec::new(), clusters: Vec::new() }
    }

    fn clusters(mut self) -> Vec<ClusterMesh> {
        let mut places = std::mem::take(&mut self.places);
        self.split(&mut places);
        self.clusters
    }

    /// Clusters that METIS makes, halved where they are too large.
    #[cfg(feature = "metis")]
    fn of_graph(mut self) -> Vec<ClusterMesh> {
        let count = (self.places.len() as f32 / (self.capacity as f32 * GRAPH_FILL)).ceil() as usize;
        let positions = hash::first_equal(bytemuck::cast_slice(&self.mesh.positions), 3);
        let mut uses = Vec::with_capacity(self.mesh.indices.len());
        for (t, corners) in (0..).zip(self.mesh.indices.chunks_exact(3)) {
            let [a, b, c] = [0, 1, 2].map(|k| u64::from(positions[corners[k] as usize]));
            uses.extend([(a, b), (b, c), (c, a)].map(|(a, b)| (a.min(b) << 32 | a.max(b), t)));
        }
        let points: Vec<[f32; 3]> = self.places.iter().map(|p| p.point).collect();
        let graph = Graph::new(&points, &graph::pairs(&mut uses));
        for part in graph.parts(count.max(1)) {
            let mut part: Vec<Place> = part.into_iter().map(|t| self.places[t as usize]).collect();
            self.split(&mut part);
        }
        self.clusters
    }

    fn split(&mut self, places: &mut [Place]) {
        if places.len() <= self.capacity {
            // The order inside a cluster is that of the mesh.
            places.sort_unstable_by_key(|t| t.number);
            if self.close(places) {
                return;
            }
        }
        let clusters = places.len().div_ceil(self.capacity).max(2);
        let middle = clusters / 2 * places.len() / clusters;
        let (a, b) = median_split(places, middle);
        self.split(a);
        self.split(b);
    }

    /// Makes a cluster of triangles, unless they have too many vertices.
    fn close(&mut self, places: &[Place]) -> bool {
        let vertices = &mut self.vertices;
        vertices.clear();
        let mut triangles = Vec::with_capacity(places.len());
        for t in places {
            let mut triangle = [0; 3];
            for (k, corner) in triangle.iter_mut().enumerate() {
                let v = self.mesh.indices[3 * t.number as usize + k];
                let slot = &mut self.slots[v as usize];
                if *slot == Self::FREE {
                    // Past the last number a vertex stays free and is counted again: too many either way.
                    *slot = vertices.len().min(usize::from(Self::FREE)) as u8;
                    vertices.push(v);
                }
                *corner = *slot;
            }
            triangles.push(triangle);
        }
        vertices.iter().for_each(|v| self.slots[*v as usize] = Self::FREE);
        let fits = vertices.len() <= self.options.cluster_vertices;
        if fits {
            let vertices = vertices.iter().map(|v| self.mesh.ids[*v as usize]).collect();
            self.clusters.push(ClusterMesh { vertices, triangles, material: 0 });
        }
        fits
    }
}

/// Three times the centroid: as good an order.
fn tripled_centroid(p: [[f32; 3]; 3]) -> [f32; 3] {
    std::array::from_fn(|k| p[0][k] + p[1][k] + p[2][k])
}

/// Halves places by the median along the longest axis until blocks have at most `size`.
pub fn split_blocks(places: &mut [Place], size: usize) -> Vec<&mut [Place]> {
    if places.len() <= size {
        return vec![places];
    }
    let middle = places.len() / 2;
    let (a, b) = median_split(places, middle);
    let (mut blocks, mut right) = rayon::join(|| split_blocks(a, size), || split_blocks(b, size));
    blocks.append(&mut right);
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of triangles, each with three vertices of its own or sharing two with the one before.
    fn strip(triangles: u32, shared: bool) -> LocalMesh {
        let vertices = if shared { triangles + 2 } else { 3 * triangles };
        let place = |v: u32| if shared { v } else { v / 3 + v % 3 };
        let point = |v: u32| [(place(v) / 2) as f32, (place(v) % 2) as f32, 0.0];
        LocalMesh {
            ids: (0..vertices).map(|v| v + 100).collect(),
            positions: (0..vertices).map(point).collect(),
            indices: (0..triangles)
                .flat_map(|t| [0, 1, 2].map(|k| if shared { t + k } else { 3 * t + k }))
                .collect(),
            ..LocalMesh::default()
        }
    }

    #[test]
    fn halving_fills_clusters_within_both_limits() {
        let options = BuildOptions::default();
        for (triangles, shared, expected) in
            [(1, true, 1), (128, true, 1), (129, true, 2), (1280, true, 10), (1300, false, 16)]
        {
            let clusters = clusters_of(&strip(triangles, shared), &options);
            assert_eq!(clusters.len(), expected, "{triangles} {shared}");
        }
    }

    /// Clusters within the limits that hold every triangle once.
    fn clusters_of(mesh: &LocalMesh, options: &BuildOptions) -> Vec<ClusterMesh> {
        let clusters = clusterize_local(mesh, options);
        let mut seen = Vec::new();
        for c in &clusters {
            assert!(c.triangles.len() <= options.cluster_triangles);
            assert!(c.vertices.len() <= options.cluster_vertices);
            seen.extend(c.triangles.iter().map(|t| t.map(|v| c.vertices[usize::from(v)])));
        }
        seen.sort_unstable();
        let corners = mesh.indices.chunks(3).map(|t| [0, 1, 2].map(|k| mesh.ids[t[k] as usize]));
        let mut all: Vec<[u32; 3]> = corners.collect();
        all.sort_unstable();
        assert_eq!(seen, all);
        clusters
    }

    #[cfg(feature = "metis")]
    #[test]
    fn parts_of_the_graph_stay_within_both_limits() {
        for (most, vertices) in [(128, 255), (100, 255), (128, 64), (17, 32)] {
            let options = BuildOptions {
                cluster_triangles: most,
                cluster_vertices: vertices,
                clusterizer: Clusterizer::Metis,
                ..BuildOptions::default()
            };
            for (triangles, shared) in [(1, true), (128, true), (129, true), (5000, true), (1300, false)] {
                let mesh = strip(triangles, shared);
                let clusters = clusters_of(&mesh, &options);
                let least = (triangles as usize).div_ceil(most);
                assert!(clusters.len() >= least);
                if shared && vertices == 255 {
                    assert!(clusters.len() <= least + least / 10 + 1, "{}", clusters.len());
                }
            }
        }
    }

    /// Islands of 4 triangles on a plane: clusters take whole ones that lie together.
    #[cfg(feature = "metis")]
    #[test]
    fn clusters_of_islands_are_compact() {
        let options = BuildOptions { clusterizer: Clusterizer::Metis, ..BuildOptions::default() };
        let mut mesh = LocalMesh::default();
        for island in 0..1024u32 {
            let leaf = strip(4, true);
            let first = mesh.ids.len() as u32;
            // In no order along the plane.
            let place = island.wrapping_mul(389) % 1024;
            let [x, y] = [place % 32, place / 32].map(|x| 4.0 * x as f32);
            mesh.ids.extend(leaf.ids.iter().map(|v| v + first));
            mesh.positions.extend(leaf.positions.iter().map(|p| [x + p[0], y + p[1], 0.0]));
            mesh.indices.extend(leaf.indices.iter().map(|v| v + first));
        }
        let clusters = clusters_of(&mesh, &options);
        assert!(clusters.len() <= 36, "{}", clusters.len());
        let vertices: usize = clusters.iter().map(|c| c.vertices.len()).sum();
        // Few islands are in two clusters.
        assert!(vertices < mesh.ids.len() * 103 / 100, "{vertices}");
        let sides = clusters.iter().map(|c| {
            let points = c.vertices.iter().map(|v| &mesh.positions[*v as usize - 100]);
            let bounds = crate::math::Aabb::of_points(points);
            (bounds.max[0] - bounds.min[0]).max(bounds.max[1] - bounds.min[1])
        });
        // 32 islands in a square are 24 on a side; all are 128.
        let mean = sides.sum::<f32>() / clusters.len() as f32;
        assert!(mean < 48.0, "{mean}");
    }

    #[test]
    fn too_many_vertices_are_halved_again() {
        // Half the triangles share all their vertices, the others none: the mean says that 128 fit.
        let mut mesh = strip(2000, true);
        let own = strip(300, false);
        let first = mesh.ids.len() as u32;
        mesh.ids.extend(own.ids.iter().map(|v| v + first));
        mesh.positions.extend(own.positions.iter().map(|p| [p[0], p[1], 5000.0]));
        mesh.indices.extend(own.indices.iter().map(|v| v + first));
        let clusters = clusterize_local(&mesh, &BuildOptions::default());
        assert_eq!(clusters.iter().map(|c| c.triangles.len()).sum::<usize>(), 2300);
        assert!(clusters.iter().all(|c| c.vertices.len() <= 255));
    }
}
