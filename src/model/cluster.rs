//! The packed cluster record and the streams it points at.

use bytemuck::{Pod, Zeroable};

use super::colors::ColorFormat;
use super::packing::{
    Identities, PACKING_WORDS, Packing, Positions, Triangles, Widths, corner_bits, packed_words,
};
use crate::limits::PAGE_SLOT_BITS;
use crate::math::Sphere;

/// Where a cluster lives: page number and slot in the page, in one word. The identity of a cluster.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable)]
pub struct ClusterAddress(pub u32);

impl ClusterAddress {
    /// Address of `slot` in `page`.
    pub fn new(page: usize, slot: usize) -> Self {
        debug_assert!(slot < 1 << PAGE_SLOT_BITS && page < 1 << (32 - PAGE_SLOT_BITS));
        Self((page as u32) << PAGE_SLOT_BITS | slot as u32)
    }

    /// Page number.
    pub fn page(self) -> usize {
        (self.0 >> PAGE_SLOT_BITS) as usize
    }

    /// Slot in the page.
    pub fn slot(self) -> usize {
        (self.0 & ((1 << PAGE_SLOT_BITS) - 1)) as usize
    }
}

/// One cluster as culling reads it: 20 words at the head of its page. All lengths in internal units.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ClusterRecord {
    /// Centre of the box and of the culling sphere.
    pub center: [f32; 3],
    /// Radius about `center` that holds every vertex, rounded up.
    pub radius: f32,
    /// Half extents of the box about `center`, rounded up.
    pub extent: [f32; 3],
    /// Backface cone: axis x, y, z and cutoff as signed bytes over 127. A cutoff of 127 never culls.
    /// All triangles face away when dot(c − eye, axis) ≥ cutoff·|c − eye| + radius.
    pub cone: [i8; 4],
    /// Sphere at which `error` is projected: that of the group whose simplification made this cluster.
    pub lod_sphere: Sphere,
    /// Error of this cluster: −1 at level 0, above that of the group that made it.
    pub error: f32,
    /// The group this cluster is a member of: it holds the parent error.
    pub group: u32,
    /// Number of vertices.
    pub vertex_count: u8,
    /// Number of triangles.
    pub triangle_count: u8,
    /// Times the surface was simplified to make this cluster; 0 is the source.
    pub level: u8,
    /// Zero.
    pub reserved: u8,
    /// Word offset of the streams from the start of the page.
    pub data: u32,
    /// The group whose simplification made this cluster; [`NO_GROUP`] at level 0.
    pub refined: u32,
    /// Longest edge of the triangles, rounded up.
    pub max_edge: f32,
    /// Material of all its triangles, the caller's number; zero when there are no materials.
    pub material: i32,
    /// The page that holds the members of `refined`; [`NO_PAGE`] at level 0.
    pub refined_page: u32,
}

/// No group: what [`ClusterRecord::refined`] holds at level 0.
pub const NO_GROUP: u32 = u32::MAX;

/// No page: what [`ClusterRecord::refined_page`] holds at level 0.
pub const NO_PAGE: u32 = u32::MAX;

/// Words of a [`ClusterRecord`].
pub const RECORD_WORDS: usize = size_of::<ClusterRecord>() / 4;
const _: () = assert!(RECORD_WORDS == 20);

impl ClusterRecord {
    /// A cone that never culls.
    pub const NO_CONE: [i8; 4] = [0, 0, 0, 127];

    /// Cone axis (not exactly unit) and cutoff.
    pub fn cone(&self) -> ([f32; 3], f32) {
        let [x, y, z, cutoff] = self.cone.map(|c| f32::from(c) / 127.0);
        ([x, y, z], cutoff)
    }
}

/// Which per-vertex streams a mesh carries besides positions and identities.
///
/// The streams of a cluster, in the order in which they follow each other: a [`Packing`], positions, vertex identities,
/// triangles (three corners each, see [`Triangles`]), normals (octahedral, 1 word), colours (see
/// [`ColorFormat`]), and `uv_sets` × (2 × f32).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct AttributeLayout {
    /// What vertex colours are stored as.
    pub colors: ColorFormat,
    /// Number of UV sets.
    pub uv_sets: u8,
    /// Clusters have materials.
    pub materials: bool,
}

/// Where the streams of a cluster begin, words from the first of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Streams {
    /// Vertex identities.
    pub ids: usize,
    /// Triangles.
    pub triangles: usize,
    /// Normals.
    pub normals: usize,
    /// Colours.
    pub colors: usize,
    /// UV sets.
    pub uvs: usize,
    /// Behind the last.
    pub end: usize,
}

impl AttributeLayout {
    /// Where the streams of a cluster begin.
    #[inline]
    pub fn streams(self, vertices: usize, triangles: usize, widths: Widths) -> Streams {
        let [x, y, z, id] = widths.map(usize::from);
        let ids = PACKING_WORDS + packed_words(vertices, x + y + z);
        let triangles_at = ids + packed_words(vertices, id);
        let normals = triangles_at + packed_words(triangles, 3 * corner_bits(vertices) as usize);
        let colors = normals + vertices;
        let uvs = colors + self.colors.words() * vertices;
        Streams {
            ids,
            triangles: triangles_at,
            normals,
            colors,
            uvs,
            end: uvs + 2 * usize::from(self.uv_sets) * vertices,
        }
    }
}

/// The streams of one cluster, borrowed from its page.
#[derive(Clone, Copy, Debug)]
pub struct ClusterGeometry<'a> {
    /// Positions in internal units.
    pub positions: Positions<'a>,
    /// Vertex identities: two clusters share a vertex exactly when the identities are equal.
    pub ids: Identities<'a>,
    /// Corners of each triangle, counter-clockwise seen from the front.
    pub triangles: Triangles<'a>,
    /// Octahedral normals, see [`crate::math::octahedral`].
    pub normals: &'a [u32],
    /// Colours, as many words each as [`AttributeLayout::colors`] says; empty when the mesh has none.
    pub colors: &'a [u32],
    /// UV sets, one after the other; empty when the mesh has none.
    pub uvs: &'a [[f32; 2]],
}

impl<'a> ClusterGeometry<'a> {
    /// The streams at the head of `words`, of a cluster of at least a vertex and a triangle.
    pub fn new(words: &'a [u32], layout: AttributeLayout, vertices: usize, triangles: usize) -> Self {
        let packing: Packing = bytemuck::pod_read_unaligned(bytemuck::cast_slice(&words[..PACKING_WORDS]));
        let streams = layout.streams(vertices, triangles, packing.widths);
        let words = &words[..streams.end];
        let bytes: &[u8] = bytemuck::cast_slice(words);
        // Triangles and normals follow, each a word at least: what reads of packed numbers may reach.
        Self {
            positions: Positions::new(&bytes[4 * PACKING_WORDS..], vertices, packing),
            ids: Identities::new(&bytes[4 * streams.ids..], vertices, packing),
            triangles: Triangles::new(&bytes[4 * streams.triangles..], triangles, vertices),
            normals: &words[streams.normals..streams.colors],
            colors: &words[streams.colors..streams.uvs],
            uvs: bytemuck::cast_slice(&words[streams.uvs..]),
        }
    }

    /// Bits of its packed numbers.
    pub fn widths(&self) -> Widths {
        self.positions.packing().widths
    }

    /// The corners of triangle `t`.
    pub fn corners(&self, t: usize) -> [[f32; 3]; 3] {
        self.triangles.get(t).map(|v| self.positions.get(usize::from(v)))
    }
}
