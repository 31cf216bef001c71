// Where a view finds points in the maps of lights: src/shadow/receiver.rs, operation for operation. What decides on pages
// rounds as on the CPU, so that what marks them and what reads them agree. Powers of two are multiplied by, which rounds nothing.
// Needs: exact.wgsl, SHADOW_BINDING.

// How many lights there are; the record of each; then anchors, points of lights, and tables of pages.
@group(0) @binding(SHADOW_BINDING) var<storage, read> shadow_table: array<vec4<u32>>;

// A page of a light's map, counted from the anchor of its level: src/shadow/receiver.rs.
struct ShadowPage {
    face: u32,
    level: i32,
    // Pages right and down, slabs up.
    at: vec3<i32>,
}

// A level, and a texel there, world units.
struct ShadowLevel {
    there: bool,
    level: i32,
    texel: f32,
}

// Where a point lies in a map.
struct ShadowPlace {
    there: bool,
    page: ShadowPage,
    // The texel in it.
    texel: u32,
    // From the slab's top, or from the light.
    depth: f32,
}

// The record of a light.
fn shadow_light(number: u32) -> ShadowLight {
    let first = 1u + number * SHADOW_LIGHT_QUADS;
    let kind = shadow_table[first + 3u];
    let shape = bitcast<vec4<f32>>(shadow_table[first + 4u]);
    let size = bitcast<vec4<f32>>(shadow_table[first + 5u]);
    let lists = shadow_table[first + 6u];
    let last = shadow_table[first + 7u];
    return ShadowLight(
        array<vec4<f32>, 3>(
            bitcast<vec4<f32>>(shadow_table[first]),
            bitcast<vec4<f32>>(shadow_table[first + 1u]),
            bitcast<vec4<f32>>(shadow_table[first + 2u]),
        ),
        kind.x,
        bitcast<i32>(kind.y),
        bitcast<i32>(kind.z),
        kind.w,
        shape.x,
        shape.y,
        shape.z,
        shape.w,
        size.x,
        size.y,
        size.z,
        size.w,
        lists.x,
        lists.y,
        lists.z,
        lists.w,
        last.x,
        last.y,
        last.z,
        last.w,
    );
}

fn shadow_parallel(light: ShadowLight) -> bool {
    return light.kind == SHADOW_PARALLEL;
}

fn shadow_soft(light: ShadowLight) -> bool {
    return light.radius > 0.0;
}

// Two to a level.
fn shadow_power(level: i32) -> f32 {
    return bitcast<f32>(u32(level + 127) << 23u);
}

// The binary logarithm of a positive number, rounded down.
fn shadow_exponent(v: f32) -> i32 {
    return i32(bitcast<u32>(v) >> 23u) - 127;
}

// Of a level of a parallel map, where the camera is in it: texels right, down and up.
fn shadow_anchor(light: ShadowLight, level: i32) -> vec3<f32> {
    return bitcast<vec4<f32>>(shadow_table[light.anchors + u32(level - light.first)]).xyz;
}

// How far a point is from the camera, and the size of a pixel there, world units.
fn shadow_pixel(light: ShadowLight, position: vec3<f32>) -> vec2<f32> {
    let distance = root(inner(position, position));
    return vec2<f32>(distance, quotient(select(distance, 1.0, light.orthographic != 0u), light.focal));
}

// A direction along the light's axes.
fn shadow_turned(light: ShadowLight, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(inner(light.axes[0].xyz, v), inner(light.axes[1].xyz, v), inner(light.axes[2].xyz, v));
}

// A point along the light's axes: from the light's place, or from the camera where it has none.
fn shadow_along_axes(light: ShadowLight, position: vec3<f32>) -> vec3<f32> {
    return shadow_turned(light, position) + vec3<f32>(light.axes[0].w, light.axes[1].w, light.axes[2].w);
}

// The face that sees a point.
fn shadow_face(light: ShadowLight, at: vec3<f32>) -> u32 {
    if light.kind != SHADOW_CUBE {
        return 0u;
    }
    let size = abs(at);
    if size.x >= size.y && size.x >= size.z {
        return u32(at.x < 0.0);
    }
    if size.y >= size.z {
        return 2u + u32(at.y < 0.0);
    }
    return 4u + u32(at.z < 0.0);
}

// To the right, up, and against the sight of a face: CUBE_FACES of src/shadow/map.rs.
fn shadow_in_face(light: ShadowLight, face: u32, v: vec3<f32>) -> vec3<f32> {
    if light.kind != SHADOW_CUBE {
        return v;
    }
    switch face {
        case 0u: { return vec3<f32>(v.z, v.y, -v.x); }
        case 1u: { return vec3<f32>(-v.z, v.y, v.x); }
        case 2u: { return vec3<f32>(v.x, v.z, -v.y); }
        case 3u: { return vec3<f32>(-v.x, v.z, v.y); }
        case 4u: { return vec3<f32>(-v.x, v.y, -v.z); }
        default: { return v; }
    }
}

// The level that stands for one.
fn shadow_coarse(light: ShadowLight, level: i32) -> i32 {
    let apart = 1 + light.coarser / i32(SHADOW_LEVELS_APART);
    let below = -(level + light.coarser);
    // The quotient, rounded down.
    let whole = below / apart;
    return -(whole - i32(whole * apart > below)) * apart;
}

// The level of a parallel map that is nearest to this one.
fn shadow_bounded(light: ShadowLight, level: i32) -> i32 {
    return clamp(level, light.first, light.first + i32(SHADOW_LEVELS) - 1);
}

fn shadow_level(light: ShadowLight, at: vec3<f32>, pixel: f32) -> ShadowLevel {
    if shadow_parallel(light) {
        let level = shadow_bounded(light, shadow_coarse(light, shadow_exponent(pixel)));
        return ShadowLevel(true, level, shadow_power(level));
    }
    let depth = -shadow_in_face(light, shadow_face(light, at), at).z;
    let finest = times(depth, light.tangent * (2.0 / f32(SHADOW_SIDE)));
    if !(depth > 0.0 && finest > 0.0 && inner(at, at) <= light.reach_squared) {
        return ShadowLevel(false, 0, 0.0);
    }
    let coarse = shadow_coarse(light, shadow_exponent(quotient(pixel, finest)));
    let level = clamp(coarse, 0, i32(SHADOW_BOUNDED_LEVELS) - 1);
    return ShadowLevel(true, level, finest * shadow_power(level));
}

// The texel of a page at so many texels right and down.
fn shadow_texel(at: vec2<f32>) -> u32 {
    let last = f32(SHADOW_PAGE_SIDE - 1u);
    let x = select(0.0, min(at.x, last), at.x > 0.0);
    let y = select(0.0, min(at.y, last), at.y > 0.0);
    return u32(y) * SHADOW_PAGE_SIDE + u32(x);
}

// Where a point lies in a level; not there outside of a spot.
fn shadow_place(light: ShadowLight, at: vec3<f32>, level: i32) -> ShadowPlace {
    let side = f32(SHADOW_PAGE_SIDE);
    let slab_side = f32(SHADOW_SIDE);
    if shadow_parallel(light) {
        let inverse = shadow_power(-level);
        let offset = shadow_anchor(light, level);
        let place = vec2<f32>(at.x * inverse + offset.x, offset.y - at.y * inverse);
        let z = at.z * inverse + offset.z;
        let page = floor(place * (1.0 / side));
        let slab = floor(z * (1.0 / slab_side));
        let depth = ((slab + 1.0) * slab_side - z) * shadow_power(level);
        let where_it_lies = ShadowPage(0u, level, vec3<i32>(vec3<f32>(page, slab)));
        return ShadowPlace(true, where_it_lies, shadow_texel(place - page * side), depth);
    }
    let face = shadow_face(light, at);
    let seen = shadow_in_face(light, face, at);
    let depth = -seen.z;
    let texels = f32(SHADOW_SIDE >> u32(level));
    let scale = quotient(0.5 * texels, times(light.tangent, depth));
    var place = vec2<f32>(0.5 * texels + times(seen.x, scale), 0.5 * texels - times(seen.y, scale));
    // The picture of a spot ends with its cone, those of a cube at each other, but for rounding.
    let inside = place.x >= 0.0 && place.x < texels && place.y >= 0.0 && place.y < texels;
    let there = depth > light.near && (light.kind == SHADOW_CUBE || inside);
    let last = bitcast<f32>(bitcast<u32>(texels) - 1u);
    place = vec2<f32>(
        select(0.0, min(place.x, last), place.x > 0.0),
        select(0.0, min(place.y, last), place.y > 0.0),
    );
    let page = floor(place * (1.0 / side));
    let where_it_lies = ShadowPage(face, level, vec3<i32>(vec3<f32>(page, 0.0)));
    return ShadowPlace(there, where_it_lies, shadow_texel(place - page * side), depth);
}

// Rounding of a receiver's place at a distance, where a pixel is so large.
fn shadow_rounding(distance: f32, pixel: f32) -> f32 {
    return distance * SHADOW_ROUNDING + SHADOW_SNAP * pixel;
}
