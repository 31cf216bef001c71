// How much of each light reaches each pixel: src/cpu/shadow_test.rs. One invocation handles four pixels.
// Reads the visibility buffer, pages of meshes and of shadow maps. Writes numbers from 0 to 1, all lights of a pixel side by
// side; 1 where nothing is covered.
// Needs: frame_bindings.wgsl, surface.wgsl, unproject.wgsl, receiver.wgsl.

fn store_shares(pixel: u32, lights: u32) {
    let hit = hit_of(pixel);
    for (var number = 0u; number < lights; number++) {
        out[lights * pixel + number] = bitcast<u32>(1.0);
    }
    if !hit.covered {
        return;
    }
    let surfel = surfel_of(pixel, hit);
    let receiver = receiver_of(surfel, unprojected(surfel.point, surfel.distance));
    if !receiver.shadowed {
        return;
    }
    for (var number = 0u; number < lights; number++) {
        out[lights * pixel + number] = bitcast<u32>(shadow_reached(number, receiver.seen, receiver.point));
    }
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = 4u * (workgroup_number(workgroup) * WIDTH + lane);
    let pixels = view.width * view.height;
    let lights = shadow_table[0].x;
    for (var pixel = first; pixel < min(first + 4u, pixels); pixel++) {
        store_shares(pixel, lights);
    }
}
