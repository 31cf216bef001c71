// The structs of src/gpu_types/ and src/model/; a test compares offsets.

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
    unused_a: u32,
    unused_b: u32,
    unused_c: u32,
}

struct Instance {
    // Rows of the map from internal space to homogeneous screen space.
    screen: array<vec4<f32>, 3>,
    // Rows of the map from internal space to camera space, for the rule of the cut.
    object_to_eye: array<vec4<f32>, 3>,
    center: vec3<f32>,
    lod_scale: f32,
    extent: vec3<f32>,
    lod_focal: f32,
    eye: vec3<f32>,
    lod_near: f32,
    first_node: u32,
    first_group: u32,
    first_page: u32,
    group_words: u32,
    vertex_words: u32,
    double_sided: u32,
    mirrored: u32,
    unused: u32,
}

struct Sphere {
    center: array<f32, 3>,
    radius: f32,
}

struct Node {
    center: array<f32, 3>,
    extent: array<f32, 3>,
    lod_sphere: Sphere,
    max_parent_error: f32,
    first: u32,
    // Number of children, and 1 << 16 where these are groups.
    count: u32,
    level: u32,
}

struct Group {
    lod_sphere: Sphere,
    error: f32,
    first: u32,
    count: u32,
    level: u32,
    center: array<f32, 3>,
    extent: array<f32, 3>,
    bound: f32,
    quadric: f32,
    attribute_error: f32,
    reserved: array<u32, 3>,
}

// A node of an instance that is to be looked at.
struct Visit {
    instance: u32,
    node: u32,
}

// A group of an instance whose clusters may be drawn.
struct Candidate {
    instance: u32,
    first: u32,
    count: u32,
}

struct VisibleCluster {
    instance: u32,
    cluster: u32,
    large: u32,
}

// Workgroups of a dispatch that one shader decides for the next, and how many entries they share.
struct Dispatch {
    x: u32,
    y: u32,
    z: u32,
    count: u32,
    visited: u32,
    unused: array<u32, 3>,
}

// The same while it is written.
struct DispatchOut {
    x: atomic<u32>,
    y: atomic<u32>,
    z: atomic<u32>,
    count: atomic<u32>,
    visited: atomic<u32>,
    unused: array<u32, 3>,
}

fn vector(a: array<f32, 3>) -> vec3<f32> {
    return vec3<f32>(a[0], a[1], a[2]);
}

// Number of a workgroup in a dispatch that may be wider than one dimension allows.
fn workgroup_number(id: vec3<u32>) -> u32 {
    return id.y * MAX_WORKGROUPS + id.x;
}

struct Counters {
    visited_clusters: atomic<u32>,
    drawn_small: atomic<u32>,
    drawn_large: atomic<u32>,
    unused: u32,
}
