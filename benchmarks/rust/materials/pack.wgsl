// The picture of either way -> the product's array, four pixels a lane.

@group(1) @binding(1) var picture: texture_2d<u32>;

@compute @workgroup_size(WIDTH)
fn pack(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = 4u * (workgroup_number(workgroup) * WIDTH + lane);
    let pixels = view.width * view.height;
    if first >= pixels {
        return;
    }
    var rgb: array<u32, 4>;
    for (var i = 0u; i < 4u; i++) {
        rgb[i] = lighting.background;
        let pixel = first + i;
        if pixel < pixels {
            let bytes = textureLoad(picture, vec2<u32>(pixel % view.width, pixel / view.width), 0).x;
            if bytes != NONE {
                rgb[i] = bytes;
            }
        }
    }
    store_bytes(first, rgb);
}
