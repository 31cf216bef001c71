//! Plain structs that Rust writes and shaders read, or the other way round; `shaders/shared/types.wgsl` has the same
//! by the same names, and a test compares the offsets.

pub mod array;

pub use array::Array;

use bytemuck::{Pod, Zeroable};

use crate::limits::PYRAMID_LEVELS;
use crate::math::Sphere;

/// What [`View::history`] is where there is a list.
pub const HISTORY_LIST: u32 = 2;

/// What [`View::history`] is where pages of a shadow map are drawn: in place of a pyramid there is a table of them.
pub const HISTORY_PAGES: u32 = 3;

/// Bits of [`InstanceTransform::visible`]: views see it, lights do.
pub const SEEN_BY_VIEWS: u32 = 1;
/// See [`SEEN_BY_VIEWS`].
pub const SEEN_BY_LIGHTS: u32 = 2;

/// What the table has for a page that is not there.
pub const ABSENT: u32 = u32::MAX;

/// Words that culling reads at a time, and that what it reads lies at multiples of.
pub const QUAD: u32 = 4;

/// Tiles across and down a picture at most, one bit each.
pub const TILES: usize = u32::BITS as usize;

/// A view's constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct View {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// 1 for a parallel projection.
    pub orthographic: u32,
    /// Near distance.
    pub near: f32,
    /// Far distance; infinite when there is none.
    pub far: f32,
    /// Keys below this are beyond the far distance.
    pub far_key: u32,
    /// Threshold of the cut, pixels.
    pub tau: f32,
    /// Slots of instances.
    pub instances: u32,
    /// Always zero, which compilers of shaders cannot know.
    pub zero: u32,
    /// Levels of the depth pyramid; level 0 has the pixels, or no keys where those would be too many.
    pub levels: u32,
    /// What there is of an earlier frame: 0 nothing, 1 its pyramid, [`HISTORY_LIST`] also the list of what it drew, from
    /// which the first pass starts. Of shadow maps [`HISTORY_PAGES`].
    pub history: u32,
    /// Words of the bits of all groups.
    pub group_words: u32,
    /// Columns, rows and first key of each level of the pyramid, and how many keys lie from row to row. The last two are
    /// multiples of [`QUAD`].
    pub pyramid: [[u32; 4]; PYRAMID_LEVELS],
    /// Rows of the rotation from the world to camera space, and of the eye's place the high part.
    pub rotate: [[f32; 4]; 3],
    /// The direction of sight, world space.
    pub forward: [f32; 3],
    /// See [`crate::math::LodView::focal`].
    pub lod_focal: f32,
    /// The low part of the eye's place.
    pub low: [f32; 3],
    /// See [`crate::math::LodView::near`].
    pub lod_near: f32,
    /// Pixels per unit of tangent or per world unit.
    pub focal: [f32; 2],
    /// Where the optical axis meets the picture, pixels.
    pub center: [f32; 2],
    /// One over what is used for `focal`, up the picture for y.
    pub inverse_focal: [f32; 2],
    /// 1 where `rotate` reverses orientation.
    pub mirrored: u32,
    /// Side, pixels, of the viewport of the hardware rasterizer; 0 where it draws nothing.
    pub viewport: u32,
    /// Of what no earlier frame showed, the first pass draws what has this key or a larger one: what is near.
    pub occluders: u32,
    /// 1 where the visibility buffer has keys alone.
    pub depth_only: u32,
    /// See [`crate::math::LodView::widest`].
    pub lod_widest: f32,
    /// 1 with occlusion culling in two passes; then the second alone requests missing pages.
    pub two_passes: u32,
    /// Pixels to the right per unit of tangent up the picture.
    pub skew: f32,
    /// The word of its target that its pixels begin at.
    pub first_word: u32,
    /// Zero.
    pub unused_b: u32,
    /// Zero.
    pub unused_c: u32,
}

/// The transform of an instance, the same for all views.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct InstanceTransform {
    /// Rows of the linear map from internal space to the world, and of the origin's place the high part.
    pub linear: [[f32; 4]; 3],
    /// Rows of its inverse, and the low part.
    pub inverse: [[f32; 4]; 3],
    /// Centre of the box around the mesh, internal space.
    pub center: [f32; 3],
    /// See [`crate::math::LodView::scale`].
    pub lod_scale: f32,
    /// Half extents of that box, rounded up.
    pub extent: [f32; 3],
    /// Where the mesh's nodes start among those of all meshes.
    pub first_node: u32,
    /// Where its groups start.
    pub first_group: u32,
    /// Where its pages start in the table of pages.
    pub first_page: u32,
    /// Where the bits of the instance's groups start, words.
    pub group_words: u32,
    /// By material, one bit each, the last for all from there on: draws back faces too.
    pub double_sided: u32,
    /// 1 where the map reverses orientation.
    pub mirrored: u32,
    /// [`SEEN_BY_VIEWS`] and [`SEEN_BY_LIGHTS`]; 0 where nothing is.
    pub visible: u32,
    /// Which clusters are alpha-tested, by material in the same way.
    pub alpha_tested: u32,
    /// See [`crate::math::LodView::rounding`].
    pub rounding: f32,
}

/// The material of an instance, for shading: in the slot of its [`InstanceTransform`].
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct InstanceMaterial {
    /// Rows of the map of normals from internal space to the world, each with a component of the base colour.
    pub normal: [[f32; 4]; 3],
    /// Emitted light.
    pub emissive: [f32; 3],
    /// 0 dielectric to 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, as it is shaded.
    pub roughness: f32,
    /// [`MATERIAL_SMOOTH`], [`MATERIAL_CONFORMAL`], [`MATERIAL_UNLIT`], [`MATERIAL_SHADOWED`], [`MATERIAL_COLOR_WORDS`].
    pub flags: u32,
    /// Of an instance with textures or several materials, the first of these; otherwise `u32::MAX`.
    pub first_material: u32,
    /// How many follow that.
    pub last_material: u32,
}

/// A texture of a material.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Texture {
    /// Rows of the map from (u, v, 1) to the image in its sides, from its upper left corner; and the sides, texels.
    pub rows: [[f32; 4]; 2],
    /// Where the image starts, words; `u32::MAX` where there is no texture.
    pub start: u32,
    /// Levels of the image.
    pub levels: u32,
    /// UV set, and fields from [`TEXTURE_WRAP`] on.
    pub flags: u32,
    /// Most samples.
    pub anisotropy: f32,
}

/// First bit of [`Texture::flags`] of what is beyond the edges: two for u, two for v.
pub const TEXTURE_WRAP: u32 = 2;
/// Bit of [`Texture::flags`]: between texels.
pub const TEXTURE_LINEAR: u32 = 6;
/// First of two bits of [`Texture::flags`]: which levels are read.
pub const TEXTURE_MIPMAPS: u32 = 7;
/// First of two bits of [`Texture::flags`]: how a texel lies in memory.
pub const TEXTURE_FORMAT: u32 = 9;

/// Textures of a material.
pub const TEXTURE_SLOTS: usize = 5;

/// A material of an instance.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Material {
    /// Base colour.
    pub base: [f32; 3],
    /// 0 to 1.
    pub alpha: f32,
    /// Emitted light.
    pub emissive: [f32; 3],
    /// 0 dielectric to 1 metal.
    pub metallic: f32,
    /// Perceptual roughness.
    pub roughness: f32,
    /// Times X and Y of the normal texture.
    pub normal_scale: f32,
    /// How much of the occlusion texture counts.
    pub occlusion_strength: f32,
    /// Where alpha is below it, the surface is not drawn.
    pub alpha_cutoff: f32,
    /// [`MATERIAL_SMOOTH`], [`MATERIAL_UNLIT`].
    pub flags: u32,
    /// Zero.
    pub unused_a: u32,
    /// Zero.
    pub unused_b: u32,
    /// Zero.
    pub unused_c: u32,
    /// Colour and alpha, metallic and roughness, normals, occlusion, emitted light.
    pub textures: [Texture; TEXTURE_SLOTS],
}

/// Of [`InstanceMaterial::flags`]: normals are interpolated.
pub const MATERIAL_SMOOTH: u32 = 1;
/// Of [`InstanceMaterial::flags`]: [`InstanceMaterial::normal`] keeps angles.
pub const MATERIAL_CONFORMAL: u32 = 2;
/// Of [`InstanceMaterial::flags`] and [`Material::flags`]: light does not count.
pub const MATERIAL_UNLIT: u32 = 4;
/// Of [`InstanceMaterial::flags`]: shadows fall on it.
pub const MATERIAL_SHADOWED: u32 = 8;
/// The bit of [`InstanceMaterial::flags`] from which on the words of each vertex's colour are stated, 0 without colours.
pub const MATERIAL_COLOR_WORDS: u32 = 4;

/// A light in camera space.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Light {
    /// Towards the light, unit (directional), or its position.
    pub vector: [f32; 3],
    /// 1 for a light with a position.
    pub point: u32,
    /// Colour times intensity.
    pub radiance: [f32; 3],
    /// One over the distance at which it ends; 0 never.
    pub inverse_range: f32,
    /// The way a spot shines, unit.
    pub direction: [f32; 3],
    /// See [`crate::scene::Falloff::cone_scale`].
    pub cone_scale: f32,
    /// See [`crate::scene::Falloff::cone_offset`].
    pub cone_offset: f32,
    /// Zero.
    pub unused: [f32; 3],
}

/// How a view looks up the shadow map of a light: `shadow::LightView`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ShadowLight {
    /// Rows of the light's axes in camera space, and of the camera's place as seen from the light.
    pub axes: [[f32; 4]; 3],
    /// [`SHADOW_NONE`], [`SHADOW_PARALLEL`], [`SHADOW_SPOT`], [`SHADOW_CUBE`].
    pub kind: u32,
    /// The finest level of a parallel map.
    pub first: i32,
    /// Levels by which all texels are larger than a pixel.
    pub coarser: i32,
    /// 1 for a parallel camera.
    pub orthographic: u32,
    /// Tangent of half the angle of a pinhole.
    pub tangent: f32,
    /// Near distance of a pinhole.
    pub near: f32,
    /// The square of the distance at which the light ends; at most [`f32::MAX`].
    pub reach_squared: f32,
    /// Pixels per unit of tangent or, from a parallel camera, of length.
    pub focal: f32,
    /// Of the light's cut, texels.
    pub threshold: f32,
    /// How large the light is; 0 for a sharp one.
    pub radius: f32,
    /// One over that; 0 for a sharp one.
    pub inverse_radius: f32,
    /// Of a directional light, how high anything reaches along its axis, from the camera, world units.
    pub top: f32,
    /// Rays to it.
    pub samples: u32,
    /// Entry of the table of shadows where their points on a disk begin, two in each.
    pub points: u32,
    /// Where the anchors of its levels begin, one in each.
    pub anchors: u32,
    /// Where its page table begins.
    pub table: u32,
    /// Entries of its page table, a power of two, less one.
    pub mask: u32,
    /// Zero.
    pub unused_a: u32,
    /// Zero.
    pub unused_b: u32,
    /// Zero.
    pub unused_c: u32,
}

/// [`ShadowLight::kind`] of a light that throws no shadow.
pub const SHADOW_NONE: u32 = 0;
/// Of a map without an end.
pub const SHADOW_PARALLEL: u32 = 1;
/// Of one pinhole.
pub const SHADOW_SPOT: u32 = 2;
/// Of six pinholes.
pub const SHADOW_CUBE: u32 = 3;

/// Grids of an environment.
pub const ENVIRONMENT_GRIDS: usize = 10;

/// What lights a view besides its lights.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Lighting {
    /// Light from everywhere.
    pub ambient: [f32; 3],
    /// Number of lights.
    pub lights: u32,
    /// The light that the background is written for.
    pub behind: [f32; 3],
    /// Its bytes, red lowest.
    pub background: u32,
    /// An exponent close to what encodes colours.
    pub power: f32,
    /// [`crate::config::Shading`] by number.
    pub shading: u32,
    /// 1 where the environment is seen behind all.
    pub environment_visible: u32,
    /// Times the light of the environment.
    pub intensity: f32,
    /// Rows of the rotation from camera space to its map.
    pub to_map: [[f32; 4]; 3],
    /// Of its grids: nodes along a side, and where it starts.
    pub grids: [[u32; 4]; ENVIRONMENT_GRIDS],
}

/// An instance as seen from a view.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Instance {
    /// Rows of the map from internal space to homogeneous screen space.
    pub screen: [[f32; 4]; 3],
    /// The same in the frame before, whose pyramid may be there.
    pub before: [[f32; 4]; 3],
    /// Rows of the map from internal to camera space, for the rule of the cut.
    pub object_to_eye: [[f32; 4]; 3],
    /// Centre of the box around the mesh, internal space.
    pub center: [f32; 3],
    /// See [`crate::math::LodView::scale`].
    pub lod_scale: f32,
    /// Half extents of that box, rounded up.
    pub extent: [f32; 3],
    /// See [`crate::math::LodView::focal`].
    pub lod_focal: f32,
    /// The eye in internal space, or the direction of sight.
    pub eye: [f32; 3],
    /// Key of a distance nearer than anything in that box, u32::MAX where it reaches the near plane.
    pub near_key: u32,
    /// Where the mesh's nodes start among those of all meshes.
    pub first_node: u32,
    /// Where its groups start.
    pub first_group: u32,
    /// Where its pages start in the table of pages.
    pub first_page: u32,
    /// Where the bits of the instance's groups start, words.
    pub group_words: u32,
    /// By material, one bit each, the last for all from there on: draws back faces too.
    pub double_sided: u32,
    /// 1 where the map to the screen reverses orientation.
    pub mirrored: u32,
    /// Which clusters are alpha-tested, by material in the same way.
    pub alpha_tested: u32,
    /// See [`crate::math::LodView::rounding`].
    pub rounding: f32,
    /// First column, first row, last column and last row of the pixels that the box may cover.
    pub rect: [u32; 4],
}

/// Workgroups of a dispatch that one shader decides for the next.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Dispatch {
    /// Workgroups along x.
    pub x: u32,
    /// Along y.
    pub y: u32,
    /// Along z.
    pub z: u32,
    /// Entries that the workgroups share; more than there is room for when a list was too short.
    pub count: u32,
    /// Groups that the dispatch before looked at.
    pub visited: u32,
    /// Of the instances that the dispatch before started at in the second pass, those that the pyramid does not hide.
    pub unhidden: u32,
    /// Zero.
    pub unused: [u32; 2],
}

/// A node of a hierarchy, laid out so that four numbers are read at a time.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Node {
    /// Centre of the box around all clusters below.
    pub center: [f32; 3],
    /// First child node, or first group.
    pub first: u32,
    /// Half extents of that box.
    pub extent: [f32; 3],
    /// Number of children.
    pub count: u16,
    /// 1 where they are groups.
    pub is_leaf: u16,
    /// Encloses the LOD sphere of every group below.
    pub lod_sphere: Sphere,
    /// Above the error of every group below.
    pub max_parent_error: f32,
    /// The least own error of a cluster below.
    pub min_own_error: f32,
    /// Zero.
    pub unused: [u32; 2],
}

/// A group, in the same way.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Group {
    /// Encloses the LOD spheres of its clusters.
    pub lod_sphere: Sphere,
    /// Centre of the box around its clusters.
    pub center: [f32; 3],
    /// Parent error of its clusters.
    pub error: f32,
    /// Half extents of that box.
    pub extent: [f32; 3],
    /// The least own error of a cluster of it.
    pub min_own_error: f32,
    /// Address of its first cluster.
    pub first: u32,
    /// Number of clusters.
    pub count: u32,
    /// Zero.
    pub unused: [u32; 2],
}

/// An item of the hierarchy traversal: a node of an instance.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
pub struct TraversalItem {
    /// Number of the instance.
    pub instance: u32,
    /// Node of its mesh.
    pub node: u32,
}

/// A group whose clusters may be drawn.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct CandidateGroup {
    /// Number of the instance.
    pub instance: u32,
    /// Address of the first cluster.
    pub first: u32,
    /// Number of clusters.
    pub count: u32,
    /// Its place among the candidates of the first pass.
    pub before: u32,
    /// Its number in its mesh.
    pub group: u32,
}

/// What is known of the clusters of a candidate, one bit each.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Marks {
    /// Those for the large rasterizer.
    pub large: u32,
    /// Of the second pass: those that the first one drew.
    pub old: u32,
    /// Number of the first in the visible list.
    pub first: u32,
    /// Of the large ones, those that the hardware rasterizer does not take; of the others, those that are alpha-tested.
    pub clipped: u32,
}

/// Arguments of an indirect draw.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct DrawArgs {
    /// Vertices of each instance.
    pub vertices: u32,
    /// Instances.
    pub instances: u32,
    /// Zero.
    pub first_vertex: u32,
    /// Zero.
    pub first_instance: u32,
}

/// An entry of the frame's visible list.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct VisibleCluster {
    /// Number of the instance.
    pub instance: u32,
    /// Address of the cluster.
    pub cluster: u32,
    /// 1 when the large rasterizer draws it; where shadow maps are drawn, the page.
    pub large: u32,
}

/// Lists of clusters and pages of shadow maps that they may touch.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct PairLists {
    /// Entries that there is room for in each.
    pub room: u32,
    /// Zero.
    pub unused_a: u32,
    /// Zero.
    pub unused_b: u32,
    /// Zero.
    pub unused_c: u32,
}

/// The clusters that may touch a page of a shadow map.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct PageClusters {
    /// The largest key of the nearest point of one.
    pub nearest: u32,
    /// The complement of the least such key.
    pub farthest: u32,
    /// How many; 0 where that was not counted.
    pub clusters: u32,
    /// Triangles of those that are drawn.
    pub triangles: u32,
}

/// What stages count besides their lists.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Counters {
    /// Clusters looked at.
    pub visited_clusters: u32,
    /// Triangles that faced the eye and had a pixel to offer, small rasterizer.
    pub drawn_small: u32,
    /// The same, large rasterizer.
    pub drawn_large: u32,
    /// Entries of the visible list.
    pub visible: u32,
    /// Clusters that the pyramid occludes: in the first pass that of an earlier frame.
    pub occluded: u32,
    /// 1 where a pyramid was built.
    pub pyramid: u32,
    /// Triangles of the clusters that the small rasterizer draws.
    pub triangles_small: u32,
    /// The same, large rasterizer.
    pub triangles_large: u32,
    /// Of the triangles drawn, small or large, those that the device's own rasterizer drew.
    pub drawn_hardware: u32,
    /// Pixels that show anything, of a picture that stays on the device; in the first pass.
    pub covered: u32,
    /// Tiles of the picture that clusters may cover, a word for each row of them.
    pub tiles: [u32; TILES],
}

impl Counters {
    /// Triangles of the clusters that either rasterizer draws.
    pub fn triangles(&self) -> u64 {
        u64::from(self.triangles_small) + u64::from(self.triangles_large)
    }
}
