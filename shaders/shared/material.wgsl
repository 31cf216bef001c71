// Materials with textures: src/cpu/material.rs, operation for operation.
// Needs: surface.wgsl, texture.wgsl, materials, as_in_pyrender, to_eye_of.

fn uv_at(surfel: Surfel, uv_set: u32, corner: u32) -> vec2<f32> {
    let vertices = surfel.streams.colors - surfel.streams.normals;
    let colors = vertices * color_words(instance_materials[surfel.instance].flags);
    let at = surfel.streams.colors + colors + 2u * (uv_set * vertices + corner);
    return vec2<f32>(real(at), real(at + 1u));
}

// UVs of the corners of a triangle.
fn corner_uvs(surfel: Surfel, texture: Texture) -> array<vec2<f32>, 3> {
    let uv_set = texture.flags & 3u;
    let c = surfel.corners;
    return array<vec2<f32>, 3>(uv_at(surfel, uv_set, c.x), uv_at(surfel, uv_set, c.y), uv_at(surfel, uv_set, c.z));
}

fn uv_sum(w: vec3<f32>, uvs: array<vec2<f32>, 3>) -> vec2<f32> {
    return w.x * uvs[0] + w.y * uvs[1] + w.z * uvs[2];
}

// What a texture shows; white where there is none.
fn sample_of(surfel: Surfel, change: array<vec3<f32>, 2>, number: u32, slot: u32) -> vec4<f32> {
    if materials[number].textures[slot].start == NONE {
        return vec4<f32>(1.0);
    }
    let texture = materials[number].textures[slot];
    let uvs = corner_uvs(surfel, texture);
    let place =
        place_of(texture, uv_sum(surfel.weights, uvs), uv_sum(change[0], uvs), uv_sum(change[1], uvs));
    return sampled(texture, place);
}

fn no_vector(v: vec3<f32>) -> bool {
    return !(sqrt(dot3(v, v)) >= SMALLEST);
}

// The normal, with that of the texture, `map`, in the frame that the UVs give.
fn mapped_normal(surfel: Surfel, number: u32, map: vec3<f32>) -> vec3<f32> {
    let own = select(surfel.face, surfel.normal, (materials[number].flags & MATERIAL_SMOOTH) != 0u);
    if materials[number].textures[SLOT_NORMAL].start == NONE {
        return own;
    }
    let texture = materials[number].textures[SLOT_NORMAL];
    let uvs = corner_uvs(surfel, texture);
    let st1 = turned(texture, uvs[1] - uvs[0]);
    let st2 = turned(texture, uvs[2] - uvs[0]);
    let e1 = surfel.b - surfel.a;
    let e2 = surfel.c - surfel.a;
    let turn = select(1.0, -1.0, st1.x * st2.y - st2.x * st1.y < 0.0);
    let eye = to_eye_of(surfel.instance);
    let along = to_eye(eye, (e1 * st2.y - e2 * st1.y) * turn);
    let up = to_eye(eye, (e1 * st2.x - e2 * st1.x) * turn);
    let flat = along - own * dot3(own, along);
    if no_vector(flat) {
        return own;
    }
    let tangent = flat * (1.0 / sqrt(dot3(flat, flat)));
    let side = cross3(own, tangent);
    let sign = select(1.0, -1.0, !as_in_pyrender() && dot3(side, up) < 0.0);
    let scale = materials[number].normal_scale;
    let x = (2.0 * map.x - 1.0) * scale;
    let y = (2.0 * map.y - 1.0) * scale * sign;
    let z = 2.0 * map.z - 1.0;
    let bent = tangent * x + side * y + own * z;
    if no_vector(bent) {
        return own;
    }
    return bent * (1.0 / sqrt(dot3(bent, bent)));
}

fn to_eye(rows: array<vec4<f32>, 3>, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        rows[0].x * v.x + rows[0].y * v.y + rows[0].z * v.z,
        rows[1].x * v.x + rows[1].y * v.y + rows[1].z * v.z,
        rows[2].x * v.x + rows[2].y * v.y + rows[2].z * v.z,
    );
}

// The material of a cluster.
fn material_of(surfel: Surfel) -> u32 {
    let instance_material = instance_materials[surfel.instance];
    return instance_material.first_material + min(page_word(surfel.record + RECORD_MATERIAL), instance_material.last_material);
}
