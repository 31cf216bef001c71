// Stage 8, outputs: makes one of the arrays that a caller asks for: src/cpu/output.rs, operation for operation.
// One invocation handles four pixels.
// Reads the visibility buffer and pages. Writes depth, normals, ids or a debug view.
// Needs: frame_bindings.wgsl, surface.wgsl, key.wgsl, hash.wgsl.

// A bright colour from random bits.
fn hue(bits: u32) -> vec3<f32> {
    let h = f32(bits & 0xffffu) / 65536.0;
    let value = HUE_VALUE_0 + HUE_VALUE_1 * (f32(bits >> 16u & 0xffu) / 255.0);
    let saturation = HUE_SATURATION_0 + HUE_SATURATION_1 * (f32(bits >> 24u) / 255.0);
    let t = h + vec3<f32>(0.0, 1.0 / 3.0, 2.0 / 3.0);
    let away = abs((t - floor(t)) * 6.0 - 3.0) - 1.0;
    return value * (1.0 - saturation * (1.0 - clamp(away, vec3<f32>(0.0), vec3<f32>(1.0))));
}

// Red, orange, yellow, green, cyan, blue over 0 to 1.
fn ramp(t: f32) -> vec3<f32> {
    let h = clamp(t, 0.0, 1.0) * RAMP_SIXTHS;
    let shifted = h + vec3<f32>(0.0, 4.0, 2.0);
    let turn = select(shifted, shifted - 6.0, shifted >= vec3<f32>(6.0));
    return RAMP_VALUE_0 + RAMP_VALUE_1 * clamp(abs(turn - 3.0) - 1.0, vec3<f32>(0.0), vec3<f32>(1.0));
}

// The colour of a debug view, darkened where the surface turns away.
fn identity_color(surfel: Surfel, triangle: u32) -> u32 {
    var color: vec3<f32>;
    if OUTPUT == OUTPUT_LEVELS {
        color = ramp(f32(page_word(surfel.record + RECORD_COUNTS) >> 16u & 0xffu) / RAMP_LEVELS);
    } else {
        var what = vec2<u32>(surfel.cluster, triangle);
        if OUTPUT == OUTPUT_CLUSTERS {
            what.y = 1u << 8u;
        }
        if OUTPUT == OUTPUT_GROUPS {
            what = vec2<u32>(page_word(surfel.record + RECORD_GROUP), 1u << 9u);
        }
        color = hue(hash(surfel.instance, what.x, what.y));
    }
    let facing = FACING_0 + FACING_1 * abs(surfel.normal.z);
    let bytes = vec3<u32>(color * facing * 255.0 + 0.5);
    return bytes.x | bytes.y << 8u | bytes.z << 16u;
}

fn store_rgb(first: u32, pixels: u32) {
    var rgb: array<u32, 4>;
    for (var i = 0u; i < 4u && first + i < pixels; i++) {
        let hit = hit_of(first + i);
        if hit.covered {
            rgb[i] = identity_color(surfel_of(first + i, hit), hit.triangle);
        }
    }
    store_bytes(first, rgb);
}

fn store_normal(pixel: u32) {
    let hit = hit_of(pixel);
    var normal = vec3<f32>(0.0);
    if hit.covered {
        let n = surfel_of(pixel, hit).normal;
        let r = view.rotate;
        // From camera space to the world: its rows are the columns of the way there.
        normal = vec3<f32>(
            n.x * r[0].x + n.y * r[1].x + n.z * r[2].x,
            n.x * r[0].y + n.y * r[1].y + n.z * r[2].y,
            n.x * r[0].z + n.y * r[1].z + n.z * r[2].z,
        );
    }
    for (var k = 0u; k < 3u; k++) {
        out[3u * pixel + k] = bitcast<u32>(normal[k]);
    }
}

// What one word says of a pixel.
fn word_of(pixel: u32) -> u32 {
    if OUTPUT == OUTPUT_DEPTH {
        let key = key_of(pixel);
        return select(0u, bitcast<u32>(distance_of(key)), key != 0u);
    }
    let hit = hit_of(pixel);
    switch OUTPUT {
        case OUTPUT_INSTANCE_ID: { return select(NONE, visible[hit.number].instance, hit.covered); }
        case OUTPUT_CLUSTER_ID: { return select(NONE, visible[hit.number].cluster, hit.covered); }
        default: { return select(NONE, hit.triangle, hit.covered); }
    }
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = 4u * (workgroup_number(workgroup) * WIDTH + lane);
    let pixels = view.width * view.height;
    if first >= pixels {
        return;
    }
    if OUTPUT_RGB {
        store_rgb(first, pixels);
        return;
    }
    for (var pixel = first; pixel < min(first + 4u, pixels); pixel++) {
        if OUTPUT == OUTPUT_NORMAL {
            store_normal(pixel);
        } else {
            out[pixel] = word_of(pixel);
        }
    }
}
