// Instances as seen from the one view of a kernel.
// Needs: instances.

// Rows of the map from internal space to homogeneous screen space.
fn screen_of(instance: u32) -> array<vec4<f32>, 3> {
    return instances[instance].screen;
}

// Rows of the map from internal to camera space.
fn to_eye_of(instance: u32) -> array<vec4<f32>, 3> {
    return instances[instance].object_to_eye;
}
