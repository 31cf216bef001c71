//! One page as few bytes, coded by itself: no other page is needed. Derived values are not written: boxes and radii
//! follow from positions, errors and spheres from groups, vertex numbers from earlier ones.
//!
//! A vertex that several clusters of the page share is written once. Its position and attributes are differences
//! from a prediction by earlier vertices (`columns.rs`), triangles are symbols (`topology.rs`), and all of it is
//! stored as bit planes (`planes.rs`). `docs/format.md` has every field.

use std::ops::Range;

use crate::math::Sphere;
use crate::math::octahedral::NORMAL_BITS;
use crate::model::cluster::Streams;
use crate::model::packing::Widths;
use crate::model::{AttributeLayout, Grid, Group};

/// The parts of a coded page, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Counts, levels, origins, materials, and spheres of level 0.
    Records,
    /// Triangles.
    Topology,
    /// Which vertices are shared, and by which numbers.
    Identities,
    /// Positions.
    Positions,
    /// Normals.
    Normals,
    /// Colours.
    Colors,
    /// UV sets.
    Uvs,
}

impl Part {
    /// All, in order.
    pub const ALL: [Self; 7] = [
        Self::Records,
        Self::Topology,
        Self::Identities,
        Self::Positions,
        Self::Normals,
        Self::Colors,
        Self::Uvs,
    ];

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Records => "records",
            Self::Topology => "topology",
            Self::Identities => "identities",
            Self::Positions => "positions",
            Self::Normals => "normals",
            Self::Colors => "colors",
            Self::Uvs => "uvs",
        }
    }
}

/// Bytes of each part of a page.
pub type PartBytes = [u32; Part::ALL.len()];

/// Largest number of grid steps of a coordinate: f32 holds all whole numbers up to it.
pub const MAX_STEPS: i32 = 1 << f32::MANTISSA_DIGITS;

/// What a page is coded against: what a file holds besides its pages.
#[derive(Clone, Debug)]
pub struct Context<'a> {
    /// Streams of every cluster.
    pub layout: AttributeLayout,
    /// What positions and normals are multiples of.
    pub grid: Option<Grid>,
    /// All groups.
    pub groups: &'a [Group],
    /// Those whose members are the page's clusters, in order.
    pub own: Range<usize>,
    /// The first identity that no earlier page has, as far as identities are numbered by first use.
    pub first_identity: u32,
}

impl Context<'_> {
    /// Internal units per step of the grid; 0 where there is none.
    pub(super) fn step(&self) -> f32 {
        self.grid.map_or(0.0, Grid::step)
    }

    /// What UVs are multiples of; 0 where they were not rounded.
    pub(super) fn uv_step(&self) -> f32 {
        self.grid.map_or(0.0, Grid::uv_step)
    }

    pub(super) fn normal_bits(&self) -> u32 {
        self.grid.map_or(NORMAL_BITS, |grid| grid.normal_bits)
    }

    /// The number of each cluster's group.
    pub(super) fn group_numbers(&self) -> impl Iterator<Item = u32> {
        self.own.clone().flat_map(|g| (0..self.groups[g].count).map(move |_| g as u32))
    }
}

/// A vertex is the first of its identity in the file, by the order of numbers.
pub(super) const FIRST: u8 = 0;
/// Its identity was in an earlier cluster of the page.
pub(super) const SHARED: u8 = 1;
/// Its identity was in an earlier page.
pub(super) const EARLIER: u8 = 2;
/// Bits of one of the above.
pub(super) const USE_BITS: usize = 2;
/// The bits themselves.
pub(super) const USE_MASK: u8 = (1 << USE_BITS) - 1;
/// How many fit a byte.
pub(super) const USES_PER_BYTE: usize = 8 / USE_BITS;

/// A cluster of a page while it is coded.
pub(super) struct Shape {
    pub vertices: usize,
    pub triangles: usize,
    /// Bits of its packed numbers.
    pub widths: Widths,
    /// First word of its streams in the page.
    pub data: usize,
    /// Where they begin, from there.
    pub streams: Streams,
}

/// Bytes of a cluster among the records: three counts, widths, cone, longest edge, origin, and material.
pub(super) fn record_bytes(layout: AttributeLayout) -> usize {
    19 + 4 * usize::from(layout.materials)
}

/// Bytes of a sphere of level 0.
pub(super) const SPHERE_BYTES: usize = size_of::<Sphere>();
