// How much of a light reaches a receiver: of one with a size, by rays to points of it that are marched through the levels of
// its map: src/cpu/shadow_soft.rs.
// Needs: shadow_range.wgsl.

// Where a ray is that has gone so far to the side, the outermost ones, in texels of the receiver.
fn shadow_point(light: ShadowLight, start: ShadowStart, aside: vec3<f32>, side: f32) -> vec3<f32> {
    let risen = shadow_risen(light, start, side);
    if shadow_parallel(light) {
        return start.moved.at + vec3<f32>(aside.xy, 1.0) * risen;
    }
    return aside * risen + start.moved.at * (1.0 - risen);
}

// How high a point of a ray is, as the map has it.
fn shadow_point_height(light: ShadowLight, at: vec3<f32>, face: u32) -> f32 {
    return shadow_in_face(light, face, at).z;
}

// Whether something is in the way of a ray in some bands. `own` is what the map says where it begins.
fn shadow_blocked(light: ShadowLight, start: ShadowStart, aside: vec3<f32>, own: f32, bands: u32) -> bool {
    let moved = start.moved;
    let parallel = shadow_parallel(light);
    // It leaves the triangle backwards.
    let way = select(aside - moved.at, vec3<f32>(aside.xy, 1.0), parallel);
    if !(inner(moved.normal, way) > 0.0) {
        return true;
    }
    // What the map says where the ray was last.
    var before = own;
    for (var band = 0u; band < start.bands; band++) {
        if (bands >> band & 1u) == 0u {
            continue;
        }
        // Bands are as wide as the way to them.
        let width = shadow_power(i32(band));
        let count = min(1u << band, SHADOW_BAND_STEPS);
        let side = width / f32(count);
        if band > 0u && (bands >> (band - 1u) & 1u) == 0u {
            let level = shadow_climbed(light, moved.level, band - 1u);
            let last = width - 0.25 * width / f32(min(1u << (band - 1u), SHADOW_BAND_STEPS));
            let slab = shadow_slab(light, level, moved.at.z);
            before = shadow_sample(light, shadow_point(light, start, aside, last), level, slab).height;
        }
        let raised = shadow_raised(light, start, band);
        // As high as the band before left off, so that nothing is between the two.
        var raised_before = shadow_raised(light, start, max(band, 1u) - 1u);
        let level = shadow_climbed(light, moved.level, band);
        let slab = shadow_slab(light, level, moved.at.z);
        let texel = moved.texel * shadow_power(level - moved.level) * SHADOW_SOFT_STEP;
        var entry = 0.0;
        for (var step = 0u; step < count; step++) {
            let from_side = width + f32(step) * side;
            let to_side = width + f32(step + 1u) * side;
            let middle = shadow_point(light, start, aside, 0.5 * (from_side + to_side));
            let found = shadow_sample(light, middle, level, slab);
            let c = found.height;
            var from_height = entry;
            if !(parallel && step > 0u) {
                let at = shadow_point(light, start, aside, from_side);
                from_height = shadow_point_height(light, at, found.face) + raised_before;
            }
            let at = shadow_point(light, start, aside, to_side);
            var to_height = shadow_point_height(light, at, found.face) + raised;
            // Where rays end, nothing is above them.
            if band + 1u == start.bands && step + 1u == count {
                to_height = LARGEST;
            }
            entry = to_height;
            raised_before = raised;
            let left = select(1.0 - shadow_risen(light, start, to_side), 1.0, parallel);
            let fall = texel * max(left, 0.0);
            let ground = start.height + start.lean * to_side * moved.texel;
            // It was below, and is above. If that is one surface, it is hit. If the ray comes out from under an edge,
            // something else begins there: if that is above the receiver, the ray came through it, below the edge, where the
            // light does not see it.
            let crossed = c > from_height && c <= to_height;
            let passed = before > from_height && c <= from_height && (before - c <= fall || c > ground);
            if crossed || passed {
                return true;
            }
            before = c;
        }
    }
    return false;
}

// Between 0 and 1, evenly over any few neighbouring pixels, and always the same for a place on the picture.
//
// Jimenez, "Next Generation Post Processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014.
fn shadow_noise(point: vec2<f32>) -> f32 {
    let wave = times(0.06711056, point.x) + times(0.00583715, point.y);
    return fract(times(52.982918, fract(wave)));
}

// How much of a light with a size a receiver on a pixel sees.
fn shadow_share(light: ShadowLight, receiver: ShadowReceiver, point: vec2<f32>) -> f32 {
    let moved = shadow_moved(light, receiver);
    if moved.outcome != SHADOW_LOOKS_UP {
        return f32(moved.outcome == SHADOW_LIT);
    }
    let start = shadow_start(light, moved);
    let slab = shadow_slab(light, moved.level, moved.at.z);
    // What the light sees there, which rays leave by no more than a texel.
    let own = shadow_sample(light, moved.at, moved.level, slab).height;
    let next = shadow_risen(light, start, 1.0);
    let parallel = shadow_parallel(light);
    let high = select(start.height * (1.0 - next), start.height + next, parallel);
    if own > start.height + shadow_raised(light, start, 0u) && own <= high {
        return 0.0;
    }
    let bands = shadow_undecided(light, start);
    // All of the light is above the horizon of the triangle.
    let above = select(-inner(moved.normal, moved.at), moved.normal.z, parallel) > light.radius;
    if bands == 0u && above && own <= high {
        return 1.0;
    }
    // Less half a turn, where sines are most exact.
    let turn = (shadow_noise(point) - 0.5) * SHADOW_TAU;
    let sine = -sin(turn);
    let cosine = -cos(turn);
    var dark = 0u;
    for (var number = 0u; number < light.samples; number++) {
        let pair = bitcast<vec4<f32>>(shadow_table[light.points + number / 2u]);
        let on_disk = select(pair.xy, pair.zw, (number & 1u) == 1u);
        let x = cosine * on_disk.x - sine * on_disk.y;
        let y = sine * on_disk.x + cosine * on_disk.y;
        let aside = x * start.right + y * start.up;
        dark += u32(shadow_blocked(light, start, aside, own, bands));
    }
    return 1.0 - f32(dark) / f32(light.samples);
}

// How much of a light reaches a receiver on a pixel: 1 or 0, or, of a light with a size, a part.
fn shadow_reached(number: u32, receiver: ShadowReceiver, point: vec2<f32>) -> f32 {
    let light = shadow_light(number);
    if light.kind == SHADOW_NONE {
        return 1.0;
    }
    if shadow_soft(light) {
        return shadow_share(light, receiver, point);
    }
    return f32(shadow_lit(light, receiver));
}
