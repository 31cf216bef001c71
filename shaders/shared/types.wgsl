// The structs that Rust and WGSL share: src/gpu_types/ and src/model/. A test compares their offsets.

struct View {
    width: u32,
    height: u32,
    orthographic: u32,
    near: f32,
    far: f32,
    far_key: u32,
    tau: f32,
    instances: u32,
    // Always zero, which compilers cannot know.
    zero: u32,
    // Levels of the depth pyramid; level 0 has the pixels, or no keys where those would be too many.
    levels: u32,
    // What there is of an earlier frame: 0 nothing, 1 its pyramid, HISTORY_LIST also the list of what it drew, from which
    // the first pass starts.
    history: u32,
    // Words of the bits of all groups.
    group_words: u32,
    // Columns, rows and first key of each level of the pyramid, and from row to row: the last two are multiples of 4.
    pyramid: array<vec4<u32>, PYRAMID_LEVELS>,
    // Rows of the rotation from the world to camera space, and of the eye's place the high part.
    rotate: array<vec4<f32>, 3>,
    forward: vec3<f32>,
    lod_focal: f32,
    // The low part of the eye's place.
    low: vec3<f32>,
    lod_near: f32,
    focal: vec2<f32>,
    center: vec2<f32>,
    inverse_focal: vec2<f32>,
    mirrored: u32,
    // Side, pixels, of the viewport of the hardware rasterizer; 0 where it draws nothing.
    viewport: u32,
    // Of what no earlier frame showed, the first pass draws what has this key or a larger one: what is near.
    occluders: u32,
    // 1 where the visibility buffer has keys alone.
    depth_only: u32,
    lod_widest: f32,
    // 1 where what is hidden is left out, in two passes; then the second alone asks for pages that are missed.
    two_passes: u32,
    // Pixels to the right per unit of tangent up the picture.
    skew: f32,
    // The word of its target that its pixels begin at.
    first_word: u32,
    unused_b: u32,
    unused_c: u32,
}

// An instance as the scene places it, whoever looks at it.
struct InstanceTransform {
    // Rows of the linear map from internal space to the world, and of the origin's place the high part.
    linear: array<vec4<f32>, 3>,
    // Rows of its inverse, and the low part.
    inverse: array<vec4<f32>, 3>,
    center: vec3<f32>,
    lod_scale: f32,
    extent: vec3<f32>,
    first_node: u32,
    first_group: u32,
    first_page: u32,
    group_words: u32,
    double_sided: u32,
    mirrored: u32,
    // SEEN_BY_VIEWS and SEEN_BY_LIGHTS; 0 where nothing is.
    visible: u32,
    // Alpha-tested clusters, by material as for double_sided.
    alpha_tested: u32,
    // Largest distance by which positions were moved where they were stored: of every error above the source's.
    rounding: f32,
}

// The look of an instance.
struct InstanceMaterial {
    // Rows of the map of normals from internal space to the world, each with a component of the base colour.
    normal: array<vec4<f32>, 3>,
    emissive: vec3<f32>,
    metallic: f32,
    roughness: f32,
    // MATERIAL_SMOOTH, MATERIAL_CONFORMAL, MATERIAL_UNLIT, MATERIAL_SHADOWED; from bit MATERIAL_COLOR_WORDS on, words of a vertex's colour.
    flags: u32,
    // Of an instance with textures or several materials: its first one, and how many follow. Otherwise NONE.
    first_material: u32,
    last_material: u32,
}

// A texture of a material.
struct Texture {
    // Rows of the map from (u, v, 1) to the image in its sides, from its upper left corner; and the sides, texels.
    rows: array<vec4<f32>, 2>,
    // Where the image starts, words; NONE where there is no texture.
    start: u32,
    levels: u32,
    // UV set, and fields from TEXTURE_WRAP on.
    flags: u32,
    // Most samples.
    anisotropy: f32,
}

struct Material {
    base: vec3<f32>,
    alpha: f32,
    emissive: vec3<f32>,
    metallic: f32,
    roughness: f32,
    normal_scale: f32,
    occlusion_strength: f32,
    alpha_cutoff: f32,
    // LOOK_SMOOTH, LOOK_UNLIT.
    flags: u32,
    unused_a: u32,
    unused_b: u32,
    unused_c: u32,
    textures: array<Texture, SLOTS>,
}

// A light in camera space.
struct Light {
    // Towards the light, unit, or its position.
    vector: vec3<f32>,
    // 1 for a light with a position.
    point: u32,
    radiance: vec3<f32>,
    inverse_range: f32,
    // The way a spot shines, unit.
    direction: vec3<f32>,
    // Times the cosine of the angle from there, plus the offset, held to 0 and 1: the root of what is left of it.
    cone_scale: f32,
    cone_offset: f32,
    unused: array<f32, 3>,
}

struct Lighting {
    ambient: vec3<f32>,
    // Number of lights.
    lights: u32,
    // The light that the background is written for.
    behind: vec3<f32>,
    // Its bytes, red lowest.
    background: u32,
    // An exponent close to what encodes colours.
    power: f32,
    // SHADING_GLTF and so on.
    shading: u32,
    // 1 where the environment is seen behind all.
    environment_visible: u32,
    // Times the light of the environment.
    intensity: f32,
    // Rows of the rotation from camera space to its map.
    to_map: array<vec4<f32>, 3>,
    // Of its grids: nodes along a side, and where it starts.
    grids: array<vec4<u32>, GRIDS>,
}

// How a view looks up the shadow map of a light: LightView of src/shadow/receiver.rs.
struct ShadowLight {
    // Rows of the light's axes in camera space, and of the camera's place as seen from the light.
    axes: array<vec4<f32>, 3>,
    // SHADOW_NONE and so on.
    kind: u32,
    // The finest level of a parallel map.
    first: i32,
    // Levels by which all texels are larger than a pixel.
    coarser: i32,
    // 1 for a parallel camera.
    orthographic: u32,
    // Tangent of half the angle, and the near distance, of a pinhole.
    tangent: f32,
    near: f32,
    // The square of the distance at which the light ends.
    reach_squared: f32,
    // Pixels per unit of tangent or of length.
    focal: f32,
    // Of the light's cut, texels.
    threshold: f32,
    // How large the light is, 0 for a sharp one, and one over that.
    radius: f32,
    inverse_radius: f32,
    // Of a directional light, how high anything reaches along its axis, from the camera.
    top: f32,
    // Rays to it, and where their points on a disk begin, two in an entry.
    samples: u32,
    points: u32,
    // Where the anchors of its levels begin, and its page table, which has so many entries less one.
    anchors: u32,
    table: u32,
    mask: u32,
    unused_a: u32,
    unused_b: u32,
    unused_c: u32,
}

struct Instance {
    // Rows of the map from internal space to homogeneous screen space.
    screen: array<vec4<f32>, 3>,
    // The same in the frame before, whose pyramid may be there.
    before: array<vec4<f32>, 3>,
    // Rows of the map from internal space to camera space, for the rule of the cut.
    object_to_eye: array<vec4<f32>, 3>,
    center: vec3<f32>,
    lod_scale: f32,
    extent: vec3<f32>,
    lod_focal: f32,
    eye: vec3<f32>,
    // See Footprint, as all fields of the box.
    near_key: u32,
    first_node: u32,
    first_group: u32,
    first_page: u32,
    group_words: u32,
    double_sided: u32,
    mirrored: u32,
    alpha_tested: u32,
    rounding: f32,
    rect: vec4<u32>,
}

struct Sphere {
    center: vec3<f32>,
    radius: f32,
}

struct Node {
    center: vec3<f32>,
    first: u32,
    extent: vec3<f32>,
    // Number of children, and 1 << 16 where these are groups.
    count: u32,
    lod_sphere: Sphere,
    max_parent_error: f32,
    min_own_error: f32,
    unused: array<u32, 2>,
}

struct Group {
    lod_sphere: Sphere,
    center: vec3<f32>,
    error: f32,
    extent: vec3<f32>,
    min_own_error: f32,
    first: u32,
    count: u32,
    unused: array<u32, 2>,
}

// A node of an instance that is to be looked at.
struct TraversalItem {
    instance: u32,
    node: u32,
}

// A group of an instance whose clusters may be drawn.
struct CandidateGroup {
    instance: u32,
    first: u32,
    count: u32,
    // Its place among the candidates of the first pass.
    before: u32,
    // Its number in its mesh.
    group: u32,
}

// What is known of the clusters of a candidate, one bit each.
struct Marks {
    large: u32,
    // Of the second pass: those that the first one drew.
    old: u32,
    // Number of the first in the visible list.
    first: u32,
    // Of the large ones, those that the hardware rasterizer does not take.
    clipped: u32,
}

struct VisibleCluster {
    instance: u32,
    cluster: u32,
    // 1 when the large rasterizer draws it; where shadow maps are drawn, the page.
    large: u32,
}

// Lists of clusters and pages of shadow maps that they may touch.
struct PairLists {
    // Entries that there is room for in each.
    room: u32,
    unused_a: u32,
    unused_b: u32,
    unused_c: u32,
}

// The clusters that may touch a page of a shadow map: the largest key of a nearest point, the complement of the least, how many
// they are, and the triangles of those that are drawn.
struct PageClusters {
    nearest: atomic<u32>,
    farthest: atomic<u32>,
    clusters: atomic<u32>,
    triangles: atomic<u32>,
}

// Workgroups of a dispatch that one shader decides for the next, and how many entries they share.
struct Dispatch {
    x: u32,
    y: u32,
    z: u32,
    count: u32,
    visited: u32,
    unhidden: u32,
    unused: array<u32, 2>,
}

// The same while it is written.
struct DispatchArgsOut {
    x: atomic<u32>,
    y: atomic<u32>,
    z: atomic<u32>,
    count: atomic<u32>,
    visited: atomic<u32>,
    unhidden: atomic<u32>,
    unused: array<u32, 2>,
}

// A draw as a device takes it.
struct DrawArgs {
    vertices: u32,
    instances: u32,
    first_vertex: u32,
    first_instance: u32,
}

// The same while it is written.
struct DrawArgsOut {
    vertices: u32,
    instances: atomic<u32>,
    first_vertex: u32,
    first_instance: u32,
}

// Where entry `at` of a list lies among the numbers of all lists, which have room for so many: small ones from the front,
// large ones from the back; behind both in the same way clipped ones, and alpha-tested ones.
fn number_slot(list: u32, at: u32, room: u32) -> u32 {
    switch list {
        case LIST_SMALL: { return at; }
        case LIST_LARGE: { return room - 1u - at; }
        case LIST_CLIPPED: { return room + at; }
        default: { return 2u * room - 1u - at; }
    }
}

// Where entry `at` of a list of pairs lies; there is none of clipped ones.
fn pair_slot(list: u32, at: u32, room: u32) -> u32 {
    return min(list, LIST_CLIPPED) * room + at;
}

fn workgroups(entries: u32, per_workgroup: u32, count: u32) -> Dispatch {
    let workgroups = (entries + per_workgroup - 1u) / per_workgroup;
    let rows = (workgroups + MAX_WORKGROUPS - 1u) / MAX_WORKGROUPS;
    return Dispatch(min(workgroups, MAX_WORKGROUPS), rows, 1u, count, 0u, 0u, array<u32, 2>());
}

// Number of a workgroup in a dispatch that may be wider than one dimension allows.
fn workgroup_number(id: vec3<u32>) -> u32 {
    return id.y * MAX_WORKGROUPS + id.x;
}

struct Counters {
    visited_clusters: atomic<u32>,
    drawn_small: atomic<u32>,
    drawn_large: atomic<u32>,
    // Entries of the visible list.
    visible: atomic<u32>,
    // Clusters that wait for the second pass; of the second pass: that the pyramid hides.
    occluded: atomic<u32>,
    // 1 where a pyramid was built.
    pyramid: atomic<u32>,
    // Triangles of the clusters that each rasterizer draws.
    triangles_small: atomic<u32>,
    triangles_large: atomic<u32>,
    // Of the triangles drawn, small or large, those that the device's own rasterizer drew.
    drawn_hardware: atomic<u32>,
    // Pixels that show anything, of a picture that stays on the device; in the first pass.
    covered: atomic<u32>,
    // Tiles of the picture that clusters may cover, a word for each row of them.
    tiles: array<atomic<u32>, TILES>,
}
