//! New texture coordinates for levels that were welded over seams, in images that somebody bakes for them from the source.
//!
//! An image is right up to its texels. So their size is part of the error of a level that has one.

use rustc_hash::FxHashMap;

use super::clusterize::ClusterMesh;
use super::dag::{Graph, Growing, parent_error, work};
use super::welding::{Welding, columns};
use super::{Meter, Progress, assemble, memory};
use crate::config::{BuildOptions, Levels};
use crate::error::{Error, Result};
use crate::math::sphere::round_up;
use crate::mesh::{SourceMesh, hash, weld};
use crate::model::{BuildReport, Dag, MemorySink, RebakedPart};
use crate::threads;

pub use super::welding::Rebaking;

/// A mesh whose levels are grown, and wait for what is baked for those that were welded.
pub struct Unbaked {
    graph: Graph,
    report: BuildReport,
    parts: Vec<Part>,
    /// Whether faces of the source have materials.
    has_materials: bool,
}

/// The welded clusters of a level that can share an image, as one mesh.
struct Part {
    level: u8,
    material: i32,
    clusters: Vec<u32>,
    /// An identity for each vertex.
    ids: Vec<u32>,
    faces: Vec<[u32; 3]>,
}

/// The same for whoever bakes.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Number of simplifications behind it.
    pub level: u8,
    /// The number of its class of materials.
    pub material: i32,
    /// Object space.
    pub positions: Vec<[f64; 3]>,
    /// Unit vectors.
    pub normals: Vec<[f32; 3]>,
    /// Triangles.
    pub faces: Vec<[u32; 3]>,
    /// The error of each of them, object units.
    pub errors: Vec<f64>,
}

/// What was baked for a surface.
#[derive(Clone, Debug)]
pub struct Atlas {
    /// The vertex of the surface that each vertex was.
    pub origins: Vec<u32>,
    /// Its texture coordinates.
    pub uvs: Vec<[f32; 2]>,
    /// The triangles of the surface, in their order, over these vertices.
    pub faces: Vec<[u32; 3]>,
    /// The number of the material that shows the image.
    pub material: i32,
    /// The size of its texels on the surface, object units.
    pub texel: f64,
}

/// Grows all levels of a mesh; see [`super::build`].
pub fn grow(
    source: &SourceMesh<'_>,
    options: &BuildOptions,
    rebaking: Rebaking,
    progress: &dyn Progress,
) -> Result<Unbaked> {
    options.validate()?;
    threads::install(options.threads, || {
        let mut report = BuildReport::default();
        let mut mesh = weld(source, options.crease_angle, &mut report)?;
        // Welded clusters have other materials, even where the source has none.
        mesh.layout.materials = true;
        let meter = Meter::new(progress, work(mesh.faces.len()));
        let mut growing = Growing::new(mesh, options, &meter, &mut report)?;
        let Growing { store, growth, .. } = &mut growing;
        if store.layout.uv_sets > 0 && options.levels == Levels::All {
            growth.welding = Some(Welding::new(rebaking.clone(), store.layout, &growth.content, options));
        }
        while growth.grow_level(store, options, &meter, &mut report)? {}
        let graph = growing.finish(&mut report);
        let parts = parts(&graph, &rebaking);
        Ok(Unbaked { graph, report, parts, has_materials: source.materials.is_some() })
    })?
}

fn parts(graph: &Graph, rebaking: &Rebaking) -> Vec<Part> {
    let mut of: FxHashMap<(u8, i32), Vec<u32>> = FxHashMap::default();
    for (number, cluster) in (0..).zip(&graph.clusters) {
        let material = cluster.mesh.material.cast_signed();
        if rebaking.numbers.contains(&material) {
            of.entry((cluster.level, material)).or_default().push(number);
        }
    }
    let mut parts: Vec<_> = of.into_iter().collect();
    parts.sort_unstable_by_key(|(key, _)| *key);
    parts
        .into_iter()
        .map(|((level, material), clusters)| {
            let store = &graph.store;
            let meshes = || clusters.iter().map(|c| &graph.clusters[*c as usize].mesh);
            let vertices: Vec<u32> = meshes().flat_map(|mesh| mesh.vertices.iter().copied()).collect();
            let places: Vec<[f32; 3]> = vertices.iter().map(|v| store.positions[*v as usize]).collect();
            let rows: Vec<f32> = vertices.iter().flat_map(|v| store.row(*v).to_vec()).collect();
            let labels: Vec<u32> =
                vertices.iter().filter_map(|v| store.labels.get(*v as usize).copied()).collect();
            let tables = [
                (bytemuck::cast_slice(&places), 3),
                (bytemuck::cast_slice(&rows), store.stride),
                (&labels[..], usize::from(!labels.is_empty())),
            ];
            let tables: Vec<(&[u32], usize)> = tables.into_iter().filter(|(_, width)| *width > 0).collect();
            let first = hash::first_equal_of(&tables);
            let mut number = vec![0; first.len()];
            let mut ids = Vec::new();
            for (v, first) in first.iter().map(|f| *f as usize).enumerate() {
                if first == v {
                    number[v] = ids.len() as u32;
                    ids.push(vertices[v]);
                } else {
                    number[v] = number[first];
                }
            }
            let mut start = 0;
            let mut faces = Vec::new();
            for mesh in meshes() {
                faces.extend(mesh.triangles.iter().map(|t| t.map(|v| number[start + usize::from(v)])));
                start += mesh.vertices.len();
            }
            Part { level, material, clusters, ids, faces }
        })
        .collect()
}

impl Unbaked {
    /// What has to be baked, finest first.
    pub fn surfaces(&self) -> Vec<Surface> {
        let Graph { frame, store, clusters, .. } = &self.graph;
        let surface = |part: &Part| {
            let own = part.clusters.iter().map(|c| &clusters[*c as usize]);
            let errors = own.flat_map(|c| vec![f64::from(c.error) * frame.scale; c.mesh.triangles.len()]);
            let normal = |v: &u32| [0, 1, 2].map(|k| store.row(*v)[k]);
            Surface {
                level: part.level,
                material: part.material,
                positions: part.ids.iter().map(|v| frame.to_object(store.positions[*v as usize])).collect(),
                normals: part.ids.iter().map(normal).collect(),
                faces: part.faces.clone(),
                errors: errors.collect(),
            }
        };
        self.parts.iter().map(surface).collect()
    }

    /// The mesh, with what was baked for each of the surfaces.
    pub fn finish(self, atlases: &[Atlas]) -> Result<Dag> {
        let Self { mut graph, mut report, parts, has_materials } = self;
        if atlases.len() != parts.len() {
            let message = format!("expected {} of them, found {}", parts.len(), atlases.len());
            return Err(Error::argument("atlases", message));
        }
        for (part, atlas) in parts.iter().zip(atlases) {
            atlas.check(part)?;
            atlas.apply(part, &mut graph)?;
            report.rebaked.push(RebakedPart {
                level: part.level,
                material: atlas.material,
                triangles: part.faces.len() as u64,
                texel: atlas.texel,
            });
        }
        let texels = parts.iter().zip(atlases).flat_map(|(part, atlas)| {
            part.clusters.iter().map(|c| (*c, round_up(atlas.texel / graph.frame.scale)))
        });
        let texels: FxHashMap<u32, f32> = texels.collect();
        raise(&mut graph, &texels, &mut report);
        graph.store.layout.materials = has_materials || !parts.is_empty();
        memory::trim_heap(graph.source_faces);
        assemble::assemble(graph, report, MemorySink::default())
    }
}

impl Atlas {
    fn check(&self, part: &Part) -> Result<()> {
        let wrong = |message: String| Err(Error::argument("atlases", message));
        if self.origins.len() != self.uvs.len() {
            return wrong(format!("{} vertices and {} coordinates", self.origins.len(), self.uvs.len()));
        }
        if self.faces.len() != part.faces.len() {
            return wrong(format!("{} faces of a surface of {}", self.faces.len(), part.faces.len()));
        }
        let is_finite = self.uvs.iter().flatten().all(|x| x.is_finite()) && self.texel.is_finite();
        if !is_finite || self.texel < 0.0 {
            return wrong("coordinates or texels that are not finite".into());
        }
        for (face, was) in self.faces.iter().zip(&part.faces) {
            for (v, was) in face.iter().zip(was) {
                if self.origins.get(*v as usize) != Some(was) {
                    return wrong(format!("vertex {v} is not vertex {was} of the surface"));
                }
            }
        }
        Ok(())
    }

    /// Gives the clusters of a part new vertices, with the coordinates.
    fn apply(&self, part: &Part, graph: &mut Graph) -> Result<()> {
        let store = &mut graph.store;
        let first = u32::try_from(store.count())
            .ok()
            .filter(|n| n.checked_add(self.origins.len() as u32).is_some())
            .ok_or_else(|| Error::TooLarge("more than 2^32 vertices over all levels".into()))?;
        let columns = columns(store.layout);
        for (origin, uv) in self.origins.iter().zip(&self.uvs) {
            let was = part.ids[*origin as usize];
            let mut row = store.row(was).to_vec();
            row[columns.start..columns.start + 2].copy_from_slice(uv);
            store.positions.push(store.positions[was as usize]);
            store.attributes.extend(row);
            if let Some(label) = store.labels.get(was as usize).copied() {
                store.labels.push(label);
            }
        }
        let mut faces = self.faces.as_slice();
        for c in &part.clusters {
            let mesh = &mut graph.clusters[*c as usize].mesh;
            let (own, rest) = faces.split_at(mesh.triangles.len());
            faces = rest;
            let mut vertices: Vec<u32> = Vec::new();
            let triangles = own.iter().map(|face| {
                face.map(|v| {
                    let v = first + v;
                    let at = vertices.iter().position(|known| *known == v);
                    at.unwrap_or_else(|| {
                        vertices.push(v);
                        vertices.len() - 1
                    }) as u8
                })
            });
            let triangles = triangles.collect();
            *mesh = ClusterMesh { vertices, triangles, material: self.material.cast_unsigned() };
        }
        Ok(())
    }
}

/// Lets the errors of clusters with these texels include them, and those of all that was made from such clusters be above.
fn raise(graph: &mut Graph, texels: &FxHashMap<u32, f32>, report: &mut BuildReport) {
    let mut made: Vec<Vec<u32>> = vec![Vec::new(); graph.groups.len()];
    for (number, cluster) in (0..).zip(&graph.clusters) {
        if let Some(made) = made.get_mut(cluster.refined as usize) {
            made.push(number);
        }
    }
    // Groups are in the order in which they were made.
    for (group, made) in graph.groups.iter_mut().zip(made) {
        let Some(texel) = made.iter().filter_map(|c| texels.get(c)).copied().reduce(f32::max) else {
            continue;
        };
        let below = group.members.iter().map(|c| graph.clusters[*c as usize].error).fold(0.0, f32::max);
        group.attribute_error = group.attribute_error.max(texel);
        group.error = parent_error(below, group.error.max(group.attribute_error));
        if let Some(level) = report.levels.get_mut(group.level as usize) {
            let stated = f64::from(group.attribute_error) * graph.frame.scale;
            level.max_attribute_error = level.max_attribute_error.max(stated);
        }
        for c in made {
            let cluster = &mut graph.clusters[c as usize];
            (cluster.error, cluster.attribute_error) = (group.error, group.attribute_error);
        }
    }
}
