// Surface points as receivers of shadows: `Receivers::new` of src/cpu/shadow_test.rs and `receiver_error` of
// src/cpu/surface.rs.
// Needs: surface.wgsl, shadow_soft.wgsl.

// A surface point on which shadows may fall.
struct Receiver {
    // No shadow falls on it where this is false.
    shadowed: bool,
    // On the picture.
    point: vec2<f32>,
    seen: ShadowReceiver,
}

// By how much what is drawn of a cluster may be off its source, world units: its own error, and rounding.
fn receiver_error(instance: u32, record: u32) -> f32 {
    let own = max(real(record + RECORD_ERROR), 0.0);
    return times(own + instances[instance].rounding + SHADOW_ROUNDING, instances[instance].lod_scale);
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
