// Backface culling of clusters by their cones: src/cpu/project.rs.
// Needs: exact.wgsl, view, instances.

// `packed` is the cone of a cluster, whose vertices lie within a radius of its centre.
fn faces_away(instance: u32, center: vec3<f32>, radius: f32, packed: u32) -> bool {
    let cone = vec4<f32>(
        quotient(f32(extractBits(i32(packed), 0u, 8u)), CONE_STEPS),
        quotient(f32(extractBits(i32(packed), 8u, 8u)), CONE_STEPS),
        quotient(f32(extractBits(i32(packed), 16u, 8u)), CONE_STEPS),
        quotient(f32(extractBits(i32(packed), 24u, 8u)), CONE_STEPS),
    );
    if cone.w >= 1.0 {
        return false;
    }
    let eye = instances[instance].eye;
    if view.orthographic != 0u {
        return inner(eye, cone.xyz) >= cone.w;
    }
    let to = center - eye;
    let along = inner(to, cone.xyz);
    let distance = root(inner(to, to));
    return along >= times(cone.w, distance) + radius;
}
