//! The whole of a built mesh.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::channel::Channel;
use super::cluster::{AttributeLayout, ClusterAddress, ClusterGeometry, ClusterRecord};
use super::geometry::GeometryId;
use super::hierarchy::Node;
use super::materials::Materials;
use super::page::{PageEntry, Pages};
use super::pose::Pose;
use super::primitive::Primitive;
use super::reading::InterruptCheck;
use super::report::BuildReport;
use super::rule::ROOT_ERROR;
use super::words::Words;
use crate::error::Result;
use crate::math::{Aabb, Sphere};

/// Clusters that are simplified together. A cluster is drawn when its group's error projects above the
/// threshold and its own does not: see [`super::rule`].
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Group {
    /// Encloses the LOD spheres of the members; the clusters made from this group inherit it.
    pub lod_sphere: Sphere,
    /// The parent error of the members: the error of what was made from this group; +∞ where nothing was. At
    /// least what is stated of shape and attributes below.
    pub error: f32,
    /// Address of the first member; members are consecutive in one page.
    pub first: ClusterAddress,
    /// Number of members.
    pub count: u32,
    /// Round of grouping, 0 for the finest.
    pub level: u32,
    /// Centre of the box around the members.
    pub center: [f32; 3],
    /// Half extents of that box, rounded up.
    pub extent: [f32; 3],
    /// How far what was made from this group is from the source, and the source from it: proven, or +∞ where
    /// building proved nothing.
    pub bound: f32,
    /// The simplifier's estimate of it, attributes weighed in, added up from level to level; +∞ like `error`.
    pub quadric: f32,
    /// How far attributes are off in what was made from this group, as a length; 0 where nothing was.
    pub attribute_error: f32,
    /// The least own error of a member: while it is too large everywhere on the sphere, none of them is drawn.
    pub min_own_error: f32,
    /// What a group costs, as a length that does not fall along the DAG: for a number of triangles, those of the
    /// least rank are taken coarser first. +∞ where nothing was made from it.
    pub rank: f32,
    /// Triangles of its members; 0 in files that do not say so.
    pub triangles: u16,
    /// Triangles of what was made from it.
    pub made: u16,
}

const _: () = assert!(size_of::<Group>() == 80);

impl Group {
    /// How far the shape of what was made from this group is stated to be off: the bound, or else the estimate.
    pub fn distance(&self) -> f32 {
        if self.bound.is_finite() { self.bound } else { self.quadric }
    }

    /// Addresses of the members.
    pub fn members(&self) -> impl Iterator<Item = ClusterAddress> + use<> {
        let first = self.first.0;
        (0..self.count).map(move |i| ClusterAddress(first + i))
    }
}

/// How the mesh's internal space sits in the caller's: object = `origin` + `scale` · internal.
///
/// `scale` is a power of two, so that it changes no mantissa; `origin` is zero unless the source positions
/// need more than f32, or lie far from theirs.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CoordinateFrame {
    /// Position of the internal origin, object units.
    pub origin: [f64; 3],
    /// Object units per internal unit, a power of two.
    pub scale: f64,
    /// Largest distance, object units, by which storing a source position in f32 moved it, and by which the source itself is
    /// off what it stands for, as displaced meshes state it; rounded up.
    pub rounding: f64,
}

impl CoordinateFrame {
    /// Object-space position, exact for f32 sources.
    pub fn to_object(&self, p: [f32; 3]) -> [f64; 3] {
        std::array::from_fn(|k| self.origin[k] + self.scale * f64::from(p[k]))
    }

    /// Largest distance, object units, by which positions were moved, in f32 and then on a grid; rounded up.
    pub fn rounding_on(&self, grid: Option<Grid>) -> f64 {
        match grid {
            Some(grid) if grid.moved > 0.0 => (self.rounding + grid.moved).next_up(),
            _ => self.rounding,
        }
    }

    /// True when object positions are exactly representable as f32.
    pub fn is_f32(&self) -> bool {
        self.origin == [0.0; 3] && self.rounding == 0.0
    }
}

/// What positions and normals were rounded to, so that few bits hold them.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Grid {
    /// Positions are whole multiples of 2^−`exponent` internal units, at most 2^24 of them, so that f32 holds them.
    pub exponent: i32,
    /// Bits of each of the two octahedral coordinates of a normal.
    pub normal_bits: u32,
    /// UVs are whole multiples of 2^−`uv_exponent`, at most 2^24 of them; nothing where they were not rounded.
    pub uv_exponent: Option<i32>,
    /// Largest distance, object units, by which this moved a position, rounded up.
    pub moved: f64,
}

impl Grid {
    /// Internal units per step.
    pub fn step(self) -> f32 {
        2f32.powi(-self.exponent)
    }

    /// What UVs are multiples of; 0 where they were not rounded.
    pub fn uv_step(self) -> f32 {
        self.uv_exponent.map_or(0.0, |exponent| 2f32.powi(-exponent))
    }
}

/// A cluster DAG with its culling hierarchy.
#[derive(Clone, Debug, PartialEq)]
pub struct Dag {
    /// By which devices and pools know it.
    pub id: GeometryId,
    /// One for all shapes of a geometry, which differ in where their vertices are alone; nothing where there is one shape.
    pub topology: Option<Arc<GeometryId>>,
    /// Internal to object space.
    pub frame: CoordinateFrame,
    /// Internal box of the source surface.
    pub bounds: Aabb,
    /// All clusters.
    pub pages: Arc<Pages>,
    /// All groups, coarsest level first, members in page order.
    pub groups: Arc<[Group]>,
    /// The hierarchy; node 0 is the root. Children have larger numbers than their parent.
    pub nodes: Vec<Node>,
    /// Number of vertex identities; identities are below it.
    pub vertex_count: u32,
    /// Named per-vertex values, by identity.
    pub channels: Vec<Channel>,
    /// Triangles and vertices of the source after mending.
    pub source_faces: u64,
    /// Vertices of the source after welding.
    pub source_vertices: u64,
    /// For each level-0 triangle, in page order of the level-0 clusters, its row of the caller's `faces`;
    /// only when asked for.
    pub face_ids: Option<Words>,
    /// How it looks.
    pub materials: Materials,
    /// What its elements are.
    pub primitive: Primitive,
    /// What positions and normals were rounded to; nothing before a file asked for it.
    pub grid: Option<Grid>,
    /// Where its vertices are; nothing at rest. Everything but the pages is that of the pose.
    pub pose: Option<Arc<Pose>>,
    /// What building did.
    pub report: BuildReport,
}

impl Dag {
    /// Reads all that is not in memory: pages, channels and face ids.
    pub fn load_all(&self, proceed: InterruptCheck<'_>) -> Result<()> {
        self.pages.load_all(proceed)?;
        self.words().try_for_each(|words| words.load().map(drop))
    }

    /// The words beside the pages: those of channels, and face ids.
    pub fn words(&self) -> impl Iterator<Item = &Words> {
        self.channels.iter().map(|channel| &channel.words).chain(&self.face_ids)
    }

    /// Number of root pages: the first ones, up to the last with a group that nothing coarser was made from. What they
    /// depend on is before them.
    pub fn root_pages(&self) -> usize {
        let last = self.groups.iter().rfind(|group| group.error == ROOT_ERROR);
        last.map_or(0, |group| group.first.page() + 1)
    }

    /// Streams every cluster carries.
    pub fn layout(&self) -> AttributeLayout {
        self.pages.layout
    }

    /// Largest distance, object units, by which positions were moved where they were stored; rounded up.
    pub fn rounding(&self) -> f64 {
        self.frame.rounding_on(self.grid)
    }

    /// The pages as a device holds them: what moves takes others than those at rest.
    pub fn table(&self) -> &[PageEntry] {
        self.pose.as_ref().map_or(&self.pages.table, |pose| pose.table())
    }

    /// The words of a page as a device holds it, where these are the pages that are in memory.
    pub fn page_of<'a>(&'a self, pages: &'a Pages, number: usize) -> Cow<'a, [u32]> {
        match &self.pose {
            Some(pose) => Cow::Owned(pose.page(self, pages, number)),
            None => Cow::Borrowed(pages.page(number)),
        }
    }

    /// One cluster's record.
    pub fn record(&self, at: ClusterAddress) -> &ClusterRecord {
        self.pages.record(at)
    }

    /// One cluster's streams.
    pub fn geometry(&self, at: ClusterAddress) -> ClusterGeometry<'_> {
        self.geometry_of(&self.pages, at)
    }

    /// The same where these are the pages that are in memory.
    #[inline]
    pub fn geometry_of<'a>(&'a self, pages: &'a Pages, at: ClusterAddress) -> ClusterGeometry<'a> {
        match &self.pose {
            Some(pose) => pose.cluster(pages, at),
            None => pages.geometry(at),
        }
    }

    /// The error of a cluster and the sphere where it is projected, from its record.
    #[inline]
    pub fn own_error(&self, record: &ClusterRecord) -> (Sphere, f32) {
        match self.groups.get(record.refined as usize) {
            Some(group) if self.pose.is_some() => (group.lod_sphere, group.error),
            _ => (record.lod_sphere, record.error),
        }
    }

    /// Numbers of the groups of a page, which follow each other as their members do.
    pub fn groups_of(&self, page: usize) -> Range<usize> {
        let first = |page: usize| self.groups.partition_point(|group| group.first.page() < page);
        first(page)..first(page + 1)
    }

    /// The group a cluster is a member of.
    pub fn group_of(&self, at: ClusterAddress) -> &Group {
        &self.groups[self.record(at).group as usize]
    }

    /// Number of clusters.
    pub fn cluster_count(&self) -> usize {
        self.pages.cluster_count()
    }
}
