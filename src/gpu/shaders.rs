//! WGSL sources: constants that Rust has, shared files and the kernel's own, one after the other.

use std::mem::offset_of;

use super::kernel::{Constant, Kernel, MAX_WORKGROUPS, WIDTH};
use super::lists::{Bits, GROUPS_PER_WORKGROUP, IndirectEntry, LEVELS_PER_DISPATCH, List, SCAN_WIDTH};

use crate::config::{OUTPUTS, Shading};
use crate::gpu_types::{
    ABSENT, HISTORY_LIST, HISTORY_PAGES, MATERIAL_COLOR_WORDS, MATERIAL_CONFORMAL, MATERIAL_SHADOWED,
    MATERIAL_SMOOTH, MATERIAL_UNLIT, QUAD, SEEN_BY_LIGHTS, SEEN_BY_VIEWS, SHADOW_CUBE, SHADOW_NONE,
    SHADOW_PARALLEL, SHADOW_SPOT, ShadowLight, TEXTURE_FORMAT, TEXTURE_LINEAR, TEXTURE_MIPMAPS, TEXTURE_WRAP,
    TILES,
};
use crate::limits::{
    CLUSTER_MAX_TRIANGLES, CLUSTER_MAX_VERTICES, DIELECTRIC_F0, FOOTPRINT_MARGIN, FOOTPRINT_ROUNDING,
    FOOTPRINT_SLACK, GUARD_BAND, LEAST_COSINE, LEAST_ROUGHNESS, LOG2_BEND, LONGEST_FOOTPRINT, MAX_SPAN,
    PAGE_SLOT_BITS, PYRAMID_ABOVE, PYRAMID_FINER, PYRAMID_LEVELS, PYRAMID_REACH, SHADOW_BAND_STEPS,
    SHADOW_BLOCK_PAGES, SHADOW_BOUNDED_LEVELS, SHADOW_COLUMN_BITS, SHADOW_CORNERS, SHADOW_FACE_BITS,
    SHADOW_FEW_CLUSTERS, SHADOW_GRID_PAGES, SHADOW_LEAN, SHADOW_LEAST_COSINE, SHADOW_LEVEL_BITS,
    SHADOW_LEVELS, SHADOW_LEVELS_APART, SHADOW_MARGIN, SHADOW_MOST_ACROSS, SHADOW_NEAREST, SHADOW_PAGE_SIDE,
    SHADOW_PAGE_TEXELS, SHADOW_ROUNDING, SHADOW_SIDE, SHADOW_SLOT_WORDS, SHADOW_SNAP, SHADOW_SOFT_BANDS,
    SHADOW_SOFT_STEP, SHADOW_SOFT_TEXELS, SHADOW_TEXEL_REACH, SHADOW_TILE_SIDE, SHADOW_TILES, SMALL_EDGE,
    SNAP_ROUNDER, SUBPIXEL_BITS, TRIANGLE_BITS,
};
use crate::math::bounds::CONE_STEPS;
use crate::math::double_single::SPLITTER;
use crate::math::octahedral::OCTAHEDRAL_STEPS;
use crate::math::project::LEAST_MARGIN;
use crate::model::cluster::RECORD_WORDS;
use crate::model::packing::{CORNER_BITS, WIDE_CORNER_BITS};
use crate::model::{ClusterRecord, ColorFormat, Packing};
use crate::scene::albedo::ALBEDO_SIDE;
use crate::scene::environment::{GRIDS, IRRADIANCE, ROUGHNESS_LEVELS};
use crate::scene::image::TexelFormat;
use crate::scene::texture::{Mipmaps, Wrap};
use crate::scene::transfer::BYTE_STEPS;
use crate::scene::{Slot, palette};

/// Lanes whose values each of them adds up by itself.
const SCAN_ROW: u32 = 16;
/// Arrays that the pages of all meshes may lie in.
pub const PAGE_ARRAYS: usize = 4;
/// Bytes that a kernel reads of a record at a time; pages start at multiples of it.
const QUAD_BYTES: usize = size_of::<[u32; QUAD as usize]>();
/// Pixels that a lane gives new numbers, or counts.
pub const PIXELS_PER_LANE: u32 = 16;
/// Side of a workgroup that makes a part of the depth pyramid: each lane begins with two by two texels, each level leaves a
/// quarter of the lanes, and the last one.
const PYRAMID_SIDE: u32 = 1 << (LEVELS_PER_DISPATCH - 1);

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
    "shadow_hidden",
    "shadow_mark",
    "shadow_raster",
    "shadow_tiles",
    "shadow_test",
    "write_runs",
    "shared/alpha_test",
    "shared/append",
    "shared/bsdf",
    "shared/cluster_bounds",
    "shared/cone",
    "shared/cull",
    "shared/defer",
    "shared/derive",
    "shared/double_single",
    "shared/environment",
    "shared/exact",
    "shared/group_bits",
    "shared/hash",
    "shared/int64",
    "shared/key",
    "shared/lod",
    "shared/material",
    "shared/no_environment",
    "shared/no_shadow",
    "shared/occlusion",
    "shared/one_view",
    "shared/opaque",
    "shared/page_views",
    "shared/pages",
    "shared/frame_bindings",
    "shared/places",
    "shared/plain",
    "shared/receiver",
    "shared/receiver_error",
    "shared/records",
    "shared/seen",
    "shared/shadow",
    "shared/shadow_march",
    "shared/shadow_pages",
    "shared/shadow_range",
    "shared/shadow_receiver",
    "shared/shadow_soft",
    "shared/shadow_view",
    "shared/surface",
    "shared/texture",
    "shared/target",
    "shared/textured",
    "shared/tiles",
    "shared/triangle",
    "shared/types",
    "shared/unproject",
    "shared/vertex",
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

impl Constant {
    /// As WGSL.
    fn declaration(self) -> String {
        match self {
            Self::None => String::new(),
            Self::Flag(name, value) => format!("const {name}: bool = {value};\n"),
            Self::Number(name, value) => format!("const {name}: u32 = {value}u;\n"),
        }
    }
}

impl Kernel {
    /// All files of its source, each behind those that it needs.
    fn files(self) -> Vec<&'static str> {
        let mut files = Vec::new();
        let own = ["shared/types"].into_iter().chain(self.variants.into_iter().flatten()).chain([self.file]);
        own.for_each(|name| include(name, &mut files));
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

    /// Values of `override` constants that others than a GPU go with.
    pub fn overrides_in_software(self) -> Vec<(&'static str, f64)> {
        // It divides as the CPU does.
        self.files().contains(&"shared/exact").then_some(("ROUNDS_TO_NEAREST", 1.0)).into_iter().collect()
    }

    /// The whole source. With `array_bits`, pages lie in several arrays of 2^`array_bits` words.
    pub fn source(self, array_bits: Option<u32>) -> String {
        let arrays = if array_bits.is_some() { PAGE_ARRAYS as u32 } else { 1 };
        let pages = [
            Constant::Number("PAGE_ARRAYS", arrays),
            Constant::Number("PAGE_ARRAY_BITS", array_bits.unwrap_or(u32::BITS - 1)),
        ];
        let own = pages.into_iter().chain(self.constants).map(Constant::declaration);
        let files = self.files().into_iter().map(source_of);
        let constants = constants() + &own.collect::<String>();
        constants + &files.collect::<Vec<_>>().join("\n")
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
        ("HISTORY_PAGES", HISTORY_PAGES),
        ("SEEN_BY_VIEWS", SEEN_BY_VIEWS),
        ("SEEN_BY_LIGHTS", SEEN_BY_LIGHTS),
        ("SHADOW_CORNERS", SHADOW_CORNERS),
        ("SHADOW_BLOCK_PAGES", SHADOW_BLOCK_PAGES),
        ("SHADOW_COLUMN_BITS", SHADOW_COLUMN_BITS),
        ("SHADOW_GRID_PAGES", SHADOW_GRID_PAGES as u32),
        ("INDIRECT_ENTRIES", IndirectEntry::COUNT),
        ("INDIRECT_GROUPS", IndirectEntry::Groups.number()),
        ("INDIRECT_PIXELS", IndirectEntry::Pixels.number()),
        ("INDIRECT_PYRAMID", IndirectEntry::Pyramid(0).number()),
        ("MATERIAL_SMOOTH", MATERIAL_SMOOTH),
        ("MATERIAL_UNLIT", MATERIAL_UNLIT),
        ("MATERIAL_CONFORMAL", MATERIAL_CONFORMAL),
        ("MATERIAL_SHADOWED", MATERIAL_SHADOWED),
        ("MATERIAL_COLOR_WORDS", MATERIAL_COLOR_WORDS),
        ("SHADOW_NONE", SHADOW_NONE),
        ("SHADOW_PARALLEL", SHADOW_PARALLEL),
        ("SHADOW_SPOT", SHADOW_SPOT),
        ("SHADOW_CUBE", SHADOW_CUBE),
        ("SHADOW_LIGHT_QUADS", (size_of::<ShadowLight>() / QUAD_BYTES) as u32),
        ("SHADOW_PAGE_SIDE", SHADOW_PAGE_SIDE),
        ("SHADOW_PAGE_TEXELS", SHADOW_PAGE_TEXELS as u32),
        ("SHADOW_SIDE", SHADOW_SIDE),
        ("SHADOW_TILE_SIDE", SHADOW_TILE_SIDE),
        ("SHADOW_TILES", SHADOW_TILES as u32),
        ("SHADOW_FEW_CLUSTERS", SHADOW_FEW_CLUSTERS),
        ("SHADOW_SLOT_WORDS", SHADOW_SLOT_WORDS as u32),
        ("SHADOW_FACE_BITS", SHADOW_FACE_BITS),
        ("SHADOW_LEVEL_BITS", SHADOW_LEVEL_BITS),
        ("SHADOW_TAG_BITS", SHADOW_FACE_BITS + SHADOW_LEVEL_BITS),
        ("SHADOW_BOUNDED_LEVELS", SHADOW_BOUNDED_LEVELS),
        ("SHADOW_LEVELS", SHADOW_LEVELS),
        ("SHADOW_LEVELS_APART", SHADOW_LEVELS_APART),
        ("SHADOW_SOFT_TEXELS", SHADOW_SOFT_TEXELS),
        ("SHADOW_SOFT_BANDS", SHADOW_SOFT_BANDS),
        ("SHADOW_BAND_STEPS", SHADOW_BAND_STEPS),
        ("SHADOW_BAND_STEPS_LOG2", SHADOW_BAND_STEPS.ilog2()),
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
        ("HASH_SEED", palette::HASH_SEED),
        ("HASH_FACTOR_0", palette::HASH_FACTORS[0]),
        ("HASH_FACTOR_1", palette::HASH_FACTORS[1]),
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
    let list = |name: &str, values: &[f32]| {
        let value = |(k, v): (usize, &f32)| format!("const {name}_{k}: f32 = {v:?}f;\n");
        values.iter().enumerate().map(value).collect::<String>()
    };
    let lists = [
        list("LOG2_BEND", &LOG2_BEND),
        list("HUE_VALUE", &palette::HUE_VALUE),
        list("HUE_SATURATION", &palette::HUE_SATURATION),
        list("RAMP_VALUE", &palette::RAMP_VALUE),
        list("FACING", &palette::FACING),
    ];
    let real = [
        ("GUARD_BAND", GUARD_BAND),
        ("FOOTPRINT_MARGIN", FOOTPRINT_MARGIN),
        ("FOOTPRINT_ROUNDING", FOOTPRINT_ROUNDING),
        ("SMALL_EDGE", SMALL_EDGE),
        ("LEAST_MARGIN", LEAST_MARGIN),
        ("FOOTPRINT_SLACK", FOOTPRINT_SLACK),
        ("SHADOW_MARGIN", SHADOW_MARGIN),
        ("SHADOW_MOST_ACROSS", SHADOW_MOST_ACROSS),
        ("SNAP_ROUNDER", SNAP_ROUNDER),
        ("SPLITTER", SPLITTER),
        ("CONE_STEPS", CONE_STEPS as f32),
        ("OCTAHEDRAL_STEPS", OCTAHEDRAL_STEPS),
        ("LONGEST_FOOTPRINT", LONGEST_FOOTPRINT),
        ("DIELECTRIC_F0", DIELECTRIC_F0),
        ("LEAST_ROUGHNESS", LEAST_ROUGHNESS),
        ("LEAST_COSINE", LEAST_COSINE),
        ("SHADOW_TEXEL_REACH", SHADOW_TEXEL_REACH),
        ("SHADOW_SNAP", SHADOW_SNAP),
        ("SHADOW_ROUNDING", SHADOW_ROUNDING),
        ("SHADOW_SOFT_STEP", SHADOW_SOFT_STEP),
        ("SHADOW_LEAST_COSINE", SHADOW_LEAST_COSINE),
        ("SHADOW_NEAREST", SHADOW_NEAREST),
        ("SHADOW_LEAN", SHADOW_LEAN),
        ("RAMP_SIXTHS", palette::RAMP_SIXTHS),
        ("RAMP_LEVELS", palette::RAMP_LEVELS),
        ("SMALLEST", f32::MIN_POSITIVE),
        ("LARGEST", f32::MAX),
        ("UNORM_8", ColorFormat::Unorm8.one()),
        ("UNORM_16", ColorFormat::Unorm16.one()),
    ];
    let outputs = OUTPUTS
        .map(|output| format!("const OUTPUT_{}: u32 = {}u;\n", output.name().to_uppercase(), output as u32));
    let whole = whole.map(|(name, value)| format!("const {name}: u32 = {value}u;\n"));
    let fields = fields.map(|(name, bytes)| format!("const {name}: u32 = {}u;\n", bytes / 4));
    let real = real.map(|(name, value)| format!("const {name}: f32 = {value:?}f;\n"));
    [whole.concat(), fields.concat(), real.concat(), lists.concat(), outputs.concat()].concat()
}
