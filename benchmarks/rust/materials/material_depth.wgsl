// Materials as depth: each pixel's number goes to a depth buffer, then a triangle for each material covers the picture at
// its depth, and the test for equal depths leaves it its own pixels.

// Exact for as many numbers as a float counts; 0 where nothing is.
fn depth_of(material: u32) -> f32 {
    return f32(material + 1u) * (1.0 / 65536.0);
}

@vertex
fn corner(@builtin(vertex_index) vertex: u32) -> @builtin(position) vec4<f32> {
    let x = select(-1.0, 3.0, vertex == 1u);
    let y = select(-1.0, 3.0, vertex == 2u);
    return vec4<f32>(x, y, depth_of(turn.material), 1.0);
}

fn pixel_at(at: vec4<f32>) -> u32 {
    return u32(at.y) * view.width + u32(at.x);
}

@fragment
fn write_depth(@builtin(position) at: vec4<f32>) -> @builtin(frag_depth) f32 {
    return depth_of(material_at(pixel_at(at)));
}

@fragment
fn shade_pixel(@builtin(position) at: vec4<f32>) -> @location(0) u32 {
    return color_at(pixel_at(at));
}
