// What both rasterizers share: src/cpu/triangle.rs and src/cpu/visibility.rs.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> pages: array<u32>;
@group(0) @binding(4) var<storage, read> visible: array<VisibleCluster>;
@group(0) @binding(5) var<storage, read> numbers: array<u32>;
@group(0) @binding(6) var<storage, read> draws: array<Dispatch, 2>;
// Binding 7 is the visibility buffer: words_64.wgsl, words_32.wgsl.
@group(0) @binding(8) var<storage, read_write> counters: Counters;
@group(0) @binding(9) var<storage, read> pages_1: array<u32>;
@group(0) @binding(10) var<storage, read> pages_2: array<u32>;
@group(0) @binding(11) var<storage, read> pages_3: array<u32>;

// Triangles of a workgroup that face the eye and have a pixel to offer.
var<workgroup> drawn: atomic<u32>;

const UNIT: i32 = 1 << SUBPIXEL_BITS;

// Snaps a screen coordinate to 1/256 pixel: adding this leaves the nearest integer in the low bits.
fn snap(v: f32) -> i32 {
    return bitcast<i32>(v * f32(UNIT) + 12582912.0) - bitcast<i32>(12582912.0f);
}

// Screen position and depth value of a point at or behind the near plane.
fn project(p: vec3<f32>) -> vec3<f32> {
    if view.orthographic != 0u {
        return p;
    }
    let r = 1.0 / p.z;
    return vec3<f32>(p.x * r, p.y * r, r * view.near);
}

// First and last pixel whose centre lies between two snapped coordinates; empty when first > last.
fn pixel_range(low: i32, high: i32) -> vec2<i32> {
    return vec2<i32>((low + UNIT / 2 - 1) >> SUBPIXEL_BITS, (high - UNIT / 2) >> SUBPIXEL_BITS);
}

// The top-left rule: what an edge function adds so that ">= 0" means "covered".
fn edge_bias(d: vec2<i32>) -> i32 {
    return select(-1, 0, d.y < 0 || (d.y == 0 && d.x > 0));
}

// The low half of a word for triangle 0 of a visible cluster; triangle t is this minus t.
fn payload(number: u32) -> u32 {
    return ~((number + 1u) << TRIANGLE_BITS);
}

// The larger; `b` where they do not compare.
fn most(a: f32, b: f32) -> f32 {
    return select(b, a, a > b);
}

fn least(a: f32, b: f32) -> f32 {
    return select(b, a, a < b);
}
