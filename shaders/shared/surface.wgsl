// Surface points of pixels, from the visibility buffer: src/cpu/surface.rs, operation for operation.
// Needs: exact.wgsl, vertex.wgsl, target.wgsl, unproject.wgsl, view, screen_of, visible, instance_materials.

// What a pixel shows.
struct Hit {
    // Something.
    covered: bool,
    key: u32,
    // Entry of the visible list.
    number: u32,
    triangle: u32,
}

// A point of a surface.
struct Surfel {
    instance: u32,
    cluster: u32,
    // Where the cluster's record starts.
    record: u32,
    distance: f32,
    // Pixel centre.
    point: vec2<f32>,
    // Unit, camera space.
    normal: vec3<f32>,
    // Linear, white without vertex colours.
    tint: vec3<f32>,
    // Unit normal of the triangle, camera space.
    face: vec3<f32>,
    // The triangle: barycentric coordinates, vertices, and where these are.
    weights: vec3<f32>,
    corners: vec3<u32>,
    a: vec3<f32>,
    b: vec3<f32>,
    c: vec3<f32>,
    streams: Streams,
}

fn dot3(a: vec3<f32>, b: vec3<f32>) -> f32 {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

// Of slivers little is left of these differences, and of how products were rounded much: so they are rounded as on the CPU.
fn cross3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return times3(a.yzx, b.zxy) - times3(a.zxy, b.yzx);
}

// The unit vector; +Z for none.
fn unit(v: vec3<f32>) -> vec3<f32> {
    let length = sqrt(dot3(v, v));
    if length < SMALLEST {
        return vec3<f32>(0.0, 0.0, 1.0);
    }
    return v * (1.0 / length);
}

// Between `low` and `high`; `low` for NaN.
fn between(v: f32, low: f32, high: f32) -> f32 {
    let above = select(low, v, v > low);
    return select(high, above, above < high);
}

fn blend(weights: vec3<f32>, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> vec3<f32> {
    return weights.x * a + weights.y * b + weights.z * c;
}

fn row(m: vec4<f32>, p: vec3<f32>) -> f32 {
    return inner(m.xyz, p) + m.w;
}

// Homogeneous coordinate of a corner, relative to a point of the screen.
fn along(screen: array<vec4<f32>, 3>, k: u32, p: vec3<f32>, point: f32) -> f32 {
    let at = row(screen[k], p);
    if view.orthographic != 0u {
        return at - point;
    }
    return at - times(point, row(screen[2], p));
}

// Perspective-correct barycentric coordinates of a point of the screen.
fn barycentric(screen: array<vec4<f32>, 3>, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>, point: vec2<f32>) -> vec3<f32> {
    let x = vec3<f32>(along(screen, 0u, a, point.x), along(screen, 0u, b, point.x), along(screen, 0u, c, point.x));
    let y = vec3<f32>(along(screen, 1u, a, point.y), along(screen, 1u, b, point.y), along(screen, 1u, c, point.y));
    let w = cross3(x, y);
    let parts = times3(w, vec3<f32>(quotient(1.0, w.x + w.y + w.z)));
    let inside = vec3<f32>(between(parts.x, 0.0, 1.0), between(parts.y, 0.0, 1.0), between(parts.z, 0.0, 1.0));
    let sum = inside.x + inside.y + inside.z;
    if sum < SMALLEST {
        return vec3<f32>(1.0 / 3.0);
    }
    return times3(inside, vec3<f32>(quotient(1.0, sum)));
}

// What barycentric coordinates change by from a pixel to the next on the right, and to the one below: derivatives of a
// quotient of sums that are linear in the point.
fn change_of(surfel: Surfel) -> array<vec3<f32>, 2> {
    let screen = screen_of(surfel.instance);
    let p = surfel.point;
    let x = vec3<f32>(
        along(screen, 0u, surfel.a, p.x),
        along(screen, 0u, surfel.b, p.x),
        along(screen, 0u, surfel.c, p.x),
    );
    let y = vec3<f32>(
        along(screen, 1u, surfel.a, p.y),
        along(screen, 1u, surfel.b, p.y),
        along(screen, 1u, surfel.c, p.y),
    );
    let w = cross3(x, y);
    let inverse = 1.0 / (w.x + w.y + w.z);
    var loss = vec3<f32>(1.0);
    if view.orthographic == 0u {
        loss = vec3<f32>(row(screen[2], surfel.a), row(screen[2], surfel.b), row(screen[2], surfel.c));
    }
    let right = cross3(y, loss);
    let below = cross3(loss, x);
    return array<vec3<f32>, 2>(
        (right - surfel.weights * (right.x + right.y + right.z)) * inverse,
        (below - surfel.weights * (below.x + below.y + below.z)) * inverse,
    );
}

fn decode_normal(packed: u32) -> vec3<f32> {
    let x = f32(bitcast<i32>(packed << 16u) >> 16u) / OCTAHEDRAL_STEPS;
    let y = f32(bitcast<i32>(packed) >> 16u) / OCTAHEDRAL_STEPS;
    let z = 1.0 - (abs(x) + abs(y));
    let t = select(0.0, -z, -z > 0.0);
    let v = vec3<f32>(select(x - t, x + t, x < 0.0), select(y - t, y + t, y < 0.0), z);
    return v * (1.0 / sqrt(dot3(v, v)));
}

// Words of a vertex's colour; 0 without colours.
fn color_words(flags: u32) -> u32 {
    return flags >> MATERIAL_COLOR_WORDS;
}

// The colour of a vertex, in one of the formats of src/model/colors.rs.
fn color_of_vertex(colors: u32, words: u32, vertex: u32) -> vec3<f32> {
    let at = colors + words * vertex;
    let first = page_word(at);
    if words == 1u {
        let bytes = vec3<u32>(first & 0xffu, first >> 8u & 0xffu, first >> 16u & 0xffu);
        return vec3<f32>(bytes) * (1.0 / UNORM_8);
    }
    if words == 2u {
        let shorts = vec3<u32>(first & 0xffffu, first >> 16u, page_word(at + 1u) & 0xffffu);
        return vec3<f32>(shorts) * (1.0 / UNORM_16);
    }
    return reals(at);
}

// Rows of the map of normals to camera space.
fn normal_map(instance_material: array<vec4<f32>, 3>) -> array<vec3<f32>, 3> {
    let x = vec3<f32>(instance_material[0].x, instance_material[1].x, instance_material[2].x);
    let y = vec3<f32>(instance_material[0].y, instance_material[1].y, instance_material[2].y);
    let z = vec3<f32>(instance_material[0].z, instance_material[1].z, instance_material[2].z);
    var rows: array<vec3<f32>, 3>;
    for (var k = 0u; k < 3u; k++) {
        let r = view.rotate[k].xyz;
        rows[k] = vec3<f32>(dot3(r, x), dot3(r, y), dot3(r, z));
    }
    return rows;
}

fn apply(m: array<vec3<f32>, 3>, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot3(v, m[0]), dot3(v, m[1]), dot3(v, m[2]));
}

fn surfel_of(pixel: u32, hit: Hit) -> Surfel {
    let instance = visible[hit.number].instance;
    let cluster = visible[hit.number].cluster;
    let page = page_start(instance, cluster);
    let record = record_start(page, cluster);
    let streams = streams_of(page, record);
    let corners = triangle_corners(streams, hit.triangle);
    let a = vertex_position(instance, streams, corners.x);
    let b = vertex_position(instance, streams, corners.y);
    let c = vertex_position(instance, streams, corners.z);
    let point = vec2<f32>(pixel_of(pixel)) + 0.5;
    let weights = barycentric(screen_of(instance), a, b, c, point);
    let to_eye = normal_map(instance_materials[instance].normal);
    let flags = instance_materials[instance].flags;
    let face = apply(to_eye, unit(cross3(b - a, c - a)));
    var normal = face;
    if (flags & MATERIAL_SMOOTH) != 0u {
        let na = decode_normal(page_word(streams.normals + corners.x));
        let nb = decode_normal(page_word(streams.normals + corners.y));
        let nc = decode_normal(page_word(streams.normals + corners.z));
        if (flags & MATERIAL_CONFORMAL) != 0u {
            normal = apply(to_eye, blend(weights, na, nb, nc));
        } else {
            normal = blend(weights, unit(apply(to_eye, na)), unit(apply(to_eye, nb)), unit(apply(to_eye, nc)));
        }
    }
    var tint = vec3<f32>(1.0);
    let words = color_words(flags);
    if words != 0u {
        let ca = color_of_vertex(streams.colors, words, corners.x);
        let cb = color_of_vertex(streams.colors, words, corners.y);
        let cc = color_of_vertex(streams.colors, words, corners.z);
        tint = blend(weights, ca, cb, cc);
    }
    let distance = distance_of(hit.key);
    return Surfel(
        instance, cluster, record, distance, point, unit(normal), tint, unit(face), weights, corners, a, b, c, streams,
    );
}
