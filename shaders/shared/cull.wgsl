// Footprints: bounds of boxes on the screen. src/cpu/project.rs, operation for operation.
// Needs: exact.wgsl, view.

struct Footprint {
    // Some of it may be on the picture.
    seen: bool,
    clipped: bool,
    // Longer side of the rectangle, pixels.
    span: u32,
    // First column, first row, last column, last row, on the picture, of the pixels that it may cover.
    rect: vec4<u32>,
    // Key of a distance nearer than anything in the box; NO_KEY when it reaches the near plane.
    near_key: u32,
}

const NO_KEY: u32 = 0xffffffffu;
const UNSEEN: Footprint = Footprint(false, false, 0u, vec4<u32>(), NO_KEY);

// The key of a depth value: it grows towards the eye.
fn depth_key(value: f32) -> u32 {
    if view.orthographic != 0u {
        // What is behind the eye of a parallel view, which has no near plane then, is at it.
        return ~bitcast<u32>(select(0.0, value, value > 0.0));
    }
    return bitcast<u32>(value);
}

// Sums are written out, so that their order is known.
fn homogeneous(rows: array<vec4<f32>, 3>, p: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        inner(rows[0].xyz, p) + rows[0].w,
        inner(rows[1].xyz, p) + rows[1].w,
        inner(rows[2].xyz, p) + rows[2].w,
    );
}

fn reach(row: vec4<f32>, extent: vec3<f32>) -> f32 {
    return inner(abs(row.xyz), extent);
}

fn slack(row: vec4<f32>, center: vec3<f32>, extent: vec3<f32>) -> f32 {
    return times(FOOTPRINT_ROUNDING, inner(abs(row.xyz), abs(center)) + reach(row, extent) + abs(row.w));
}

fn plane_misses(p: vec4<f32>, center: vec3<f32>, extent: vec3<f32>, error: f32) -> bool {
    let at = inner(p.xyz, center) + p.w;
    return at + reach(p, extent) + error < 0.0;
}

fn footprint(rows: array<vec4<f32>, 3>, center: vec3<f32>, extent: vec3<f32>) -> Footprint {
    let parallel = view.orthographic != 0u;
    let c = homogeneous(rows, center);
    let slack0 = slack(rows[0], center, extent);
    let slack1 = slack(rows[1], center, extent);
    let slack2 = slack(rows[2], center, extent);
    let depth = reach(rows[2], extent);
    let nearest = c.z - depth - slack2;
    let farthest = c.z + depth + slack2;
    if farthest < view.near || nearest > view.far {
        return UNSEEN;
    }
    let size = vec2<f32>(f32(view.width), f32(view.height));
    let endless = view.near < -LARGEST;
    if !(nearest > view.near && (endless || slack2 < FOOTPRINT_SLACK * nearest)) {
        // It reaches the near plane: test the half spaces.
        for (var k = 0u; k < 2u; k++) {
            let error = select(slack0, slack1, k == 1u) + times(slack2, size[k] + 1.0);
            let low = select(rows[2], vec4<f32>(0.0, 0.0, 0.0, 1.0), parallel);
            let high = select(scaled(rows[2], size[k] + 1.0), vec4<f32>(0.0, 0.0, 0.0, size[k] + 1.0), parallel);
            if plane_misses(rows[k] + low, center, extent, error)
                || plane_misses(-rows[k] + high, center, extent, error) {
                return UNSEEN;
            }
        }
        let whole = vec4<u32>(0u, 0u, view.width - 1u, view.height - 1u);
        return Footprint(true, true, UNKNOWN_SPAN, whole, NO_KEY);
    }
    let scale = select(quotient(1.0, nearest), 1.0, parallel);
    let edge_x = times3(rows[0].xyz, extent);
    let edge_y = times3(rows[1].xyz, extent);
    let deep = times3(rows[2].xyz, extent);
    var low = vec2<f32>(3.0e38);
    var high = vec2<f32>(-3.0e38);
    for (var corner = 0u; corner < 8u; corner++) {
        let plus = vec3<bool>((corner & 1u) == 0u, (corner & 2u) == 0u, (corner & 4u) == 0u);
        let ex = select(-edge_x, edge_x, plus);
        let ey = select(-edge_y, edge_y, plus);
        let ed = select(-deep, deep, plus);
        var at = vec2<f32>(c.x + ex.x + ex.y + ex.z, c.y + ey.x + ey.y + ey.z);
        let d = c.z + ed.x + ed.y + ed.z;
        if !parallel {
            at = vec2<f32>(quotient(at.x, d), quotient(at.y, d));
        }
        low = min(low, at);
        high = max(high, at);
    }
    let widest = max(abs(low), abs(high));
    let across = select(vec2<f32>(times(widest.x, slack2), times(widest.y, slack2)), vec2<f32>(0.0), parallel);
    let error = FOOTPRINT_MARGIN + vec2<f32>(times(scale, slack0 + across.x), times(scale, slack1 + across.y));
    low = low - error;
    high = high + error;
    // The pixels whose centres lie inside: what has none is never drawn.
    let first = vec2<u32>(clamp(low + 0.5, vec2<f32>(0.0), size));
    let end = vec2<u32>(clamp(high + 0.5, vec2<f32>(0.0), size));
    if any(first >= end) {
        return UNSEEN;
    }
    let span = max(high.x - low.x, high.y - low.y);
    let inside = all(abs(low) < vec2<f32>(GUARD_BAND)) && all(abs(high) < vec2<f32>(GUARD_BAND));
    let value = select(times(quotient(view.near, nearest), 1.0 + FOOTPRINT_ROUNDING), nearest, parallel);
    let clipped = !inside || farthest > view.far;
    let rect = vec4<u32>(first, end - 1u);
    return Footprint(true, clipped, u32(min(span, f32(UNKNOWN_SPAN))), rect, depth_key(value));
}
