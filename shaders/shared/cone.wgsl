// Clusters all of whose triangles face away: src/cpu/project.rs. Needs `view` and `instances`.

// `packed` is the cone of a cluster, whose vertices lie within a radius of its centre.
fn faces_away(instance: u32, center: vec3<f32>, radius: f32, packed: u32) -> bool {
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
    let to = center - eye;
    let along = to.x * cone.x + to.y * cone.y + to.z * cone.z;
    let distance = sqrt(to.x * to.x + to.y * to.y + to.z * to.z);
    return along >= cone.w * distance + radius;
}
