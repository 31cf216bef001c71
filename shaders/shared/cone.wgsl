// Clusters all of whose triangles face away: src/cpu/project.rs. Needs `pages` and `instances`.

fn faces_away(instance: u32, record: u32) -> bool {
    let packed = page_word(record + RECORD_CONE);
    let cone = vec4<f32>(
        f32(extractBits(i32(packed), 0u, 8u)) / 127.0,
        f32(extractBits(i32(packed), 8u, 8u)) / 127.0,
        f32(extractBits(i32(packed), 16u, 8u)) / 127.0,
        f32(extractBits(i32(packed), 24u, 8u)) / 127.0,
    );
    if cone.w >= 1.0 {
        return false;
    }
    let eye = instances[instance].eye;
    if view.orthographic != 0u {
        return eye.x * cone.x + eye.y * cone.y + eye.z * cone.z >= cone.w;
    }
    let to = reals(record + RECORD_CENTER) - eye;
    let along = to.x * cone.x + to.y * cone.y + to.z * cone.z;
    let distance = sqrt(to.x * to.x + to.y * to.y + to.z * to.z);
    return along >= cone.w * distance + real(record + RECORD_RADIUS);
}
