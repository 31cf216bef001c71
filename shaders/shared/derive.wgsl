// Instance transforms for a view: src/cpu/project.rs, operation for operation.
// Needs: exact.wgsl, cull.wgsl, view.

// `skewed` is what of the rows up the picture goes to the right.
fn screen_row(k: u32, row: vec4<f32>, skewed: vec4<f32>, distance: vec4<f32>) -> vec4<f32> {
    if view.orthographic != 0u {
        return scaled(row, view.focal[k]) + skewed + vec4<f32>(0.0, 0.0, 0.0, view.center[k]);
    }
    return scaled(row, view.focal[k]) + skewed + scaled(distance, view.center[k]);
}

// The origin of internal space as seen from the eye, world axes.
fn way_to(p: InstanceTransform) -> vec3<f32> {
    var way: vec3<f32>;
    for (var k = 0u; k < 3u; k++) {
        way[k] = (p.linear[k].w - view.rotate[k].w) + (p.inverse[k].w - view.low[k]);
    }
    return way;
}

// Rows of the map from internal to camera space.
fn eye_rows(p: InstanceTransform) -> array<vec4<f32>, 3> {
    var rows: array<vec4<f32>, 3>;
    let way = way_to(p);
    let x = vec3<f32>(p.linear[0].x, p.linear[1].x, p.linear[2].x);
    let y = vec3<f32>(p.linear[0].y, p.linear[1].y, p.linear[2].y);
    let z = vec3<f32>(p.linear[0].z, p.linear[1].z, p.linear[2].z);
    for (var k = 0u; k < 3u; k++) {
        let r = view.rotate[k].xyz;
        rows[k] = vec4<f32>(inner(r, x), inner(r, y), inner(r, z), inner(r, way));
    }
    return rows;
}

// Rows of the map from internal to homogeneous screen space, of that to camera space.
fn screen_rows(rows: array<vec4<f32>, 3>) -> array<vec4<f32>, 3> {
    let distance = -rows[2];
    return array<vec4<f32>, 3>(
        screen_row(0u, rows[0], scaled(rows[1], view.skew), distance),
        screen_row(1u, rows[1], vec4<f32>(), distance),
        distance,
    );
}

// `before` are the rows of the frame before. Where its box lies is not known yet.
fn derive(p: InstanceTransform, before: array<vec4<f32>, 3>) -> Instance {
    let rows = eye_rows(p);
    let way = way_to(p);
    let parallel = view.orthographic != 0u;
    let to = select(-way, view.forward, parallel);
    var eye = vec3<f32>(inner(p.inverse[0].xyz, to), inner(p.inverse[1].xyz, to), inner(p.inverse[2].xyz, to));
    if parallel {
        let length = root(inner(eye, eye));
        let unit = vec3<f32>(quotient(eye.x, length), quotient(eye.y, length), quotient(eye.z, length));
        eye = select(vec3<f32>(0.0), unit, length > 0.0);
    }
    return Instance(
        screen_rows(rows),
        before,
        rows,
        p.center,
        p.lod_scale,
        p.extent,
        view.lod_focal,
        eye,
        NO_KEY,
        p.first_node,
        p.first_group,
        p.first_page,
        p.group_words,
        p.double_sided,
        p.mirrored ^ view.mirrored,
        p.alpha_tested,
        p.rounding,
        vec4<u32>(),
    );
}
