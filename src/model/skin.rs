//! Meshes whose vertices follow joints: what acts on which part of a DAG, and the clusters under a pose.
//!
//! Linear blend skinning (Magnenat-Thalmann, Laperrière and Thalmann, Graphics Interface 1988): a vertex at x goes to
//! Σ wᵢ Mᵢ x, where wᵢ are its weights, which add up to 1, and Mᵢ what the joints do to space.

use std::sync::{Arc, OnceLock};

use super::cluster::{
    AttributeLayout, ClusterAddress, ClusterGeometry, ClusterRecord, RECORD_WORDS, Streams,
};
use super::dag::Dag;
use super::geometry::GeometryId;
use super::packing::{PACKING_WORDS, Packing, WIDEST, Widths, ordered};
use super::page::{PageEntry, Pages};
use crate::math::affine::{self, Affine};
use crate::math::sphere::round_up;
use crate::math::{Aabb, Sphere, octahedral};

/// Lists one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Lists<T> {
    /// Where each begins; one more entry than lists.
    first: Vec<u32>,
    items: Vec<T>,
}

impl<T> Lists<T> {
    /// The list of a number.
    #[inline]
    pub fn of(&self, number: usize) -> &[T] {
        &self.items[self.first[number] as usize..self.first[number + 1] as usize]
    }

    /// How many lists there are.
    pub fn len(&self) -> usize {
        self.first.len() - 1
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl<T, L: IntoIterator<Item = T>> FromIterator<L> for Lists<T> {
    fn from_iter<I: IntoIterator<Item = L>>(lists: I) -> Self {
        let mut out = Self { first: vec![0], items: Vec::new() };
        for list in lists {
            out.items.extend(list);
            out.first.push(out.items.len() as u32);
        }
        out
    }
}

/// How much a joint acts on a vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Influence {
    /// Number of the joint.
    pub joint: u32,
    /// Above 0. Those of a vertex add up to 1.
    pub weight: f32,
}

/// A joint and the box of what it acts on, internal space at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointBox {
    /// Number of the joint.
    pub joint: u32,
    /// Around all vertices that it acts on.
    pub bounds: Aabb,
}

/// What bounds of the error of a group under a pose are made of: docs/numerics.md. All lengths in internal units, rounded up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GroupSkin {
    /// Each point of the source has one of what was made from the group no farther off than this, whose weights deviate no more
    /// than by `deviation`; and the other way round.
    pub reach: f32,
    /// Half the sum of the differences of weights.
    pub deviation: f32,
    /// The largest, over edges of triangles, of half the sum of the differences of weights times the length: of what was made,
    /// and of the source.
    pub bend: f32,
    /// The longest edge of any triangle of those: a joint acts no farther beyond the vertices that it acts on.
    pub edge: f32,
}

/// What acts on which part of a DAG.
#[derive(Clone, Debug, PartialEq)]
pub struct Skin {
    /// Number of joints.
    pub joints: usize,
    /// By vertex identity.
    pub influences: Lists<Influence>,
    /// Joints that act on each cluster, in page order.
    pub clusters: Lists<u32>,
    /// For each group the joints that act on its members, on what was made from it, or on anything below.
    pub groups: Lists<JointBox>,
    /// For each group those that its members were made from.
    pub below: Lists<u32>,
    /// What errors are made of, by group.
    pub errors: Vec<GroupSkin>,
    /// The joints that act on the source.
    pub source: Vec<JointBox>,
    /// One for all poses.
    pub topology: Arc<GeometryId>,
    /// The pages with clusters that may lie anywhere.
    pub table: Vec<PageEntry>,
}

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

/// A DAG under a pose: its clusters are those at rest, moved when somebody asks for them.
#[derive(Debug)]
pub struct Pose {
    /// What acts on what.
    pub skin: Arc<Skin>,
    /// For each joint, from internal space at rest to that under the pose.
    pub maps: Vec<Affine>,
    /// The streams of clusters that were asked for, in page order.
    clusters: Vec<OnceLock<Box<[u32]>>>,
}

impl Pose {
    /// Of so many clusters.
    pub fn new(skin: Arc<Skin>, maps: Vec<Affine>) -> Self {
        let clusters = skin.clusters.len();
        Self { skin, maps, clusters: std::iter::repeat_with(OnceLock::new).take(clusters).collect() }
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

    /// The words of a page, in as many words as [`Skin::table`] says, of the DAG that has this pose.
    pub fn page(&self, dag: &Dag, pages: &Pages, number: usize) -> Vec<u32> {
        let records = pages.records(number);
        let mut out = Vec::with_capacity(self.skin.table[number].words as usize);
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

    /// A sphere around a cluster, and half extents of a box about its centre, from the box at rest: each vertex is a mean of
    /// where its joints take it.
    pub fn cluster_bounds(&self, pages: &Pages, at: ClusterAddress) -> (Sphere, [f32; 3]) {
        let record = pages.record(at);
        let joints = self.skin.clusters.of(pages.dense_index(at));
        let (center, extent) = (record.center.map(f64::from), record.extent.map(f64::from));
        let bounds = moved_box(joints.iter().map(|joint| (&self.maps[*joint as usize], center, extent)));
        let (center, extent) = bounds.center_extent();
        let radius = extent.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
        (Sphere { center, radius: round_up(radius) }, extent)
    }

    /// What the joints of an identity do to space together. Their weights add up to 1: the first has what the others leave.
    #[inline]
    fn blended(&self, id: u32) -> Affine {
        let Some((first, others)) = self.skin.influences.of(id as usize).split_first() else {
            return affine::ZERO;
        };
        let first = &self.maps[first.joint as usize];
        if others.is_empty() {
            return *first;
        }
        let (mut out, mut rest) = (affine::ZERO, 1.0);
        for influence in others {
            let weight = f64::from(influence.weight);
            rest -= weight;
            affine::add(&mut out, weight, &self.maps[influence.joint as usize]);
        }
        affine::add(&mut out, rest, first);
        out
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
        for (v, id) in geometry.ids.iter().enumerate() {
            let map = self.blended(id);
            let position = affine::apply(&map, geometry.positions.get(v).map(f64::from));
            let out = &mut words[PACKING_WORDS + 3 * v..][..3];
            out.copy_from_slice(&position.map(|x| ordered((x as f32 + 0.0).to_bits())));
            let normal = affine::turned(&map, octahedral::direction(geometry.normals[v]).map(f64::from));
            // What f32 holds the largest of, it holds all of.
            let largest = normal.iter().fold(0.0f64, |most, x| most.max(x.abs()));
            words[to.normals + v] = octahedral::encode(normal.map(|x| (x / largest) as f32));
        }
        words.into()
    }
}

/// A pose is itself: two are equal if nothing tells them apart.
impl PartialEq for Pose {
    fn eq(&self, other: &Self) -> bool {
        self.maps == other.maps && self.skin == other.skin
    }
}

/// The box around boxes, each under a map: centre and half extents of each. Rounded outwards.
pub fn moved_box<'a>(boxes: impl Iterator<Item = (&'a Affine, [f64; 3], [f64; 3])>) -> Aabb {
    // Of sums of four products, many times over.
    const ROUNDING: f64 = 1.0e-14;
    let mut out = Aabb::EMPTY;
    for (map, center, extent) in boxes {
        let (at, reach) = affine::apply_to_box(map, center, extent);
        for k in 0..3 {
            let size: f64 = (0..3).map(|j| (map[k][j] * center[j]).abs()).sum::<f64>() + map[k][3].abs();
            let reach = reach[k] + ROUNDING * (size + reach[k]);
            out.min[k] = out.min[k].min(((at[k] - reach) as f32).next_down());
            out.max[k] = out.max[k].max(((at[k] + reach) as f32).next_up());
        }
    }
    out
}
