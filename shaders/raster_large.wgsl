// Stage 5, software rasterizer for large triangles, for clusters that cross the near plane, the far plane or the guard band,
// and for alpha-tested clusters of any size: src/cpu/raster_large.rs, operation for operation.
// One workgroup handles one cluster; each invocation clips one triangle, then all rows are shared out.
// Reads the lists of large, clipped or alpha-tested clusters and their pages. Writes the visibility buffer by atomic maxima.
// Needs: triangle.wgsl, double_single.wgsl, int64.wgsl, workgroup_scan.wgsl, offer, listed, look_at, screen_of, mirrors, shows_backs.

// A triangle cut by five planes has eight corners at most.
const MOST_CORNERS: u32 = 8u;
const CORNERS: u32 = MOST_CORNERS * CLUSTER_MAX_TRIANGLES;

// Triangles that face the eye and have a pixel to offer.
var<workgroup> drawn: atomic<u32>;
// The clipped polygons, snapped, with their depth values; and of each the corners and the rows up to its end.
var<workgroup> snapped: array<vec2<i32>, CORNERS>;
var<workgroup> values: array<f32, CORNERS>;
var<workgroup> corner_counts: array<u32, CLUSTER_MAX_TRIANGLES>;

struct Polygon {
    corners: array<vec3<f32>, MOST_CORNERS>,
    count: u32,
}

// Distance to one of five planes, inside at 0 and above.
fn inside(p: vec3<f32>, plane: u32) -> DoubleSingle {
    if plane == 0u {
        return pair_sum(p.z, -view.near);
    }
    let guard = pair_product(GUARD_BAND, select(p.z, 1.0, view.orthographic != 0u));
    switch plane {
        case 1u: { return pair_plus(guard, DoubleSingle(p.x, 0.0)); }
        case 2u: { return pair_plus(guard, DoubleSingle(-p.x, 0.0)); }
        case 3u: { return pair_plus(guard, DoubleSingle(p.y, 0.0)); }
        default: { return pair_plus(guard, DoubleSingle(-p.y, 0.0)); }
    }
}

fn comes_after(a: vec3<f32>, b: vec3<f32>) -> bool {
    if a.x != b.x {
        return a.x > b.x;
    }
    if a.y != b.y {
        return a.y > b.y;
    }
    return a.z > b.z;
}

// From the smaller to the larger end, so that the two triangles of an edge agree.
fn intersection(a: vec3<f32>, da: DoubleSingle, b: vec3<f32>, db: DoubleSingle) -> vec3<f32> {
    if comes_after(a, b) {
        return crossing(b, db, a, da);
    }
    return crossing(a, da, b, db);
}

fn crossing(a: vec3<f32>, da: DoubleSingle, b: vec3<f32>, db: DoubleSingle) -> vec3<f32> {
    let length = pair_minus(db, da);
    return vec3<f32>(
        pair_over(pair_minus(pair_times(db, a.x), pair_times(da, b.x)), length),
        pair_over(pair_minus(pair_times(db, a.y), pair_times(da, b.y)), length),
        pair_over(pair_minus(pair_times(db, a.z), pair_times(da, b.z)), length),
    );
}

fn cut(polygon: Polygon, plane: u32) -> Polygon {
    var before = polygon;
    var out: Polygon;
    out.count = 0u;
    for (var i = 0u; i < before.count; i++) {
        let a = before.corners[i];
        let b = before.corners[select(i + 1u, 0u, i + 1u == before.count)];
        let da = inside(a, plane);
        let db = inside(b, plane);
        if da.high >= 0.0 && out.count < MOST_CORNERS {
            out.corners[out.count] = a;
            out.count++;
        }
        if (da.high >= 0.0) != (db.high >= 0.0) && out.count < MOST_CORNERS {
            out.corners[out.count] = intersection(a, da, b, db);
            out.count++;
        }
    }
    return out;
}

fn is_whole(p: vec3<f32>) -> bool {
    let guard = GUARD_BAND * select(p.z, 1.0, view.orthographic != 0u);
    return p.z >= view.near && abs(p.x) < guard && abs(p.y) < guard;
}

// Clips and snaps a lane's triangle.
fn set_up(lane: u32, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) {
    var polygon: Polygon;
    polygon.corners[0] = a;
    polygon.corners[1] = b;
    polygon.corners[2] = c;
    polygon.count = 3u;
    if !(is_whole(a) && is_whole(b) && is_whole(c)) {
        for (var plane = 0u; plane < 5u; plane++) {
            polygon = cut(polygon, plane);
        }
    }
    for (var i = 0u; i < polygon.count; i++) {
        let p = project(polygon.corners[i]);
        snapped[MOST_CORNERS * lane + i] = vec2<i32>(snap(p.x), snap(p.y));
        values[MOST_CORNERS * lane + i] = p.z;
    }
    corner_counts[lane] = polygon.count;
}

// A triangle of a polygon's fan: numbers of its corners, in the order that has the inside on the right of each edge.
struct Piece {
    corners: vec3<u32>,
    area: Wide,
    // First and last row on the picture; empty when first > last.
    rows: vec2<i32>,
}

fn piece(polygon: u32, number: u32, double_sided: bool) -> Piece {
    let first = MOST_CORNERS * polygon;
    var corners = vec3<u32>(first, first + number + 1u, first + number + 2u);
    let a = snapped[corners.x];
    let b = snapped[corners.y];
    let c = snapped[corners.z];
    let nothing = Piece(corners, Wide(0, 0u), vec2<i32>(0, -1));
    var area = edge_function(a, b, c);
    let columns = pixel_range(min(min(a.x, b.x), c.x), max(max(a.x, b.x), c.x));
    var rows = pixel_range(min(min(a.y, b.y), c.y), max(max(a.y, b.y), c.y));
    rows = vec2<i32>(max(rows.x, 0), min(rows.y, i32(view.height) - 1));
    if max(columns.x, 0) > min(columns.y, i32(view.width) - 1) || rows.x > rows.y {
        return nothing;
    }
    if area.high < 0 {
        if !double_sided {
            return nothing;
        }
        corners = corners.xzy;
        area = wide_negate(area);
    } else if area.high == 0 && area.low == 0u {
        return nothing;
    }
    return Piece(corners, area, rows);
}

// An edge function along a row: biased value at column 0, step per column, bias.
struct Edge {
    start: Wide,
    step: i32,
    bias: i32,
}

fn edge(a: vec2<i32>, b: vec2<i32>, row: i32) -> Edge {
    let d = b - a;
    let bias = edge_bias(d);
    let at = wide_add(wide_product(d.x, row * UNIT + UNIT / 2 - a.y), wide_product(-d.y, UNIT / 2 - a.x));
    return Edge(wide_add(at, wide(bias)), -d.y * UNIT, bias);
}

fn at_column(e: Edge, column: i32) -> Wide {
    return wide_add(e.start, wide_product(e.step, column));
}

// The columns of `span` where an edge function is not negative. A quotient is off by less than one where it matters.
fn narrow(span: vec2<i32>, e: Edge) -> vec2<i32> {
    if e.step == 0 {
        return select(span, vec2<i32>(0, -1), e.start.high < 0);
    }
    let zero = -wide_estimate(e.start) / f32(e.step);
    if e.step > 0 {
        var left = i32(clamp(zero, f32(span.x) + 1.0, f32(span.y) + 2.0)) - 1;
        for (var i = 0u; i < 3u && left <= span.y && at_column(e, left).high < 0; i++) {
            left++;
        }
        return vec2<i32>(left, span.y);
    }
    var right = i32(clamp(zero, f32(span.x) - 2.0, f32(span.y) - 1.0)) + 1;
    for (var i = 0u; i < 3u && right >= span.x && at_column(e, right).high < 0; i++) {
        right--;
    }
    return vec2<i32>(span.x, right);
}

// Of a biased edge function, the weight of the corner on the other side.
fn weight(value: Wide, bias: i32) -> f32 {
    return wide_nearest(wide_add(value, wide(-bias)));
}

fn fill(p: Piece, row: i32, low: u32) {
    let a = snapped[p.corners.x];
    let b = snapped[p.corners.y];
    let c = snapped[p.corners.z];
    let v = vec3<f32>(values[p.corners.x], values[p.corners.y], values[p.corners.z]);
    let e0 = edge(b, c, row);
    let e1 = edge(c, a, row);
    let e2 = edge(a, b, row);
    let span = narrow(narrow(narrow(vec2<i32>(0, i32(view.width) - 1), e0), e1), e2);
    if span.x > span.y {
        return;
    }
    let inverse = quotient(1.0, wide_nearest(p.area));
    var at0 = at_column(e0, span.x);
    var at1 = at_column(e1, span.x);
    var at2 = at_column(e2, span.x);
    for (var column = span.x; column <= span.y; column++) {
        let weights = vec3<f32>(weight(at0, e0.bias), weight(at1, e1.bias), weight(at2, e2.bias));
        let key = depth_key(mean(weights, v, inverse));
        if key >= view.far_key {
            offer(pixel_address(u32(column), u32(row)), key, low);
        }
        at0 = wide_add(at0, wide(e0.step));
        at1 = wide_add(at1, wide(e1.step));
        at2 = wide_add(at2, wide(e2.step));
    }
}

@compute @workgroup_size(CLUSTER_MAX_TRIANGLES)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let list = select(select(LIST_CLIPPED, LIST_LARGE, view.viewport == 0u), LIST_ALPHA_TESTED, ALPHA_TESTED);
    let number = listed(list, workgroup_number(workgroup));
    if number == NONE {
        return;
    }
    look_at(number);
    let instance = visible[number].instance;
    let cluster = visible[number].cluster;
    let page = page_start(instance, cluster);
    let record = record_start(page, cluster);
    let streams = streams_of(page, record);
    let double_sided = shows_backs(instance, record);
    let rows = screen_of(instance);
    var height = 0u;
    if lane < triangle_count(record) {
        var corners = triangle_corners(streams, lane);
        if !mirrors(instance) {
            corners = corners.xzy;
        }
        let a = homogeneous(rows, vertex_position(instance, streams, corners.x));
        let b = homogeneous(rows, vertex_position(instance, streams, corners.y));
        let c = homogeneous(rows, vertex_position(instance, streams, corners.z));
        set_up(lane, a, b, c);
        for (var i = 0u; i + 2u < corner_counts[lane]; i++) {
            let p = piece(lane, i, double_sided);
            height += u32(p.rows.y - p.rows.x + 1);
        }
    }
    if lane == 0u {
        atomicStore(&drawn, 0u);
    }
    inclusive_sum(lane, height);
    if height > 0u {
        atomicAdd(&drawn, 1u);
    }
    let total = lanes[CLUSTER_MAX_TRIANGLES - 1u];
    for (var item = lane; item < total; item += CLUSTER_MAX_TRIANGLES) {
        // The first triangle whose rows end after this one.
        var triangle = 0u;
        for (var step = CLUSTER_MAX_TRIANGLES / 2u; step > 0u; step /= 2u) {
            if lanes[triangle + step - 1u] <= item {
                triangle += step;
            }
        }
        var row = item;
        if triangle > 0u {
            row -= lanes[triangle - 1u];
        }
        for (var i = 0u; i + 2u < corner_counts[triangle]; i++) {
            let p = piece(triangle, i, double_sided);
            let count = u32(p.rows.y - p.rows.x + 1);
            if row < count {
                fill(p, p.rows.x + i32(row), payload(number) - triangle);
                break;
            }
            row -= count;
        }
    }
    workgroupBarrier();
    if FIRST_PASS && lane == 0u {
        atomicAdd(&counters.drawn_large, atomicLoad(&drawn));
    }
}
