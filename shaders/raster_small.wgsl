// Stage 4, software rasterizer for small triangles: src/cpu/raster_small.rs, operation for operation (Karis 2021).
// One workgroup handles one cluster; its invocations share out the vertices, then the triangles.
// Reads the list of small clusters and their pages. Writes the visibility buffer by atomic maxima.
// Needs: triangle.wgsl, listed, look_at, screen_of, mirrors, shows_backs.

// Triangles that face the eye and have a box with pixels.
var<workgroup> drawn: atomic<u32>;
// Snapped places, and the bits of depth values.
var<workgroup> snapped: array<vec3<i32>, CLUSTER_MAX_VERTICES>;

// Value, and steps per column and row, of the edge function from a to b at a first pixel.
fn edge(a: vec2<i32>, b: vec2<i32>, first: vec2<i32>) -> vec3<i32> {
    let d = b - a;
    let p = first * UNIT + UNIT / 2 - a;
    return vec3<i32>(d.x * p.y - d.y * p.x + edge_bias(d), -d.y * UNIT, d.x * UNIT);
}

// True when the triangle faces the eye and has a box with pixels.
fn draw(corners: vec3<u32>, double_sided: bool, low: u32) -> bool {
    let s0 = snapped[corners.x];
    let s1 = snapped[corners.y];
    let s2 = snapped[corners.z];
    let p0 = s0.xy;
    var p1 = s1.xy;
    var p2 = s2.xy;
    var v = bitcast<vec3<f32>>(vec3<i32>(s0.z, s1.z, s2.z));
    var columns = pixel_range(min(min(p0.x, p1.x), p2.x), max(max(p0.x, p1.x), p2.x));
    var rows = pixel_range(min(min(p0.y, p1.y), p2.y), max(max(p0.y, p1.y), p2.y));
    let area = (p1.x - p0.x) * (p2.y - p0.y) - (p2.x - p0.x) * (p1.y - p0.y);
    if columns.x > columns.y || rows.x > rows.y || area == 0 || (area < 0 && !double_sided) {
        return false;
    }
    if area < 0 {
        let p = p1;
        p1 = p2;
        p2 = p;
        v = v.xzy;
    }
    columns = vec2<i32>(max(columns.x, 0), min(columns.y, i32(view.width) - 1));
    rows = vec2<i32>(max(rows.x, 0), min(rows.y, i32(view.height) - 1));
    if columns.x > columns.y || rows.x > rows.y {
        return false;
    }
    let first = vec2<i32>(columns.x, rows.x);
    let e0 = edge(p1, p2, first);
    let e1 = edge(p2, p0, first);
    let e2 = edge(p0, p1, first);

    let depth = plane(p0, p1, p2, v, first);
    let across = columns.y - columns.x + 1;
    let count = across * (rows.y - rows.x + 1);
    let right = vec3<i32>(e0.y, e1.y, e2.y);
    // From behind the end of a row to the start of the next.
    let down = vec3<i32>(e0.z, e1.z, e2.z) - across * right;
    var at = vec3<i32>(e0.x, e1.x, e2.x);
    var start = pixel_address(u32(columns.x), u32(rows.x));
    var column = 0;
    var row = 0;
    // One loop over rows and columns: lanes wait for the triangle with most pixels, not for most rows times most columns.
    for (var n = 0; n < count; n++) {
        if (at.x | at.y | at.z) >= 0 {
            put(start + u32(column), depth_key(value_at(depth, column, row)), low);
        }
        column++;
        at += right;
        if column == across {
            column = 0;
            row++;
            start = pixel_address(u32(columns.x), u32(rows.x + row));
            at += down;
        }
    }
    return true;
}

@compute @workgroup_size(CLUSTER_MAX_TRIANGLES)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let lane = local.x;
    // Where there is no entry, the cluster has no vertices and no triangles: no lane leaves before the others.
    let entry = listed(LIST_SMALL, workgroup_number(workgroup));
    let number = select(entry, 0u, entry == NONE);
    look_at(number);
    let instance = visible[number].instance;
    let cluster = visible[number].cluster;
    let page = page_start(instance, cluster);
    let record = record_start(page, cluster);
    let counts = counts_of(record);
    let streams = streams_for(page, record, counts);
    let vertices = select(counts.x, 0u, entry == NONE);
    let triangles = select(counts.y, 0u, entry == NONE);
    let screen = screen_of(instance);
    let mirrored = mirrors(instance);
    let double_sided = shows_backs(instance, record);
    if lane == 0u {
        atomicStore(&drawn, 0u);
    }
    for (var v = lane; v < vertices; v += CLUSTER_MAX_TRIANGLES) {
        let p = project(homogeneous(screen, vertex_position(instance, streams, v)));
        snapped[v] = vec3<i32>(snap(p.x), snap(p.y), bitcast<i32>(p.z));
    }
    workgroupBarrier();
    var own = 0u;
    for (var t = lane; t < triangles; t += CLUSTER_MAX_TRIANGLES) {
        var corners = triangle_corners(streams, t);
        if !mirrored {
            corners = corners.xzy;
        }
        if draw(corners, double_sided, payload(number) - t) {
            own++;
        }
    }
    atomicAdd(&drawn, own);
    workgroupBarrier();
    if FIRST_PASS && lane == 0u {
        atomicAdd(&counters.drawn_small, atomicLoad(&drawn));
    }
}
