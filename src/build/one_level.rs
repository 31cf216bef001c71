//! Ordinary meshes: the caller's triangles as a geometry of one level, without welding and mending. Clusters follow the order
//! of the faces, so that it takes little more than reading them; every stage serves it as it serves a DAG. What does not
//! depend on where vertices are is made once: new positions are a new geometry in a fraction of that time.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::assemble::write_streams;
use super::clusterize::ClusterMesh;
use crate::error::{Error, Result};
use crate::layout::{GroupSize, Paging, hierarchy, paginate};
use crate::limits::{CLUSTER_MAX_TRIANGLES, CLUSTER_MAX_VERTICES, GROUP_MAX_CLUSTERS, ROOT_PAGE_MAX_BYTES};
use crate::math::{Aabb, Bounds, Sphere, morton, octahedral};
use crate::mesh::{Positions, SourceMesh, attributes, frame, hash, validate};
use crate::model::cluster::{NO_GROUP, NO_PAGE, RECORD_WORDS};
use crate::model::packing::{PACKING_WORDS, VertexRow, WIDEST, ordered};
use crate::model::rule::{ROOT_ERROR, SOURCE_ERROR};
use crate::model::{
    AttributeLayout, BuildReport, ClusterRecord, Dag, GeometryId, Group, Materials, Packing, PageEntry,
    PageWords, Pages, Primitive, Words,
};

/// An ordinary mesh but for where its vertices are. Identities of vertices are the caller's rows.
#[derive(Debug)]
pub struct OneLevel {
    /// One for all its shapes.
    topology: Arc<GeometryId>,
    primitive: Primitive,
    layout: AttributeLayout,
    vertices: usize,
    faces: Vec<[u32; 3]>,
    /// For each vertex the first one that lies where it lay at first: computed normals are one across seams.
    position_ids: Vec<u32>,
    /// Which vertices faces refer to.
    referenced: Vec<bool>,
    clusters: Vec<ClusterMesh>,
    /// Members of each group: numbers of clusters follow each other.
    groups: Vec<Range<usize>>,
    paging: Paging,
    /// The words of pages where no positions, normals and bounds are yet.
    pages: Vec<Vec<u32>>,
    face_ids: Words,
}

impl OneLevel {
    /// The mesh in its first shape. Channels are not carried along. Clusters follow the order of the faces, those of points and
    /// lines lie near each other in this shape.
    pub fn new(source: &SourceMesh<'_>, primitive: Primitive) -> Result<Self> {
        validate::validate(source)?;
        let layout = attributes::layout(source);
        let referenced = frame::referenced(source.faces, source.positions.len());
        let (positions, _) = frame::to_internal(source.positions, &referenced);
        let mut rows: Vec<u32> = (0..source.faces.len() as u32).collect();
        if primitive != Primitive::Triangles {
            let bounds = Aabb::of_points(&positions);
            let place = |row: &u32| morton::code(positions[source.faces[*row as usize][0] as usize], &bounds);
            rows.par_sort_by_cached_key(place);
        }
        let (clusters, face_rows) = clusters(source, rows);
        let ids = clusters.iter().map(identities).collect::<Vec<_>>();
        let streams = |c: usize| {
            let ClusterMesh { vertices, triangles, .. } = &clusters[c];
            layout.streams(vertices.len(), triangles.len(), ids[c].widths)
        };
        let words = |c: usize| RECORD_WORDS + streams(c).end;
        let groups = groups(clusters.len(), words);
        let order: Vec<u32> = (0..groups.len() as u32).collect();
        let paging = paginate(&order, |group| {
            let members = groups[group as usize].clone();
            GroupSize {
                level: 0,
                root: true,
                clusters: members.len() as u32,
                words: members.clone().map(words).sum::<usize>() as u32,
                faces: members.map(|c| clusters[c].triangles.len() as u32).sum(),
            }
        });
        debug_assert!(paging.order == order, "roots stay in their order");
        let (rows, stride) = (attributes::gather(source), attributes::stride(layout));
        let group_of = |c: usize| groups.partition_point(|members| members.end <= c) as u32;
        let page = |entry: &PageEntry| {
            let members = entry.first_cluster as usize..(entry.first_cluster + entry.clusters) as usize;
            let mut page = vec![0u32; members.len() * RECORD_WORDS];
            for (slot, c) in members.enumerate() {
                let (cluster, at) = (&clusters[c], page.len());
                let record = record(cluster, group_of(c), at as u32);
                page[slot * RECORD_WORDS..][..RECORD_WORDS].copy_from_slice(bytemuck::cast_slice(&[record]));
                page.resize(at + streams(c).end, 0);
                ids[c].write(&identity_rows(cluster), &mut page[at..]);
                let row = |v: u32| &rows[v as usize * stride..][..stride];
                write_streams(cluster, layout, streams(c), row, &mut page[at..]);
            }
            page
        };
        let pages = paging.table.par_iter().map(page).collect();
        Ok(Self {
            topology: Arc::default(),
            primitive,
            layout,
            vertices: source.positions.len(),
            faces: source.faces.to_vec(),
            position_ids: hash::first_equal(bytemuck::cast_slice(&positions), 3),
            referenced,
            clusters,
            groups,
            paging,
            pages,
            face_ids: face_rows.into(),
        })
    }

    /// Vertices.
    pub fn vertices(&self) -> usize {
        self.vertices
    }

    /// The geometry with its vertices at these positions. Normals may have any length; without, they are computed, weighted by
    /// angle.
    pub fn shape(&self, positions: Positions<'_>, normals: Option<&[[f32; 3]]>) -> Result<Dag> {
        if positions.len() != self.vertices {
            let message = format!(
                "expected a row for each of the {} vertices, found {}",
                self.vertices,
                positions.len()
            );
            return Err(Error::argument("vertices", message));
        }
        validate::validate(&SourceMesh { normals, ..SourceMesh::new(positions, &self.faces) })?;
        let (positions, frame) = frame::to_internal(positions, &self.referenced);
        let mut rows = normals.map_or_else(|| vec![[0.0; 3]; self.vertices], <[_]>::to_vec);
        let mended = if self.primitive == Primitive::Triangles {
            attributes::fill_normals(rows.as_flattened_mut(), 3, &positions, &self.position_ids, &self.faces)
        } else {
            0
        };
        let encoded: Vec<u32> = rows.par_iter().map(|row| octahedral::encode(*row)).collect();
        let pages: Vec<(PageWords, Vec<(Aabb, Sphere)>)> =
            (0..self.pages.len()).into_par_iter().map(|page| self.page(page, &positions, &encoded)).collect();
        let (boxes, spheres): (Vec<Aabb>, Vec<Sphere>) =
            pages.iter().flat_map(|(_, bounds)| bounds).copied().unzip();
        let union =
            |members: &Range<usize>| boxes[members.clone()].iter().fold(Aabb::EMPTY, |b, c| b.union(c));
        let boxes: Vec<Aabb> = self.groups.iter().map(union).collect();
        let groups: Vec<Group> = self
            .groups
            .iter()
            .zip(&boxes)
            .zip(&self.paging.first)
            .map(|((members, bounds), first)| {
                let (center, extent) = bounds.center_extent();
                Group {
                    lod_sphere: Sphere::of_spheres(&spheres[members.clone()]),
                    error: ROOT_ERROR,
                    first: *first,
                    count: members.len() as u32,
                    level: 0,
                    center,
                    extent,
                    bound: ROOT_ERROR,
                    quadric: ROOT_ERROR,
                    attribute_error: 0.0,
                    min_own_error: SOURCE_ERROR,
                    rank: ROOT_ERROR,
                    triangles: self.clusters[members.clone()].iter().map(|c| c.triangles.len() as u16).sum(),
                    made: 0,
                }
            })
            .collect();
        let triangles = self.faces.len();
        let clusters = self.clusters.len();
        let report = BuildReport {
            input_faces: triangles as u64,
            input_vertices: self.vertices as u64,
            computed_normals: normals.is_none(),
            mended_normals: if normals.is_some() { mended as u64 } else { 0 },
            clusters: clusters as u64,
            triangles: triangles as u64,
            fill: triangles as f64 / (clusters * CLUSTER_MAX_TRIANGLES) as f64,
            ..BuildReport::default()
        };
        let words = pages.into_iter().map(|(words, _)| words).collect();
        Ok(Dag {
            id: GeometryId::default(),
            topology: Some(Arc::clone(&self.topology)),
            frame,
            bounds: boxes.iter().fold(Aabb::EMPTY, |all, own| all.union(own)),
            pages: Arc::new(Pages::new(self.paging.table.clone(), self.layout, words)),
            nodes: hierarchy(&groups, &boxes),
            groups: groups.into(),
            vertex_count: self.vertices as u32,
            channels: Vec::new(),
            source_faces: triangles as u64,
            source_vertices: self.vertices as u64,
            face_ids: Some(self.face_ids.clone()),
            materials: Materials::default(),
            primitive: self.primitive,
            grid: None,
            pose: None,
            report,
        })
    }

    /// The words of a page, and the bounds of its clusters.
    fn page(
        &self,
        number: usize,
        positions: &[[f32; 3]],
        normals: &[u32],
    ) -> (PageWords, Vec<(Aabb, Sphere)>) {
        let entry = &self.paging.table[number];
        let mut words = self.pages[number].clone();
        let mut points = Vec::with_capacity(CLUSTER_MAX_VERTICES);
        let mut of_clusters = Vec::with_capacity(entry.clusters as usize);
        for slot in 0..entry.clusters as usize {
            let ClusterMesh { vertices, triangles, .. } = &self.clusters[entry.first_cluster as usize + slot];
            points.clear();
            points.extend(vertices.iter().map(|v| positions[*v as usize]));
            let bounds = Bounds::of(&points, triangles);
            let sphere = Sphere { center: bounds.center, radius: bounds.radius };
            of_clusters.push((Aabb::of_points(&points), sphere));
            let record = &mut words[slot * RECORD_WORDS..][..RECORD_WORDS];
            let record: &mut ClusterRecord = &mut bytemuck::cast_slice_mut(record)[0];
            (record.center, record.radius) = (bounds.center, bounds.radius);
            (record.extent, record.cone) = (bounds.extent, bounds.cone);
            (record.lod_sphere, record.max_edge) = (sphere, bounds.max_edge);
            let data = record.data as usize;
            let streams = &mut words[data..];
            for (out, point) in streams[PACKING_WORDS..].as_chunks_mut::<3>().0.iter_mut().zip(&points) {
                *out = point.map(|x| ordered(x.to_bits()));
            }
            let widths = bytemuck::cast_slice::<u32, Packing>(&streams[..PACKING_WORDS])[0].widths;
            let at = self.layout.streams(vertices.len(), triangles.len(), widths).normals;
            for (out, v) in streams[at..].iter_mut().zip(vertices) {
                *out = normals[*v as usize];
            }
        }
        (words.into(), of_clusters)
    }
}

/// Clusters of faces in an order, those of each material by themselves; and the row of each face of theirs.
fn clusters(source: &SourceMesh<'_>, mut rows: Vec<u32>) -> (Vec<ClusterMesh>, Vec<u32>) {
    let material = |row: u32| source.materials.map_or(0, |materials| materials[row as usize]);
    if source.materials.is_some() {
        rows.sort_by_key(|row| material(*row));
    }
    // For each vertex the last cluster that it was in, plus one, and its number there.
    let mut known = vec![(0u32, 0u8); source.positions.len()];
    let mut clusters: Vec<ClusterMesh> = Vec::new();
    let empty = |material: i32| ClusterMesh {
        vertices: Vec::new(),
        triangles: Vec::with_capacity(CLUSTER_MAX_TRIANGLES),
        material: material.cast_unsigned(),
    };
    for row in &rows {
        let (face, own) = (source.faces[*row as usize], material(*row));
        let number = clusters.len() as u32;
        let fits = clusters.last().is_some_and(|cluster| {
            let more = face.iter().filter(|v| known[**v as usize].0 != number).count();
            cluster.material == own.cast_unsigned()
                && cluster.triangles.len() < CLUSTER_MAX_TRIANGLES
                && cluster.vertices.len() + more <= CLUSTER_MAX_VERTICES
        });
        if !fits {
            clusters.push(empty(own));
        }
        let number = clusters.len() as u32;
        let Some(cluster) = clusters.last_mut() else { continue };
        let triangle = face.map(|v| {
            let entry = &mut known[v as usize];
            if entry.0 != number {
                *entry = (number, cluster.vertices.len() as u8);
                cluster.vertices.push(v);
            }
            entry.1
        });
        cluster.triangles.push(triangle);
    }
    (clusters, rows)
}

/// Groups of clusters that follow each other, each as many as a root page may hold.
fn groups(clusters: usize, words: impl Fn(usize) -> usize) -> Vec<Range<usize>> {
    let most = ROOT_PAGE_MAX_BYTES / size_of::<u32>();
    let mut groups: Vec<Range<usize>> = Vec::new();
    let mut held = 0;
    for c in 0..clusters {
        match groups.last_mut() {
            Some(last) if last.len() < GROUP_MAX_CLUSTERS && held + words(c) <= most => {
                last.end = c + 1;
                held += words(c);
            }
            _ => {
                groups.push(c..c + 1);
                held = words(c);
            }
        }
    }
    groups
}

/// How the identities of a cluster are packed: positions take whole words, so that those of any shape fit.
fn identities(cluster: &ClusterMesh) -> Packing {
    let packing = Packing::of(&identity_rows(cluster), 0.0);
    let [x, y, z, _] = WIDEST;
    Packing { widths: [x, y, z, packing.widths[3]], ..packing }
}

/// Rows of a cluster's vertices that lie nowhere yet.
fn identity_rows(cluster: &ClusterMesh) -> Vec<VertexRow> {
    cluster.vertices.iter().map(|v| [0, 0, 0, v.cast_signed()]).collect()
}

/// A record without what depends on where vertices are.
fn record(cluster: &ClusterMesh, group: u32, data: u32) -> ClusterRecord {
    ClusterRecord {
        error: SOURCE_ERROR,
        group,
        vertex_count: cluster.vertices.len() as u8,
        triangle_count: cluster.triangles.len() as u8,
        data,
        refined: NO_GROUP,
        material: cluster.material.cast_signed(),
        refined_page: NO_PAGE,
        ..bytemuck::Zeroable::zeroed()
    }
}
