// Alpha-tested surfaces (glTF: mask): a pixel is covered where alpha is not below the cutoff.
// Needs: surface.wgsl, texture.wgsl, material.wgsl.

@group(0) @binding(12) var<storage, read> instance_materials: array<InstanceMaterial>;
@group(0) @binding(13) var<storage, read> materials: array<Material>;
@group(0) @binding(14) var<storage, read> texels: array<u32>;

// Holes do not depend on how the rest is shaded.
fn as_in_pyrender() -> bool {
    return false;
}

fn offer(pixel: u32, key: u32, low: u32) {
    let triangle = ~low & ((1u << TRIANGLE_BITS) - 1u);
    let surfel = surfel_of(pixel, Hit(true, key, (~low >> TRIANGLE_BITS) - 1u, triangle));
    let number = material_of(surfel);
    let alpha = sample_of(surfel, change_of(surfel), number, SLOT_BASE_COLOR).w;
    if !(materials[number].alpha * alpha < materials[number].alpha_cutoff) {
        put(pixel, key, low);
    }
}
