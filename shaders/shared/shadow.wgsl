// A scene whose lights throw shadows.
// Needs: receiver.wgsl.

// What is left of a light at a receiver.
fn lit_part(light: f32, number: u32, receiver: Receiver) -> f32 {
    if !receiver.shadowed || light == 0.0 {
        return light;
    }
    return light * shadow_reached(number, receiver.seen, receiver.point);
}
