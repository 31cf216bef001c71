//! From the grown graph to the final layout: groups in hierarchy order, clusters in pages, records packed and
//! rounded outwards. Order, names and hierarchy are made of small tables of all groups; the words of pages go to a sink as
//! they are made.

use std::sync::Arc;

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::clusterize::ClusterMesh;
use super::dag::{BuildCluster, BuildGroup, Graph};
use super::order;
use super::store::VertexStore;
use crate::error::Result;
use crate::layout::{FirstUse, GroupSize, Paging, hierarchy, paginate, renamed_rows, spatial_order};
use crate::limits::CLUSTER_MAX_TRIANGLES;
use crate::math::{Aabb, Bounds, octahedral};
use crate::model::cluster::{NO_GROUP, NO_PAGE, RECORD_WORDS, Streams};
use crate::model::packing::{VertexRow, vertex_row, write_triangles};
use crate::model::rule::ROOT_ERROR;
use crate::model::{
    AttributeLayout, BuildReport, ClusterRecord, Dag, GeometryId, Group, Materials, Outline, Packing,
    PageEntry, PageSink, PageWords, Pages, Primitive, dependencies,
};

/// Lays the graph out and hands its pages to a sink.
pub fn assemble<S: PageSink>(mut graph: Graph, mut report: BuildReport, sink: S) -> Result<S::Output> {
    graph.clusters.par_iter_mut().for_each(|c| order::spiral(&mut c.mesh));
    let store = &graph.store;
    let cluster_boxes: Vec<Aabb> = graph
        .clusters
        .par_iter()
        .map(|c| Aabb::of_points(c.mesh.vertices.iter().map(|v| &store.positions[*v as usize])))
        .collect();
    let boxes: Vec<Aabb> = graph
        .groups
        .iter()
        .map(|g| g.members.iter().fold(Aabb::EMPTY, |b, c| b.union(&cluster_boxes[*c as usize])))
        .collect();
    let spatial = spatial_order(graph.groups.iter().map(|g| g.level).zip(boxes.iter().copied()));
    let names_in = |order: &[u32]| {
        let members = order.iter().flat_map(|g| &graph.groups[*g as usize].members);
        let mut names = FirstUse::new(store.count());
        members.flat_map(|c| &graph.clusters[*c as usize].mesh.vertices).for_each(|v| names.add(*v));
        names.finish()
    };
    let pack = |names: &[u32]| -> (Vec<Packed>, Paging) {
        let packed: Vec<Packed> = graph.clusters.par_iter().map(|c| Packed::of(store, c, names)).collect();
        let paging = paginate(&spatial, |g| size(&graph.groups[g as usize], &graph, &packed));
        (packed, paging)
    };
    // Names should follow pages, but what a page has room for depends on names, if little: the second time they do all
    // but follow.
    let (_, paging) = pack(&names_in(&spatial).0);
    let (names, vertex_count) = names_in(&paging.order);
    let (packed, Paging { table, order, first }) = pack(&names);
    let boxes: Vec<Aabb> = order.iter().map(|g| boxes[*g as usize]).collect();
    let triangles = |c: u32| graph.clusters[c as usize].mesh.triangles.len() as u16;
    let mut made = vec![0u16; graph.groups.len()];
    for (cluster, number) in graph.clusters.iter().zip(0..) {
        if let Some(made) = made.get_mut(cluster.refined as usize) {
            *made += triangles(number);
        }
    }
    let groups: Vec<Group> = order
        .iter()
        .zip(&boxes)
        .zip(&first)
        .map(|((g, bounds), first)| {
            let group = &graph.groups[*g as usize];
            let (center, extent) = bounds.center_extent();
            let own_errors = group.members.iter().map(|c| graph.clusters[*c as usize].error);
            Group {
                lod_sphere: group.lod_sphere,
                error: group.error,
                first: *first,
                count: group.members.len() as u32,
                level: group.level,
                center,
                extent,
                bound: group.bound,
                quadric: group.quadric,
                attribute_error: group.attribute_error,
                min_own_error: own_errors.fold(f32::INFINITY, f32::min),
                rank: group.rank,
                triangles: group.members.iter().map(|c| triangles(*c)).sum(),
                made: made[*g as usize],
            }
        })
        .collect();
    let mut renamed = vec![0; order.len()];
    order.iter().enumerate().for_each(|(new, old)| renamed[*old as usize] = new as u32);
    let mut channels = graph.channels.finish(&store.attributes, store.stride, &store.labels);
    for channel in &mut channels {
        let rows = renamed_rows(channel.words.held(), channel.info.width(), &names, vertex_count);
        channel.words = rows.into();
    }
    let numbered = order.iter().map(|g| &graph.groups[*g as usize].members).zip(0..);
    let members: Vec<(u32, u32)> =
        numbered.flat_map(|(members, number)| members.iter().map(move |c| (*c, number))).collect();
    let of_page = |entry: &PageEntry| &members[entry.first_cluster as usize..][..entry.clusters as usize];
    let made_from = |refined: u32| match renamed.get(refined as usize) {
        Some(group) => (*group, groups[*group as usize].first.page() as u32),
        None => (NO_GROUP, NO_PAGE),
    };
    let face_ids = graph.face_rows.as_ref().map(|(faces, rows)| {
        let clusters = members.iter().map(|(cluster, _)| &graph.clusters[*cluster as usize]);
        face_ids(clusters, faces, rows, &names).into()
    });
    report.clusters = graph.clusters.len() as u64;
    report.triangles = graph.clusters.iter().map(|c| c.mesh.triangles.len() as u64).sum();
    report.fill = report.triangles as f64 / (report.clusters as usize * CLUSTER_MAX_TRIANGLES) as f64;
    let mesh = Dag {
        id: GeometryId::default(),
        topology: None,
        frame: graph.frame,
        bounds: graph.bounds,
        pages: Arc::new(Pages::absent(table.into(), store.layout)),
        nodes: hierarchy(&groups, &boxes),
        groups: groups.as_slice().into(),
        vertex_count,
        channels,
        source_faces: graph.source_faces as u64,
        source_vertices: graph.source_vertices as u64,
        face_ids,
        materials: Materials::default(),
        primitive: Primitive::Triangles,
        grid: None,
        pose: None,
        report,
    };
    let table = Arc::clone(&mesh.pages.table);
    let refined = |page: usize| {
        let own = of_page(&table[page]).iter();
        own.map(|(cluster, _)| made_from(graph.clusters[*cluster as usize].refined).1)
    };
    let dependencies = dependencies(table.len(), refined);
    let page = |page: usize| {
        write_page(of_page(&table[page]).iter().map(|(number, group)| {
            let (cluster, packed) = (&graph.clusters[*number as usize], &packed[*number as usize]);
            let made_from = made_from(cluster.refined);
            Member { cluster, store: &graph.store, names: &names, packed, group: *group, made_from }
        }))
    };
    Outline { mesh, dependencies }.fill(sink, |_, pages| Ok(pages.into_par_iter().map(page).collect()))
}

/// How pages hold a cluster.
#[derive(Clone, Copy, Debug)]
pub struct Packed {
    packing: Packing,
    streams: Streams,
}

impl Packed {
    /// The cluster of a store; `names` maps its vertices to identities.
    pub fn of(store: &VertexStore, cluster: &BuildCluster, names: &[u32]) -> Self {
        let packing = Packing::of(&rows(store, cluster, names), 0.0);
        let (vertices, triangles) = (cluster.mesh.vertices.len(), cluster.mesh.triangles.len());
        Self { packing, streams: store.layout.streams(vertices, triangles, packing.widths) }
    }

    /// Words of its record and its streams.
    pub fn words(&self) -> usize {
        RECORD_WORDS + self.streams.end
    }
}

/// The vertices of a cluster; `names` maps those of the store to identities.
fn rows(store: &VertexStore, cluster: &BuildCluster, names: &[u32]) -> Vec<VertexRow> {
    let vertices = cluster.mesh.vertices.iter().map(|v| *v as usize);
    vertices.map(|v| vertex_row(store.positions[v], names[v], 0.0)).collect()
}

fn size(group: &BuildGroup, graph: &Graph, packed: &[Packed]) -> GroupSize {
    let words = group.members.iter().map(|c| packed[*c as usize].words());
    let source = group.members.iter().map(|c| &graph.clusters[*c as usize]).filter(|c| c.level == 0);
    GroupSize {
        level: group.level,
        root: group.error == ROOT_ERROR,
        clusters: group.members.len() as u32,
        words: words.sum::<usize>() as u32,
        faces: source.map(|c| c.mesh.triangles.len() as u32).sum(),
    }
}

/// A cluster that a page is to hold.
#[derive(Clone, Copy, Debug)]
pub struct Member<'a> {
    /// It.
    pub cluster: &'a BuildCluster,
    /// Its vertices.
    pub store: &'a VertexStore,
    /// The identity of each of those.
    pub names: &'a [u32],
    /// How the page holds it.
    pub packed: &'a Packed,
    /// Final number of its group.
    pub group: u32,
    /// Final number, and page, of the group that it was made from.
    pub made_from: (u32, u32),
}

/// The words of a page of these clusters.
pub fn write_page<'a>(members: impl ExactSizeIterator<Item = Member<'a>>) -> PageWords {
    let mut page = vec![0u32; members.len() * RECORD_WORDS];
    for (slot, member) in members.enumerate() {
        let Member { cluster, store, names, packed, group, made_from: (refined, refined_page) } = member;
        let at = page.len();
        let record = ClusterRecord { refined_page, ..record(store, cluster, group, refined, at as u32) };
        page[slot * RECORD_WORDS..][..RECORD_WORDS].copy_from_slice(bytemuck::cast_slice(&[record]));
        page.resize(at + packed.streams.end, 0);
        packed.packing.write(&rows(store, cluster, names), &mut page[at..]);
        write_streams(&cluster.mesh, store.layout, packed.streams, |v| store.row(v), &mut page[at..]);
    }
    page.into()
}

fn record(store: &VertexStore, cluster: &BuildCluster, group: u32, refined: u32, data: u32) -> ClusterRecord {
    let points: Vec<[f32; 3]> = cluster.mesh.vertices.iter().map(|v| store.positions[*v as usize]).collect();
    let bounds = Bounds::of(&points, &cluster.mesh.triangles);
    ClusterRecord {
        center: bounds.center,
        radius: bounds.radius,
        extent: bounds.extent,
        cone: bounds.cone,
        lod_sphere: cluster.lod_sphere,
        error: cluster.error,
        group,
        vertex_count: cluster.mesh.vertices.len() as u8,
        triangle_count: cluster.mesh.triangles.len() as u8,
        level: cluster.level,
        reserved: 0,
        data,
        refined,
        max_edge: bounds.max_edge,
        material: cluster.mesh.material.cast_signed(),
        refined_page: NO_PAGE,
    }
}

/// Everything but positions and identities; `row` has the attributes of a vertex, see [`crate::mesh::attributes`].
pub(super) fn write_streams<'a>(
    mesh: &ClusterMesh,
    layout: AttributeLayout,
    streams: Streams,
    row: impl Fn(u32) -> &'a [f32],
    out: &mut [u32],
) {
    let count = mesh.vertices.len();
    write_triangles(&mesh.triangles, count, &mut out[streams.triangles..streams.normals]);
    for (i, v) in mesh.vertices.iter().enumerate() {
        let row = row(*v);
        out[streams.normals + i] = octahedral::encode([row[0], row[1], row[2]]);
        let mut at = 3;
        if layout.colors.is_some() {
            let (color, words) =
                (layout.colors.pack([0, 1, 2, 3].map(|k| row[at + k])), layout.colors.words());
            out[streams.colors + words * i..][..words].copy_from_slice(&color[..words]);
            at += 4;
        }
        for set in 0..usize::from(layout.uv_sets) {
            let pair = &mut out[streams.uvs + 2 * (set * count + i)..][..2];
            pair.copy_from_slice(&[row[at + 2 * set].to_bits(), row[at + 2 * set + 1].to_bits()]);
        }
    }
}

/// The caller's face row of every level-0 triangle, in page order. A clusterizer may turn a triangle's corners,
/// never its orientation; and no two faces have the same corners in the same order.
pub fn face_ids<'a>(
    clusters: impl Iterator<Item = &'a BuildCluster>,
    faces: &[[u32; 3]],
    rows: &[u32],
    names: &[u32],
) -> Vec<u32> {
    let canonical = |f: [u32; 3]| {
        let turn = (0..3).fold(0, |best, k| if f[k] < f[best] { k } else { best });
        [f[turn], f[(turn + 1) % 3], f[(turn + 2) % 3]]
    };
    let named = |f: [u32; 3]| canonical(f.map(|v| names[v as usize]));
    let lookup: FxHashMap<[u32; 3], u32> = faces.iter().zip(rows).map(|(f, row)| (named(*f), *row)).collect();
    let meshes = clusters.filter(|cluster| cluster.level == 0).map(|cluster| &cluster.mesh);
    let corners =
        meshes.flat_map(|mesh| mesh.triangles.iter().map(|t| t.map(|v| mesh.vertices[usize::from(v)])));
    corners.map(|corners| lookup[&named(corners)]).collect()
}
