//! What a build did, in numbers.

use serde::{Deserialize, Serialize};

/// Why a group could not be simplified and its clusters wait for another round or stay roots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StuckReason {
    /// No step of the chain removed enough triangles.
    TooFewCollapses,
    /// Collapses would have cost more than those of other groups.
    TooDear,
    /// Every result would have opened a crack to a neighbouring group.
    BorderChanged,
    /// Every result had triangles between materials.
    MixedMaterials,
    /// Every result was empty.
    Vanished,
}

/// A group that nothing was made from: its clusters are roots of the DAG.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StuckGroup {
    /// Round of grouping.
    pub level: u32,
    /// Number of clusters.
    pub clusters: u32,
    /// Number of triangles.
    pub triangles: u32,
    /// Why.
    pub reason: StuckReason,
}

/// One round of grouping.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LevelReport {
    /// Clusters that entered the round.
    pub clusters: u32,
    /// Triangles in them.
    pub triangles: u64,
    /// Groups they were gathered into.
    pub groups: u32,
    /// Groups whose clusters went on to the next round unchanged.
    pub retried: u32,
    /// Groups simplified by each step of the chain: attributes, the same with a change of topology, permissive,
    /// sloppy.
    pub steps: [u32; 4],
    /// Largest error made, object units.
    pub max_error: f64,
    /// Largest deviation of attributes as a length, object units.
    pub max_attribute_error: f64,
}

/// What building was told to weigh, for those who simplify what it made. Files without it get the defaults.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Weights {
    /// A unit of normal deviation against one mean edge length of distance.
    pub normal: f32,
    /// A unit of colour, 0 to 1.
    pub color: f32,
    /// A unit of UV.
    pub uv: f32,
    /// The range of a channel, or another label.
    pub channel: f32,
}

impl Default for Weights {
    fn default() -> Self {
        Self { normal: 1.0, color: 1.0, uv: 1.0, channel: 1.0 }
    }
}

/// Everything a build reports.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BuildReport {
    /// Faces given.
    pub input_faces: u64,
    /// Vertices given.
    pub input_vertices: u64,
    /// Faces dropped because two corners coincide.
    pub degenerate_faces: u64,
    /// Faces dropped because an identical face came before.
    pub duplicate_faces: u64,
    /// Vertices that no remaining face uses.
    pub unreferenced_vertices: u64,
    /// Vertices merged into a bit-identical one.
    pub welded_vertices: u64,
    /// Edges (by position) with more than two faces.
    pub non_manifold_edges: u64,
    /// Edges (by position) with one face.
    pub border_edges: u64,
    /// Given normals of zero length, replaced by computed ones.
    pub mended_normals: u64,
    /// Normals were computed.
    pub computed_normals: bool,
    /// Clusters of all levels.
    pub clusters: u64,
    /// Triangles of all levels.
    pub triangles: u64,
    /// Mean triangles per cluster over the most a cluster holds.
    pub fill: f64,
    /// One entry per round of grouping, finest first.
    pub levels: Vec<LevelReport>,
    /// Groups that stay roots besides the last one.
    pub stuck: Vec<StuckGroup>,
    /// What attributes weighed.
    #[serde(default)]
    pub weights: Weights,
    /// Small islands that stay grow until as much is covered as before.
    #[serde(default)]
    pub preserve_area: bool,
    /// Parts of levels that have images of their own.
    #[serde(default)]
    pub rebaked: Vec<RebakedPart>,
}

/// A part of a level that was welded over seams, and has an image that was baked for it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RebakedPart {
    /// Number of simplifications behind it.
    pub level: u8,
    /// The number of its material.
    pub material: i32,
    /// Triangles in it.
    pub triangles: u64,
    /// The size of texels, object units.
    pub texel: f64,
}

impl BuildReport {
    /// Whether a material shows an image that was baked for a level.
    pub fn is_rebaked(&self, material: i32) -> bool {
        self.rebaked.iter().any(|part| part.material == material)
    }
}
