//! WGSL sources: constants that Rust has, shared files and the kernel's own, one after the other.

use std::mem::offset_of;

use crate::config::{OUTPUTS, Output, Shading};
use crate::gpu_types::{
    ABSENT, Dispatch, HISTORY_LIST, MATERIAL_COLOR_WORDS, MATERIAL_CONFORMAL, MATERIAL_SMOOTH,
    MATERIAL_UNLIT, QUAD, TEXTURE_FORMAT, TEXTURE_LINEAR, TEXTURE_MIPMAPS, TEXTURE_WRAP, TILES,
};
use crate::limits::{
    CLUSTER_MAX_TRIANGLES, CLUSTER_MAX_VERTICES, FOOTPRINT_MARGIN, FOOTPRINT_ROUNDING, GUARD_BAND, MAX_SPAN,
    PAGE_SLOT_BITS, PYRAMID_ABOVE, PYRAMID_FINER, PYRAMID_LEVELS, PYRAMID_REACH, SMALL_EDGE, SUBPIXEL_BITS,
    TRIANGLE_BITS,
};
use crate::math::project::LEAST_MARGIN;
use crate::model::cluster::RECORD_WORDS;
use crate::model::packing::{CORNER_BITS, WIDE_CORNER_BITS};
use crate::model::{ClusterRecord, Packing};
use crate::scene::Slot;
use crate::scene::albedo::ALBEDO_SIDE;
use crate::scene::environment::{GRIDS, IRRADIANCE, ROUGHNESS_LEVELS};
use crate::scene::image::TexelFormat;
use crate::scene::texture::{Mipmaps, Wrap};
use crate::scene::transfer::BYTE_STEPS;

/// Lanes of a workgroup where each entry is looked at by itself.
pub const WIDTH: u32 = 64;
/// Lanes of a workgroup that sums up words.
pub const SCAN_WIDTH: u32 = CLUSTER_MAX_TRIANGLES as u32;
/// Lanes whose values each of them adds up by itself.
const SCAN_ROW: u32 = 16;
/// Workgroups that every device allows along a dimension.
pub const MAX_WORKGROUPS: u32 = 65_535;
/// Groups whose clusters a workgroup culls, all of them shared out among its lanes: most have some six to look at.
pub const GROUPS_PER_WORKGROUP: u32 = 8;

/// Words of bits of groups with the bits that tell which of them are not zero.
pub fn group_bit_words(words: u32) -> u32 {
    words + words.div_ceil(u32::BITS)
}

/// Arrays that the pages of all meshes may lie in.
pub const PAGE_ARRAYS: usize = 4;
/// Bytes that a kernel reads of a record at a time; pages start at multiples of it.
const QUAD_BYTES: usize = size_of::<[u32; QUAD as usize]>();
/// Pixels that a lane gives new numbers, or counts.
pub const PIXELS_PER_LANE: u32 = 16;
/// Side of a workgroup that makes a part of the depth pyramid.
const PYRAMID_SIDE: u32 = 8;
/// Levels of the depth pyramid that a dispatch makes of the one below, as `hzb.wgsl` is written.
const LEVELS_PER_DISPATCH: u32 = 3;
/// Dispatches that make a whole pyramid.
pub const PYRAMID_DISPATCHES: u32 = (PYRAMID_LEVELS as u32 - 1).div_ceil(LEVELS_PER_DISPATCH);

/// What is decided after the first pass and after the second, in this order: words of bits of groups to list, pixels
/// to renumber, rounds of the pyramid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IndirectEntry {
    /// Blocks of the bits of groups, for the second pass.
    Groups,
    /// Pixels that get the numbers of the list of both passes.
    Pixels,
    /// A round of the depth pyramid.
    Pyramid(u32),
}

impl IndirectEntry {
    /// How many there are.
    pub const COUNT: u32 = 2 + PYRAMID_DISPATCHES;

    /// Place among them.
    pub const fn number(self) -> u32 {
        match self {
            Self::Groups => 0,
            Self::Pixels => 1,
            Self::Pyramid(round) => 2 + round,
        }
    }
}

/// Which of the two passes of occlusion culling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CullPass {
    /// What an earlier frame does not hide, or of what it drew; without occlusion, everything.
    First,
    /// What the first deferred, by its depth pyramid.
    Second,
}

/// How rasterizers write to the visibility buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Words {
    /// By one 64-bit atomic maximum.
    Int64,
    /// The nearest key of every pixel, the first of two 32-bit passes.
    Keys,
    /// The largest low half among those with that key, the second.
    Lows,
    /// How many triangles cover every pixel, instead.
    Count,
    /// The nearest key of every pixel and nothing else.
    Depth,
}

/// The lists of clusters to draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum List {
    /// Those of small triangles.
    Small,
    /// Those of large ones; with the hardware rasterizer, that it takes.
    Large,
    /// With the hardware rasterizer, large ones that it does not take: that have to be clipped.
    Clipped,
    /// Of any size, alpha-tested.
    AlphaTested,
}

impl List {
    /// How many there are.
    pub const COUNT: u32 = 4;
}

/// Sets of bits that are listed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bits {
    /// Of all groups of the scene, of which few are looked at.
    Groups,
    /// Of the clusters of the groups that are.
    Clusters,
}

impl Bits {
    /// Words that a workgroup sums up, shared out among its lanes. Of groups those that are not zero are looked at, which
    /// bits tell of 32 words together: so few that waiting for each other takes longer than looking.
    pub const fn block(self) -> u32 {
        match self {
            Self::Groups => 4096,
            Self::Clusters => 512,
        }
    }

    /// Sums that so many words have: one for each block, and behind them the total.
    pub const fn sums(self, words: u32) -> u32 {
        words.div_ceil(self.block()) + 1
    }

    /// A dispatch of such workgroups over so many words.
    pub fn dispatch(self, count: u32) -> Dispatch {
        let workgroups = count.div_ceil(self.block());
        let (x, y) = (workgroups.min(MAX_WORKGROUPS), workgroups.div_ceil(MAX_WORKGROUPS));
        Dispatch { x, y, z: 1, count, ..Dispatch::default() }
    }
}

/// What materials the scene has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MaterialKind {
    /// Each instance has a material without textures.
    Plain,
    /// Some have textures, or several materials.
    Textured,
}

/// Whether there is image-based lighting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ibl {
    /// No environment map.
    Off,
    /// An environment map.
    On,
}

/// Everything that runs on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// Instances → roots to look at.
    InstanceCull,
    /// Bits of groups → none.
    ClearGroups,
    /// A level of nodes → the next, and the bits of groups.
    NodeCull(CullPass),
    /// Words → set bits of each block of words.
    CountBits(Bits),
    /// Set bits of blocks → where each block starts.
    ScanBlocks(Bits),
    /// Bits of groups → the list of groups.
    ListGroups(CullPass),
    /// Groups → bits of clusters.
    ClusterCull(CullPass),
    /// Bits of clusters → the visible list.
    ListClusters(CullPass),
    /// Small clusters → visibility buffer.
    RasterSmall(Words),
    /// Large clusters → visibility buffer.
    RasterLarge(Words),
    /// Alpha-tested clusters → visibility buffer.
    RasterAlphaTested(Words),
    /// Clusters of a list → visibility buffer, by the rasterizer of the device.
    RasterHardware(List, Words),
    /// Visibility buffer → a round of the depth pyramid.
    Hzb(u32),
    /// Counts of a pass → what comes next.
    PrepareIndirect(CullPass),
    /// Visibility buffer of the first pass → with the numbers of both.
    Renumber,
    /// Visibility buffer → how many pixels show anything.
    CountCovered,
    /// Visibility buffer → colour, encoded or not.
    Shade(Output, MaterialKind, Ibl),
    /// Visibility buffer → another array; what is shaded and overdraw are made otherwise.
    Output(Output),
    /// A long loop, to see whether the driver finishes it.
    LoopProbe,
}

/// All that are dispatched; [`Kernel::number`] is the place here.
pub const KERNELS: [Kernel; 65] = [
    Kernel::InstanceCull,
    Kernel::ClearGroups,
    Kernel::NodeCull(CullPass::First),
    Kernel::NodeCull(CullPass::Second),
    Kernel::CountBits(Bits::Groups),
    Kernel::CountBits(Bits::Clusters),
    Kernel::ScanBlocks(Bits::Groups),
    Kernel::ScanBlocks(Bits::Clusters),
    Kernel::ListGroups(CullPass::First),
    Kernel::ListGroups(CullPass::Second),
    Kernel::ClusterCull(CullPass::First),
    Kernel::ClusterCull(CullPass::Second),
    Kernel::ListClusters(CullPass::First),
    Kernel::ListClusters(CullPass::Second),
    Kernel::PrepareIndirect(CullPass::First),
    Kernel::PrepareIndirect(CullPass::Second),
    Kernel::Renumber,
    Kernel::CountCovered,
    Kernel::Hzb(0),
    Kernel::Hzb(1),
    Kernel::Hzb(2),
    Kernel::Hzb(3),
    Kernel::Hzb(4),
    Kernel::Hzb(5),
    Kernel::LoopProbe,
    Kernel::RasterSmall(Words::Int64),
    Kernel::RasterSmall(Words::Keys),
    Kernel::RasterSmall(Words::Lows),
    Kernel::RasterLarge(Words::Int64),
    Kernel::RasterLarge(Words::Keys),
    Kernel::RasterLarge(Words::Lows),
    Kernel::RasterSmall(Words::Count),
    Kernel::RasterLarge(Words::Count),
    Kernel::RasterSmall(Words::Depth),
    Kernel::RasterLarge(Words::Depth),
    Kernel::RasterAlphaTested(Words::Int64),
    Kernel::RasterAlphaTested(Words::Keys),
    Kernel::RasterAlphaTested(Words::Lows),
    Kernel::RasterAlphaTested(Words::Count),
    Kernel::RasterAlphaTested(Words::Depth),
    Kernel::Shade(Output::Color, MaterialKind::Plain, Ibl::Off),
    Kernel::Shade(Output::Linear, MaterialKind::Plain, Ibl::Off),
    Kernel::Shade(Output::Color, MaterialKind::Textured, Ibl::Off),
    Kernel::Shade(Output::Linear, MaterialKind::Textured, Ibl::Off),
    Kernel::Shade(Output::Color, MaterialKind::Plain, Ibl::On),
    Kernel::Shade(Output::Linear, MaterialKind::Plain, Ibl::On),
    Kernel::Shade(Output::Color, MaterialKind::Textured, Ibl::On),
    Kernel::Shade(Output::Linear, MaterialKind::Textured, Ibl::On),
    Kernel::Shade(Output::BaseColor, MaterialKind::Plain, Ibl::Off),
    Kernel::Shade(Output::ShadingNormal, MaterialKind::Plain, Ibl::Off),
    Kernel::Shade(Output::Orm, MaterialKind::Plain, Ibl::Off),
    Kernel::Shade(Output::Emissive, MaterialKind::Plain, Ibl::Off),
    Kernel::Shade(Output::BaseColor, MaterialKind::Textured, Ibl::Off),
    Kernel::Shade(Output::ShadingNormal, MaterialKind::Textured, Ibl::Off),
    Kernel::Shade(Output::Orm, MaterialKind::Textured, Ibl::Off),
    Kernel::Shade(Output::Emissive, MaterialKind::Textured, Ibl::Off),
    Kernel::Output(Output::Depth),
    Kernel::Output(Output::Normal),
    Kernel::Output(Output::InstanceId),
    Kernel::Output(Output::ClusterId),
    Kernel::Output(Output::TriangleId),
    Kernel::Output(Output::Triangles),
    Kernel::Output(Output::Clusters),
    Kernel::Output(Output::Groups),
    Kernel::Output(Output::Levels),
];

/// All that draw, with a vertex and a fragment shader; [`Kernel::number`] is the place here.
pub const DRAWS: [Kernel; 8] = [
    Kernel::RasterHardware(List::Small, Words::Int64),
    Kernel::RasterHardware(List::Small, Words::Keys),
    Kernel::RasterHardware(List::Small, Words::Lows),
    Kernel::RasterHardware(List::Large, Words::Int64),
    Kernel::RasterHardware(List::Large, Words::Keys),
    Kernel::RasterHardware(List::Large, Words::Lows),
    Kernel::RasterHardware(List::Small, Words::Depth),
    Kernel::RasterHardware(List::Large, Words::Depth),
];

/// What `records.wgsl` reads four words at a time.
const _: () = {
    let quads = [
        [offset_of!(ClusterRecord, center), offset_of!(ClusterRecord, radius)],
        [offset_of!(ClusterRecord, extent), offset_of!(ClusterRecord, cone)],
        [offset_of!(ClusterRecord, lod_sphere), offset_of!(ClusterRecord, error) - size_of::<u32>()],
        [offset_of!(ClusterRecord, error), offset_of!(ClusterRecord, data)],
        [offset_of!(ClusterRecord, refined), offset_of!(ClusterRecord, refined_page)],
    ];
    let mut k = 0;
    while k < quads.len() {
        assert!(quads[k][0] == k * QUAD_BYTES && quads[k][1] + size_of::<u32>() == (k + 1) * QUAD_BYTES);
        k += 1;
    }
    assert!(
        offset_of!(ClusterRecord, vertex_count) == offset_of!(ClusterRecord, error) + 2 * size_of::<u32>()
    );
    assert!(offset_of!(ClusterRecord, material) == offset_of!(ClusterRecord, refined) + 2 * size_of::<u32>());
    assert!(RECORD_WORDS * size_of::<u32>() == quads.len() * QUAD_BYTES);
};

macro_rules! sources {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $name, ".wgsl")))),*]
    };
}

/// Every file by name.
const SOURCES: &[(&str, &str)] = sources![
    "clear_groups",
    "cluster_cull",
    "count_bits",
    "count_covered",
    "hzb",
    "instance_cull",
    "list_clusters",
    "list_groups",
    "loop_probe",
    "node_cull",
    "output",
    "prepare_indirect",
    "raster_hardware",
    "raster_large",
    "raster_small",
    "renumber",
    "scan_blocks",
    "shade",
    "shared/alpha_test",
    "shared/append",
    "shared/bsdf",
    "shared/cone",
    "shared/cull",
    "shared/defer",
    "shared/derive",
    "shared/double_single",
    "shared/environment",
    "shared/exact",
    "shared/group_bits",
    "shared/int64",
    "shared/key",
    "shared/lod",
    "shared/material",
    "shared/no_environment",
    "shared/occlusion",
    "shared/opaque",
    "shared/pages",
    "shared/frame_bindings",
    "shared/places",
    "shared/plain",
    "shared/records",
    "shared/surface",
    "shared/texture",
    "shared/textured",
    "shared/tiles",
    "shared/triangle",
    "shared/types",
    "shared/word_blocks",
    "shared/words_32",
    "shared/words_64",
    "shared/words_count",
    "shared/words_depth",
    "shared/workgroup_scan",
];

/// The source of a file; empty where there is none of that name.
fn source_of(name: &str) -> &'static str {
    SOURCES.iter().find(|(own, _)| *own == name).map_or("", |(_, source)| source)
}

/// What a file says at its head that it needs: other shared files, by their names without a folder, and what whoever includes
/// it declares.
fn needs(source: &str) -> impl Iterator<Item = &str> {
    let head = source.lines().take_while(|line| line.starts_with("//"));
    let line = head.filter_map(|line| line.strip_prefix("// Needs: ")).next().unwrap_or_default();
    line.trim_end_matches('.').split(", ").filter(|need| !need.is_empty())
}

/// Adds a file to a list, behind the shared files that it needs.
fn include(name: &'static str, files: &mut Vec<&'static str>) {
    if files.contains(&name) {
        return;
    }
    for shared in needs(source_of(name)).filter_map(|need| need.strip_suffix(".wgsl")) {
        let known = SOURCES.iter().find(|(own, _)| own.strip_prefix("shared/") == Some(shared));
        known.iter().for_each(|(shared, _)| include(shared, files));
    }
    files.push(name);
}

/// Whether WGSL declares a name for all functions.
fn declares(source: &str, name: &str) -> bool {
    source.lines().any(|line| {
        let Some(at) = line.find(name) else { return false };
        let (before, after) = (&line[..at], &line[at + name.len()..]);
        let item = before.starts_with("@group")
            || ["var", "const ", "fn ", "struct ", "override "].iter().any(|k| before.starts_with(k));
        item && before.ends_with(' ') && !after.starts_with(|c: char| c.is_alphanumeric() || c == '_')
    })
}

impl Kernel {
    /// Place in [`KERNELS`], or in [`DRAWS`].
    pub fn number(self) -> usize {
        let place = |kernels: &[Self]| kernels.iter().position(|k| *k == self);
        place(&KERNELS).or_else(|| place(&DRAWS)).unwrap_or(KERNELS.len())
    }

    /// Name of its file.
    pub fn name(self) -> &'static str {
        match self {
            Self::InstanceCull => "instance_cull",
            Self::ClearGroups => "clear_groups",
            Self::NodeCull(_) => "node_cull",
            Self::CountBits(_) => "count_bits",
            Self::ScanBlocks(_) => "scan_blocks",
            Self::ListGroups(_) => "list_groups",
            Self::ClusterCull(_) => "cluster_cull",
            Self::ListClusters(_) => "list_clusters",
            Self::RasterSmall(_) => "raster_small",
            Self::RasterLarge(_) | Self::RasterAlphaTested(_) => "raster_large",
            Self::RasterHardware(..) => "raster_hardware",
            Self::Hzb(_) => "hzb",
            Self::PrepareIndirect(_) => "prepare_indirect",
            Self::Renumber => "renumber",
            Self::CountCovered => "count_covered",
            Self::Shade(..) => "shade",
            Self::Output(_) => "output",
            Self::LoopProbe => "loop_probe",
        }
    }

    /// The shared files that its own does not name, since they depend on the kernel.
    fn variants(self) -> Vec<&'static str> {
        let words = |words| match words {
            Words::Int64 => "shared/words_64",
            Words::Keys | Words::Lows => "shared/words_32",
            Words::Count => "shared/words_count",
            Words::Depth => "shared/words_depth",
        };
        match self {
            Self::RasterSmall(form) | Self::RasterHardware(_, form) => vec![words(form)],
            Self::RasterLarge(form) => vec![words(form), "shared/opaque"],
            Self::RasterAlphaTested(form) => vec![words(form), "shared/alpha_test"],
            Self::Shade(_, kind, ibl) => {
                let kind = match kind {
                    MaterialKind::Plain => "shared/plain",
                    MaterialKind::Textured => "shared/textured",
                };
                let ibl = match ibl {
                    Ibl::Off => "shared/no_environment",
                    Ibl::On => "shared/environment",
                };
                vec![kind, ibl]
            }
            _ => Vec::new(),
        }
    }

    /// All files of its source, each behind those that it needs.
    fn files(self) -> Vec<&'static str> {
        let mut files = Vec::new();
        [&["shared/types"][..], &self.variants(), &[self.name()]]
            .concat()
            .into_iter()
            .for_each(|name| include(name, &mut files));
        files
    }

    /// What files of its source need and no other declares.
    pub fn undeclared(self) -> Vec<String> {
        let source = self.source(None);
        let files = self.files();
        let missing = |name: &'static str| {
            let unknown = |need: &&str| match need.strip_suffix(".wgsl") {
                Some(shared) => source_of(&format!("shared/{shared}")).is_empty(),
                None => !declares(&source, need),
            };
            needs(source_of(name)).filter(unknown).map(move |need| format!("{name}: {need}"))
        };
        files.into_iter().flat_map(missing).collect()
    }

    /// The set whose words it shares out among lanes, if any.
    fn scans(self) -> Option<Bits> {
        match self {
            Self::CountBits(bits) | Self::ScanBlocks(bits) => Some(bits),
            Self::ListGroups(_) => Some(Bits::Groups),
            Self::ListClusters(_) => Some(Bits::Clusters),
            _ => None,
        }
    }

    /// Values of `override` constants that others than a GPU go with.
    pub fn overrides_in_software(self) -> Vec<(&'static str, f64)> {
        // There a workgroup is a loop over its lanes, a few at a time, from one barrier to the next.
        let lanes = match self {
            Self::ClusterCull(_) => Some(("CULL_LANES", f64::from(GROUPS_PER_WORKGROUP))),
            Self::RasterSmall(_) => Some(("RASTER_LANES", 8.0)),
            _ if self.scans().is_some() => Some(("SCAN_LANES", 8.0)),
            _ => None,
        };
        // It divides as the CPU does.
        let exact = self.files().contains(&"shared/exact").then_some(("ROUNDS_TO_NEAREST", 1.0));
        lanes.into_iter().chain(exact).collect()
    }

    /// Whether it reads pages, so that it depends on how many arrays they lie in.
    pub fn reads_pages(self) -> bool {
        let files = self.files();
        files.contains(&"shared/pages") || files.contains(&"shared/records")
    }

    /// The whole source. With `array_bits`, pages lie in several arrays of 2^`array_bits` words.
    pub fn source(self, array_bits: Option<u32>) -> String {
        let mut source = constants();
        let arrays = if array_bits.is_some() { PAGE_ARRAYS } else { 1 };
        source += &format!("const PAGE_ARRAYS: u32 = {arrays}u;\n");
        source += &format!("const PAGE_ARRAY_BITS: u32 = {}u;\n", array_bits.unwrap_or(u32::BITS - 1));
        if let Self::RasterSmall(words)
        | Self::RasterLarge(words)
        | Self::RasterAlphaTested(words)
        | Self::RasterHardware(_, words) = self
        {
            let first = matches!(words, Words::Int64 | Words::Keys | Words::Depth);
            source += &format!("const FIRST_PASS: bool = {first};\n");
        }
        if let Self::Shade(output, ..) | Self::Output(output) = self {
            let (number, rgb, surface) = (output as u32, output.rgb(), output.surface());
            source += &format!("const OUTPUT: u32 = {number}u;\nconst OUTPUT_RGB: bool = {rgb};\n");
            source += &format!("const OUTPUT_SURFACE: bool = {surface};\n");
        }
        source += &format!("const ALPHA_TESTED: bool = {};\n", matches!(self, Self::RasterAlphaTested(_)));
        if let Self::RasterHardware(list, _) = self {
            source += &format!("const LIST: u32 = {}u;\n", list as u32);
        }
        if let Self::CountBits(bits) = self {
            source += &format!("const SPARSE: bool = {};\n", bits == Bits::Groups);
        }
        if let Some(bits) = self.scans() {
            source += &format!("const SCAN_BLOCK: u32 = {}u;\n", bits.block());
        }
        if let Self::Hzb(round) = self {
            source += &format!("const PYRAMID_DISPATCH: u32 = {round}u;\n");
        }
        let second = matches!(
            self,
            Self::NodeCull(CullPass::Second)
                | Self::ListGroups(CullPass::Second)
                | Self::ClusterCull(CullPass::Second)
                | Self::ListClusters(CullPass::Second)
                | Self::PrepareIndirect(CullPass::Second)
        );
        source += &format!("const SECOND: bool = {second};\n");
        source + &self.files().into_iter().map(source_of).collect::<Vec<_>>().join("\n")
    }
}

/// The constants of `limits.rs` and the layout of cluster records, as WGSL.
pub fn constants() -> String {
    let whole = [
        ("WIDTH", WIDTH),
        ("SCAN_WIDTH", SCAN_WIDTH),
        ("SCAN_ROW", SCAN_ROW),
        ("GROUP_BLOCK", Bits::Groups.block()),
        ("CLUSTER_BLOCK", Bits::Clusters.block()),
        ("MAX_WORKGROUPS", MAX_WORKGROUPS),
        ("GROUPS_PER_WORKGROUP", GROUPS_PER_WORKGROUP),
        ("CLUSTER_MAX_TRIANGLES", CLUSTER_MAX_TRIANGLES as u32),
        ("CLUSTER_MAX_VERTICES", CLUSTER_MAX_VERTICES as u32),
        ("PAGE_SLOT_BITS", PAGE_SLOT_BITS),
        ("ABSENT", ABSENT),
        ("SUBPIXEL_BITS", SUBPIXEL_BITS),
        ("TRIANGLE_BITS", TRIANGLE_BITS),
        ("MAX_SPAN", u32::from(MAX_SPAN)),
        ("UNKNOWN_SPAN", u32::from(u16::MAX)),
        ("RECORD_WORDS", RECORD_WORDS as u32),
        ("NONE", u32::MAX),
        ("PYRAMID_LEVELS", PYRAMID_LEVELS as u32),
        ("PYRAMID_REACH", u32::from(PYRAMID_REACH)),
        ("PYRAMID_FINER", PYRAMID_FINER as u32),
        ("PYRAMID_ABOVE", PYRAMID_ABOVE),
        ("LEVELS_PER_DISPATCH", LEVELS_PER_DISPATCH),
        ("PYRAMID_SIDE", PYRAMID_SIDE),
        ("PIXELS_PER_LANE", PIXELS_PER_LANE),
        ("TILES", TILES as u32),
        ("LISTS", List::COUNT),
        ("LIST_SMALL", List::Small as u32),
        ("LIST_LARGE", List::Large as u32),
        ("LIST_CLIPPED", List::Clipped as u32),
        ("LIST_ALPHA_TESTED", List::AlphaTested as u32),
        ("HISTORY_LIST", HISTORY_LIST),
        ("INDIRECT_ENTRIES", IndirectEntry::COUNT),
        ("INDIRECT_GROUPS", IndirectEntry::Groups.number()),
        ("INDIRECT_PIXELS", IndirectEntry::Pixels.number()),
        ("INDIRECT_PYRAMID", IndirectEntry::Pyramid(0).number()),
        ("MATERIAL_SMOOTH", MATERIAL_SMOOTH),
        ("MATERIAL_UNLIT", MATERIAL_UNLIT),
        ("MATERIAL_CONFORMAL", MATERIAL_CONFORMAL),
        ("MATERIAL_COLOR_WORDS", MATERIAL_COLOR_WORDS),
        ("SLOTS", Slot::COUNT as u32),
        ("SLOT_BASE_COLOR", Slot::BaseColor as u32),
        ("SLOT_METALLIC_ROUGHNESS", Slot::MetallicRoughness as u32),
        ("SLOT_NORMAL", Slot::Normal as u32),
        ("SLOT_OCCLUSION", Slot::Occlusion as u32),
        ("SLOT_EMISSIVE", Slot::Emissive as u32),
        ("TEXTURE_WRAP", TEXTURE_WRAP),
        ("TEXTURE_LINEAR", TEXTURE_LINEAR),
        ("TEXTURE_MIPMAPS", TEXTURE_MIPMAPS),
        ("TEXTURE_FORMAT", TEXTURE_FORMAT),
        ("WRAP_REPEAT", Wrap::Repeat as u32),
        ("WRAP_MIRROR", Wrap::Mirror as u32),
        ("MIPMAPS_OFF", Mipmaps::Off as u32),
        ("MIPMAPS_LINEAR", Mipmaps::Linear as u32),
        ("FORMAT_SRGB_8", TexelFormat::Srgb8 as u32),
        ("FORMAT_HALF", TexelFormat::Half as u32),
        ("FORMAT_ENCODED_8", TexelFormat::Encoded8 as u32),
        ("BYTE_STEPS", BYTE_STEPS as u32),
        ("GRIDS", GRIDS as u32),
        ("IRRADIANCE", IRRADIANCE as u32),
        ("ROUGHNESS_LEVELS", ROUGHNESS_LEVELS as u32),
        ("ALBEDO_SIDE", ALBEDO_SIDE as u32),
        ("SHADING_GLTF", Shading::Gltf as u32),
        ("SHADING_PYRENDER", Shading::Pyrender as u32),
        ("SHADING_FLAT", Shading::Flat as u32),
        ("SHADING_NORMALS", Shading::Normals as u32),
        ("CORNER_BITS", CORNER_BITS),
        ("WIDE_CORNER_BITS", WIDE_CORNER_BITS),
    ];
    let fields = [
        ("RECORD_CENTER", offset_of!(ClusterRecord, center)),
        ("RECORD_RADIUS", offset_of!(ClusterRecord, radius)),
        ("RECORD_EXTENT", offset_of!(ClusterRecord, extent)),
        ("RECORD_CONE", offset_of!(ClusterRecord, cone)),
        ("RECORD_LOD_SPHERE", offset_of!(ClusterRecord, lod_sphere)),
        ("RECORD_ERROR", offset_of!(ClusterRecord, error)),
        ("RECORD_COUNTS", offset_of!(ClusterRecord, vertex_count)),
        ("RECORD_DATA", offset_of!(ClusterRecord, data)),
        ("RECORD_GROUP", offset_of!(ClusterRecord, group)),
        ("RECORD_MATERIAL", offset_of!(ClusterRecord, material)),
        ("RECORD_REFINED", offset_of!(ClusterRecord, refined)),
        ("PACKING_WIDTHS", offset_of!(Packing, widths)),
        ("PACKING_STEP", offset_of!(Packing, step)),
        ("PACKING_WORDS", size_of::<Packing>()),
    ];
    let real = [
        ("GUARD_BAND", GUARD_BAND),
        ("FOOTPRINT_MARGIN", FOOTPRINT_MARGIN),
        ("FOOTPRINT_ROUNDING", FOOTPRINT_ROUNDING),
        ("SMALL_EDGE", SMALL_EDGE),
        ("LEAST_MARGIN", LEAST_MARGIN),
        ("SMALLEST", f32::MIN_POSITIVE),
        ("LARGEST", f32::MAX),
    ];
    let outputs = OUTPUTS
        .map(|output| format!("const OUTPUT_{}: u32 = {}u;\n", output.name().to_uppercase(), output as u32));
    let whole = whole.map(|(name, value)| format!("const {name}: u32 = {value}u;\n"));
    let fields = fields.map(|(name, bytes)| format!("const {name}: u32 = {}u;\n", bytes / 4));
    let real = real.map(|(name, value)| format!("const {name}: f32 = {value:?}f;\n"));
    [whole.concat(), fields.concat(), real.concat(), outputs.concat()].concat()
}
