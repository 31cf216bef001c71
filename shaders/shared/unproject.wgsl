// From the picture to camera space: `position` of src/cpu/surface.rs.
// Needs: exact.wgsl, view.

// Distance along the axis of sight of what has a key.
fn distance_of(key: u32) -> f32 {
    if view.orthographic != 0u {
        return bitcast<f32>(~key);
    }
    return quotient(view.near, bitcast<f32>(key));
}

// Of a point of the picture, pixels, and a distance along the axis of sight. The same bits in every kernel: what marks a page
// of a shadow map, and what looks it up, are two.
fn unprojected(point: vec2<f32>, distance: f32) -> vec3<f32> {
    let scale = select(distance, 1.0, view.orthographic != 0u);
    let at = point - view.center;
    let up = times(-at.y, view.inverse_focal.y);
    let right = times(at.x - times(up, view.skew), view.inverse_focal.x);
    return vec3<f32>(times(right, scale), times(up, scale), -distance);
}
