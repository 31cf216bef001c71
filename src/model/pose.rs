//! A DAG whose vertices move: its clusters are those at rest, moved when somebody asks for them.

use std::sync::OnceLock;

use super::cluster::{
    AttributeLayout, ClusterAddress, ClusterGeometry, ClusterRecord, RECORD_WORDS, Streams,
};
use super::dag::Dag;
use super::packing::{PACKING_WORDS, Packing, WIDEST, Widths, ordered};
use super::page::{PageEntry, Pages};
use super::skin::Joints;
use super::waves::Sway;
use crate::math::sphere::round_up;
use crate::math::{Aabb, Sphere};

/// Bits of the packed numbers of a cluster that may lie anywhere: positions take whole words.
fn moved_widths(rest: Widths) -> Widths {
    let [x, y, z, _] = WIDEST;
    [x, y, z, rest[3]]
}

/// The streams of such a cluster.
fn moved_streams(layout: AttributeLayout, geometry: &ClusterGeometry<'_>) -> Streams {
    let (vertices, triangles) = (geometry.positions.len(), geometry.triangles.len());
    layout.streams(vertices, triangles, moved_widths(geometry.widths()))
}

/// Pages with such clusters, all of which are in memory.
pub fn moved_table(pages: &Pages) -> Vec<PageEntry> {
    let entry = |(page, entry): (usize, &PageEntry)| {
        let words = |slot: usize| {
            RECORD_WORDS + moved_streams(pages.layout, &pages.geometry(ClusterAddress::new(page, slot))).end
        };
        PageEntry { words: (0..entry.clusters as usize).map(words).sum::<usize>() as u32, ..*entry }
    };
    pages.table.iter().enumerate().map(entry).collect()
}

/// What moves vertices.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// Joints.
    Joints(Joints),
    /// Waves, at a time.
    Sway(Sway),
}

impl Motion {
    /// The pages with clusters that may lie anywhere.
    fn table(&self) -> &[PageEntry] {
        match self {
            Self::Joints(joints) => &joints.skin.table,
            Self::Sway(sway) => &sway.waves.table,
        }
    }

    /// The box around a cluster, by number in page order, from the box at rest.
    fn cluster_box(&self, number: usize, center: [f64; 3], extent: [f64; 3]) -> Aabb {
        match self {
            Self::Joints(joints) => joints.cluster_box(number, center, extent),
            Self::Sway(sway) => sway.cluster_box(number, center, extent),
        }
    }
}

/// A DAG under a pose.
#[derive(Debug)]
pub struct Pose {
    motion: Motion,
    /// The streams of clusters that were asked for, in page order.
    clusters: Vec<OnceLock<Box<[u32]>>>,
}

impl Pose {
    /// Of so many clusters.
    pub fn new(motion: Motion, clusters: usize) -> Self {
        Self { motion, clusters: std::iter::repeat_with(OnceLock::new).take(clusters).collect() }
    }

    /// The streams of a cluster, from its page at rest. Every identity has one place, whatever cluster asks.
    pub fn cluster<'a>(&'a self, pages: &Pages, at: ClusterAddress) -> ClusterGeometry<'a> {
        let record = pages.record(at);
        let (vertices, triangles) = (usize::from(record.vertex_count), usize::from(record.triangle_count));
        ClusterGeometry::new(self.words(pages, at), pages.layout, vertices, triangles)
    }

    fn words(&self, pages: &Pages, at: ClusterAddress) -> &[u32] {
        self.clusters[pages.dense_index(at)].get_or_init(|| {
            let rest = &pages.page(at.page())[pages.record(at).data as usize..];
            self.moved(rest, pages.layout, &pages.geometry(at))
        })
    }

    /// The pages with clusters that may lie anywhere.
    pub fn table(&self) -> &[PageEntry] {
        self.motion.table()
    }

    /// The words of a page, in as many words as the table says, of the DAG that has this pose.
    pub fn page(&self, dag: &Dag, pages: &Pages, number: usize) -> Vec<u32> {
        let records = pages.records(number);
        let mut out = Vec::with_capacity(self.table()[number].words as usize);
        out.resize(records.len() * RECORD_WORDS, 0);
        for (slot, record) in records.iter().enumerate() {
            let at = ClusterAddress::new(number, slot);
            let (sphere, extent) = self.cluster_bounds(pages, at);
            let (lod_sphere, error) = dag.own_error(record);
            let moved = ClusterRecord {
                center: sphere.center,
                radius: sphere.radius,
                extent,
                cone: ClusterRecord::NO_CONE,
                lod_sphere,
                error,
                max_edge: 2.0 * sphere.radius,
                data: out.len() as u32,
                ..*record
            };
            out[slot * RECORD_WORDS..][..RECORD_WORDS].copy_from_slice(bytemuck::cast_slice(&[moved]));
            out.extend_from_slice(self.words(pages, at));
        }
        out
    }

    /// A sphere around a cluster, and half extents of a box about its centre, from the box at rest.
    pub fn cluster_bounds(&self, pages: &Pages, at: ClusterAddress) -> (Sphere, [f32; 3]) {
        let record = pages.record(at);
        let (center, extent) = (record.center.map(f64::from), record.extent.map(f64::from));
        let bounds = self.motion.cluster_box(pages.dense_index(at), center, extent);
        let (center, extent) = bounds.center_extent();
        let radius = extent.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
        (Sphere { center, radius: round_up(radius) }, extent)
    }

    /// The streams of a cluster with other positions and normals. Positions take whole words, so that any shape fits.
    fn moved(&self, rest: &[u32], layout: AttributeLayout, geometry: &ClusterGeometry<'_>) -> Box<[u32]> {
        let packing = geometry.positions.packing();
        let (vertices, triangles) = (geometry.positions.len(), geometry.triangles.len());
        let from = layout.streams(vertices, triangles, packing.widths);
        let (to, widths) = (moved_streams(layout, geometry), moved_widths(packing.widths));
        let mut words = vec![0; to.end];
        let head = Packing { anchor: [0, 0, 0, packing.anchor[3]], widths, step: 0.0 };
        words[..PACKING_WORDS].copy_from_slice(bytemuck::cast_slice(&[head]));
        words[to.ids..to.normals].copy_from_slice(&rest[from.ids..from.normals]);
        words[to.colors..].copy_from_slice(&rest[from.colors..from.end]);
        let normals = &rest[from.normals..from.colors];
        match &self.motion {
            Motion::Joints(joints) => {
                write(&mut words, to, geometry, normals, |id, p, n| joints.vertex(id, p, n))
            }
            Motion::Sway(sway) => {
                write(&mut words, to, geometry, normals, |id, p, n| (sway.vertex(id, p), n))
            }
        }
        words.into()
    }
}

/// A pose is itself: two are equal if nothing tells them apart.
impl PartialEq for Pose {
    fn eq(&self, other: &Self) -> bool {
        self.motion == other.motion
    }
}

/// Writes where vertices go, and their normals.
fn write(
    words: &mut [u32],
    to: Streams,
    geometry: &ClusterGeometry<'_>,
    normals: &[u32],
    vertex: impl Fn(u32, [f64; 3], u32) -> ([f64; 3], u32),
) {
    for (v, (id, normal)) in geometry.ids.iter().zip(normals).enumerate() {
        let (position, normal) = vertex(id, geometry.positions.get(v).map(f64::from), *normal);
        let out = &mut words[PACKING_WORDS + 3 * v..][..3];
        out.copy_from_slice(&position.map(|x| ordered((x as f32 + 0.0).to_bits())));
        words[to.normals + v] = normal;
    }
}
