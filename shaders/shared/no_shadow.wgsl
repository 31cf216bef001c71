// A scene without shadows.
// Needs: surface.wgsl.

struct Receiver {
    none: u32,
}

fn receiver_of(surfel: Surfel, position: vec3<f32>) -> Receiver {
    return Receiver(0u);
}

// What is left of a light at a receiver.
fn lit_part(light: f32, number: u32, receiver: Receiver) -> f32 {
    return light;
}
