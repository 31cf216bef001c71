// Triangle set-up and bindings of all rasterizers: src/cpu/triangle.rs and src/cpu/visibility.rs.
// Needs: exact.wgsl, cull.wgsl, vertex.wgsl, target.wgsl, view, instances, put.

// Binding 0 are the instances, and 10 and 11 what is drawn: one_view.wgsl, page_views.wgsl.
@group(0) @binding(1) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(2) var<storage, read> pages: array<u32>;
@group(0) @binding(3) var<storage, read> visible: array<VisibleCluster>;
@group(0) @binding(4) var<storage, read> draws: array<Dispatch, LISTS>;
// Binding 5 is the visibility buffer: words_64.wgsl, words_32.wgsl, words_depth.wgsl.
@group(0) @binding(6) var<storage, read_write> counters: Counters;
@group(0) @binding(7) var<storage, read> pages_1: array<u32>;
@group(0) @binding(8) var<storage, read> pages_2: array<u32>;
@group(0) @binding(9) var<storage, read> pages_3: array<u32>;

const UNIT: i32 = 1 << SUBPIXEL_BITS;

// Snaps a screen coordinate to 1/256 pixel: adding this leaves the nearest integer in the low bits.
fn snap(v: f32) -> i32 {
    return bitcast<i32>(v * f32(UNIT) + SNAP_ROUNDER) - bitcast<i32>(SNAP_ROUNDER);
}

// Screen position and depth value of a point at or behind the near plane.
fn project(p: vec3<f32>) -> vec3<f32> {
    if view.orthographic != 0u {
        return p;
    }
    let r = quotient(1.0, p.z);
    return vec3<f32>(times(p.x, r), times(p.y, r), times(r, view.near));
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

// The depth value of a small triangle as a function of the pixel.
struct Plane {
    start: f32,
    dx: f32,
    dy: f32,
    nearest: f32,
    farthest: f32,
}

// Through three snapped corners with their depth values, from a first pixel on.
fn plane(p0: vec2<i32>, p1: vec2<i32>, p2: vec2<i32>, v: vec3<f32>, first: vec2<i32>) -> Plane {
    let a = vec2<f32>(p0) * (1.0 / f32(UNIT));
    let b = vec2<f32>(p1) * (1.0 / f32(UNIT)) - a;
    let c = vec2<f32>(p2) * (1.0 / f32(UNIT)) - a;
    let b_value = v.y - v.x;
    let c_value = v.z - v.x;
    let determinant = times(b.x, c.y) - times(c.x, b.y);
    let inverse = select(quotient(1.0, determinant), 0.0, determinant == 0.0);
    let dx = times(times(b_value, c.y) - times(c_value, b.y), inverse);
    let dy = times(times(c_value, b.x) - times(b_value, c.x), inverse);
    let start = v.x + times(f32(first.x) + 0.5 - a.x, dx) + times(f32(first.y) + 0.5 - a.y, dy);
    return Plane(start, dx, dy, most(most(v.x, v.y), v.z), least(least(v.x, v.y), v.z));
}

// So many columns and rows from the first pixel.
fn value_at(p: Plane, column: i32, row: i32) -> f32 {
    return least(most(p.start + times(f32(column), p.dx) + times(f32(row), p.dy), p.farthest), p.nearest);
}

// The depth value of a large triangle: a mean of its corners' by weights whose sum is 1 / `inverse`. No term is negative,
// so that its relative error stays small everywhere.
fn mean(weights: vec3<f32>, v: vec3<f32>, inverse: f32) -> f32 {
    let sum = inner(weights, v);
    return least(most(times(sum, inverse), least(least(v.x, v.y), v.z)), most(most(v.x, v.y), v.z));
}

// The larger; `b` where they do not compare.
fn most(a: f32, b: f32) -> f32 {
    return select(b, a, a > b);
}

fn least(a: f32, b: f32) -> f32 {
    return select(b, a, a < b);
}
