// Surface points as receivers of shadows: `Receivers::new` of src/cpu/shadow_test.rs.
// Needs: surface.wgsl, receiver_error.wgsl, shadow_march.wgsl.

// A surface point on which shadows may fall.
struct Receiver {
    // No shadow falls on it where this is false.
    shadowed: bool,
    // On the picture.
    point: vec2<f32>,
    seen: ShadowReceiver,
}

// Of a surface point in camera space.
fn receiver_of(surfel: Surfel, position: vec3<f32>) -> Receiver {
    let shadowed = (instance_materials[surfel.instance].flags & MATERIAL_SHADOWED) != 0u;
    let away = select(dot3(surfel.face, position), -surfel.face.z, view.orthographic != 0u);
    let sign = select(1.0, -1.0, away > 0.0);
    let error = receiver_error(surfel.instance, surfel.record);
    let seen = ShadowReceiver(position, sign * surfel.face, sign * surfel.normal, error);
    return Receiver(shadowed, surfel.point, seen);
}
