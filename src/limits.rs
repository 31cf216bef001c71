//! Every constant that more than one stage, or Rust and WGSL, must agree on. One home each.

/// Most triangles a cluster holds. A triangle's number inside its cluster takes [`TRIANGLE_BITS`].
pub const CLUSTER_MAX_TRIANGLES: usize = 128;
/// Most vertices a cluster holds, so that a corner is one byte and 255 stays free as a sentinel.
pub const CLUSTER_MAX_VERTICES: usize = 255;
/// Most clusters a group holds, so that a group always fits one page.
pub const GROUP_MAX_CLUSTERS: usize = 32;
/// Levels of groups at most; a mesh of 2^30 triangles takes about 25. What is left then stays a root.
pub const MAX_LEVELS: u32 = 255;
/// Children of a hierarchy node.
pub const NODE_WIDTH: usize = 8;
/// Nodes on the way from the root to a group at most. A device takes a pass for each; those that are built stay below
/// 80, 64 of them for [`MAX_LEVELS`] levels.
pub const NODE_MAX_DEPTH: u16 = 128;

/// Bytes of a page at most. A page holds whole groups, of one level but for root pages.
pub const PAGE_MAX_BYTES: usize = 128 * 1024;
/// Bytes of a root page at most: of each mesh of a scene one at least is always there.
pub const ROOT_PAGE_MAX_BYTES: usize = 32 * 1024;
/// Bits of a cluster address that number the slot inside its page; the rest number the page.
pub const PAGE_SLOT_BITS: u32 = 8;
/// Clusters of a page at most.
pub const PAGE_MAX_CLUSTERS: usize = 1 << PAGE_SLOT_BITS;

/// Sub-pixel bits of every rasterizer: vertices snap to 1/256 pixel.
pub const SUBPIXEL_BITS: u32 = 8;
/// Low bits of a visibility word: the triangle inside its cluster.
pub const TRIANGLE_BITS: u32 = 7;
/// Next bits of a visibility word: 1 + the index in the frame's visible list (0 is background).
pub const VISIBLE_BITS: u32 = 25;
/// Views whose history is kept, besides those of a call.
pub const MAX_HISTORIES: usize = 64;

/// Most visible clusters of a frame.
pub const MAX_VISIBLE: usize = (1 << VISIBLE_BITS) - 1;

/// Parts of assemblies that a frame draws one by one at most: some two gigabytes.
pub const MAX_PARTS: usize = 1 << 22;

/// Assemblies inside of each other at most.
pub const ASSEMBLY_DEPTH: usize = 32;

/// Screen coordinates beyond this many pixels are clipped, so that edge functions stay in range and snapping to 1/256
/// pixel stays exact.
pub const GUARD_BAND: f32 = 16_000.0;
/// Relative rounding of a sum of three products in f32, twice over: a box corner and a vertex.
pub const FOOTPRINT_ROUNDING: f32 = 1.0e-6;
/// Pixels by which a box on the screen is widened: snapping moves a corner by 1/512, and rounding by less than 1/64
/// inside the guard band.
pub const FOOTPRINT_MARGIN: f32 = 1.0 / 16.0;
/// Depths may be rounded by this part of the nearest at most, where the corners of a box are projected one by one.
pub const FOOTPRINT_SLACK: f32 = 1.0e-3;
/// Adding this to an f32 below 2²² in size leaves its nearest integer in the low bits.
pub const SNAP_ROUNDER: f32 = 12_582_912.0;
/// Longest side, pixels, of a cluster on the screen for the small rasterizer: with it, products of two snapped
/// differences and their difference fit 32 bits.
pub const MAX_SPAN: u16 = 120;
/// Longest edge, pixels, at which a triangle still is for the small rasterizer.
pub const SMALL_EDGE: f32 = 16.0;

/// Levels of a depth pyramid at most: that of 65,536 × 65,536 pixels, which are the first level.
pub const PYRAMID_LEVELS: usize = 17;
/// Longest side, texels, of the block that a first test against the pyramid reads.
pub const PYRAMID_REACH: u16 = 4;
/// Where the first test does not hide a box, a second reads a level so much finer.
pub const PYRAMID_FINER: usize = 2;
/// Fewer triangles than this are drawn at once: a depth pyramid costs more than it could save.
pub const PYRAMID_ABOVE: u32 = 1 << 15;

const _: () = {
    let side = (MAX_SPAN as i64 + 2) << SUBPIXEL_BITS;
    assert!(2 * side * side < i32::MAX as i64);
};
const _: () = assert!(CLUSTER_MAX_TRIANGLES == 1 << TRIANGLE_BITS);
const _: () = assert!(TRIANGLE_BITS + VISIBLE_BITS == 32);
const _: () = assert!(GROUP_MAX_CLUSTERS <= PAGE_MAX_CLUSTERS);

/// Squared texels that no footprint of a texture is longer than.
pub const LONGEST_FOOTPRINT: f32 = 1.0e30;
/// Coefficients of the polynomial of the logarithm of texture footprints, that of the cube first.
pub const LOG2_BEND: [f32; 4] = [-0.044_004_69, 0.146_314_34, -0.266_029_9, 0.441_740_3];

/// What a dielectric reflects where light meets it head on, as glTF has it.
pub const DIELECTRIC_F0: f32 = 0.04;
/// The least perceptual roughness that is shaded.
pub const LEAST_ROUGHNESS: f32 = 0.04;
/// The least cosine, and the least denominator, of pyrender's reflections.
pub const LEAST_COSINE: f32 = 0.001;

/// Layers of blended surfaces of a picture at most.
pub const MAX_LAYERS: u32 = 256;

/// Texels of a side of a page of a shadow map.
pub const SHADOW_PAGE_SIDE: u32 = 128;
/// Texels of a page.
pub const SHADOW_PAGE_TEXELS: usize = (SHADOW_PAGE_SIDE * SHADOW_PAGE_SIDE) as usize;
/// Texels of a side of a shadow map that has an end, and of the slab in which a page of one without measures depths.
pub const SHADOW_SIDE: u32 = 1 << 14;
/// Pages of a side of a block, for which casters are culled together: its texels are inside the guard band.
pub const SHADOW_BLOCK_PAGES: u32 = 64;
/// Corners of a block's grid of pages on a side.
pub const SHADOW_CORNERS: u32 = SHADOW_BLOCK_PAGES + 1;
/// Where the pages begin in a block's grid, behind the sums of its corners.
pub const SHADOW_GRID_PAGES: usize = (SHADOW_CORNERS * SHADOW_CORNERS).next_multiple_of(4) as usize;
/// Words of a block's grid.
pub const SHADOW_GRID_WORDS: usize = SHADOW_GRID_PAGES + (SHADOW_BLOCK_PAGES * SHADOW_BLOCK_PAGES) as usize;
/// Texels between a point and the middle of the texel that it falls into, half a diagonal at most, and what snapping
/// moves a caster by.
pub const SHADOW_TEXEL_REACH: f32 = 0.712;
/// Pixels by which snapping moves a receiver, and what rounds its place on the picture.
pub const SHADOW_SNAP: f32 = 1.0 / 128.0;
/// Rounding of a receiver's place, of a caster's, and of what is subtracted: a part of the lengths they are sums of.
pub const SHADOW_ROUNDING: f32 = 1.0 / (1 << 20) as f32;
const _: () = assert!((SHADOW_BLOCK_PAGES * SHADOW_PAGE_SIDE) as f32 <= GUARD_BAND);
/// Texels of a side of a tile of a page, of which the nearest and the farthest depth are known.
pub const SHADOW_TILE_SIDE: u32 = 8;
/// Texels that the outermost rays to a light with a size go to the side in a level before they go on in the next one.
pub const SHADOW_SOFT_TEXELS: u32 = 8;
/// Bands that a ray climbs at most, in each of which the outermost goes as far to the side as before.
pub const SHADOW_SOFT_BANDS: u32 = 30;
/// Texels by which what a ray passes under may fall from one texel to the next, and still be one surface.
pub const SHADOW_SOFT_STEP: f32 = 4.0;
/// Steps of a ray in a band, where it is as many texels wide: half of those that it goes to the side.
pub const SHADOW_BAND_STEPS: u32 = SHADOW_SOFT_TEXELS / 2;
/// Cascades of a view.
pub const SHADOW_CASCADES: usize = 4;
/// Pages of a side of a cascade at most.
pub const SHADOW_CASCADE_PAGES: u32 = 16;
/// Side, pixels, of the tiles of a picture that are told together where they lie as seen from a light.
pub const SHADOW_PRISM_SIDE: usize = 16;
/// Rays to a light at most.
pub const SHADOW_SAMPLES_MAX: u32 = 256;
/// The cosine below which what texels do to a slope is no longer made up for along the way to a light with a size.
pub const SHADOW_LEAST_COSINE: f32 = 0.125;
/// Rays end so near to a light with a position: its radius times this is what is left of the way, in parts of it.
pub const SHADOW_NEAREST: f32 = 1.0 / 64.0;
/// A receiver's surface may rise so many times as fast to the side as where it is.
pub const SHADOW_LEAN: f32 = 2.0;
/// Levels of a shadow map that has an end: the coarsest is one page.
pub const SHADOW_BOUNDED_LEVELS: u32 = (SHADOW_SIDE / SHADOW_PAGE_SIDE).ilog2() + 1;
/// Levels of a shadow map without an end that a frame may use.
pub const SHADOW_LEVELS: u32 = 64;
/// For so many levels that shadow texels are coarser, levels that are used lie one more apart.
pub const SHADOW_LEVELS_APART: u32 = 3;
/// Tiles of a page.
pub const SHADOW_TILES: usize = SHADOW_PAGE_TEXELS / (SHADOW_TILE_SIDE * SHADOW_TILE_SIDE) as usize;
/// Words of a page in the pool of a device: its texels' keys row by row, the least and the largest key of each tile, and of
/// all. Slots are as far apart as parts of a buffer have to be that are bound by themselves.
pub const SHADOW_SLOT_WORDS: usize = (SHADOW_PAGE_TEXELS + 2 * (SHADOW_TILES + 1)).next_multiple_of(64);
/// Low bits of a level, and of a cube's face, in an entry of a page table of a device.
pub const SHADOW_FACE_BITS: u32 = 3;
/// Bits of the level above them; levels are counted from -2 to the power of one bit less.
pub const SHADOW_LEVEL_BITS: u32 = 8;
/// Clusters of a page of a shadow map that are drawn in one pass: of so few none is looked at for being hidden.
pub const SHADOW_FEW_CLUSTERS: u32 = 16;
/// How far receivers may be moved is taken times this where pages are marked, for the rounding of what is done with it.
pub const SHADOW_MARGIN: f32 = 1.02;
/// Pages across which a receiver may be, where its cut is that much coarser than a pixel: more are more than there is room for,
/// and all levels become coarser.
pub const SHADOW_MOST_ACROSS: f32 = 64.0;
/// Bits of the row and of the column of a page as a device marks them.
pub const SHADOW_COLUMN_BITS: u32 = 13;
const _: () = assert!(SHADOW_LEVELS.ilog2() + 2 * SHADOW_COLUMN_BITS == u32::BITS);
const _: () = assert!(
    6 * SHADOW_BOUNDED_LEVELS <= SHADOW_LEVELS && SHADOW_SIDE / SHADOW_PAGE_SIDE <= 1 << SHADOW_COLUMN_BITS
);
