// Stages 4 and 5 by the device's rasterizer: an instance for each cluster, three vertices for each triangle.
// The device only finds which pixels a triangle covers. Vertices are snapped before, on a viewport whose side is a power of
// two, so that nothing is rounded on the way; fragments compute depth as the software rasterizers do.
// Reads a list of clusters and their pages. Writes the visibility buffer by atomic maxima.
// Needs: triangle.wgsl, int64.wgsl, listed, screen_of, mirrors, shows_backs.

struct Corner {
    @builtin(position) position: vec4<f32>,
    // The snapped corners, with the inside on the right of each edge, and their depth values.
    @location(0) @interpolate(flat) ab: vec4<i32>,
    @location(1) @interpolate(flat) c: vec2<i32>,
    @location(2) @interpolate(flat) values: vec3<f32>,
    @location(3) @interpolate(flat) low: u32,
}

// Of triangles that are not drawn: before the near plane.
const NOWHERE: Corner = Corner(vec4<f32>(0.0, 0.0, -1.0, 1.0), vec4<i32>(), vec2<i32>(), vec3<f32>(), 0u);

// Exact: both are multiples of powers of two.
fn on_viewport(p: vec2<i32>) -> vec4<f32> {
    let center = vec2<i32>(vec2<u32>(view.width / 2u, view.height / 2u)) * UNIT;
    let at = vec2<f32>(p - center) / f32(view.viewport / 2u * u32(UNIT));
    return vec4<f32>(at.x, -at.y, 0.0, 1.0);
}

fn has_pixels(a: i32, b: i32, c: i32, size: u32) -> bool {
    let range = pixel_range(min(min(a, b), c), max(max(a, b), c));
    return max(range.x, 0) <= min(range.y, i32(size) - 1);
}

@vertex
fn corner(@builtin(vertex_index) vertex: u32, @builtin(instance_index) index: u32) -> Corner {
    let triangle = vertex / 3u;
    let number = listed(LIST, index);
    if number == NONE {
        return NOWHERE;
    }
    let instance = visible[number].instance;
    let cluster = visible[number].cluster;
    let page = page_start(instance, cluster);
    let record = record_start(page, cluster);
    if triangle >= triangle_count(record) {
        return NOWHERE;
    }
    let streams = streams_of(page, record);
    let corners = triangle_corners(streams, triangle);
    let rows = screen_of(instance);
    var p: array<vec3<f32>, 3>;
    var snapped: array<vec2<i32>, 3>;
    for (var k = 0u; k < 3u; k++) {
        p[k] = project(homogeneous(rows, vertex_position(instance, streams, corners[k])));
        snapped[k] = vec2<i32>(snap(p[k].x), snap(p[k].y));
    }
    let a = snapped[0];
    let area = edge_function(a, snapped[1], snapped[2]);
    // Clockwise on the screen is the back, unless the instance is mirrored.
    let clockwise = area.high >= 0;
    if area.high == 0 && area.low == 0u
        || clockwise != mirrors(instance) && !shows_backs(instance, record)
        || !has_pixels(a.x, snapped[1].x, snapped[2].x, view.width)
        || !has_pixels(a.y, snapped[1].y, snapped[2].y, view.height) {
        return NOWHERE;
    }
    let place = vertex % 3u;
    if FIRST_PASS && place == 0u {
        atomicAdd(&counters.drawn_hardware, 1u);
        if LIST == LIST_SMALL {
            atomicAdd(&counters.drawn_small, 1u);
        } else {
            atomicAdd(&counters.drawn_large, 1u);
        }
    }
    let position = on_viewport(snapped[place]);
    let low = payload(number) - triangle;
    if clockwise {
        return Corner(position, vec4<i32>(a, snapped[1]), snapped[2], vec3<f32>(p[0].z, p[1].z, p[2].z), low);
    }
    return Corner(position, vec4<i32>(a, snapped[2]), snapped[1], vec3<f32>(p[0].z, p[2].z, p[1].z), low);
}

// As raster_small.wgsl does.
fn value_of_small(pixel: vec2<i32>, a: vec2<i32>, b: vec2<i32>, c: vec2<i32>, v: vec3<f32>) -> f32 {
    let low = min(min(a, b), c);
    let high = max(max(a, b), c);
    let first = max(vec2<i32>(pixel_range(low.x, high.x).x, pixel_range(low.y, high.y).x), vec2<i32>());
    return value_at(plane(a, b, c, v, first), pixel.x - first.x, pixel.y - first.y);
}

// As raster_large.wgsl does.
fn value_of_large(pixel: vec2<i32>, a: vec2<i32>, b: vec2<i32>, c: vec2<i32>, v: vec3<f32>) -> f32 {
    let at = pixel * UNIT + UNIT / 2;
    let area = edge_function(a, b, c);
    let of_a = edge_function(b, c, at);
    let of_b = edge_function(c, a, at);
    // The three weights make up the area.
    let of_c = wide_add(area, wide_negate(wide_add(of_a, of_b)));
    let weights = vec3<f32>(wide_nearest(of_a), wide_nearest(of_b), wide_nearest(of_c));
    return mean(weights, v, quotient(1.0, wide_nearest(area)));
}

@fragment
fn pixel(in: Corner) {
    let at = vec2<i32>(in.position.xy);
    let number = pixel_address(u32(at.x), u32(at.y));
    if LIST == LIST_SMALL {
        put(number, depth_key(value_of_small(at, in.ab.xy, in.ab.zw, in.c, in.values)), in.low);
        return;
    }
    let key = depth_key(value_of_large(at, in.ab.xy, in.ab.zw, in.c, in.values));
    if key >= view.far_key {
        put(number, key, in.low);
    }
}
