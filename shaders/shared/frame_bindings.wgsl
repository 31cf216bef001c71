// Bindings of all kernels that read a finished visibility buffer and write an array of it.
// Needs: seen.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> pages: array<u32>;
@group(0) @binding(4) var<storage, read> pages_1: array<u32>;
@group(0) @binding(5) var<storage, read> pages_2: array<u32>;
@group(0) @binding(6) var<storage, read> pages_3: array<u32>;
@group(0) @binding(7) var<storage, read> visible: array<VisibleCluster>;
@group(0) @binding(8) var<storage, read> instance_materials: array<InstanceMaterial>;
@group(0) @binding(9) var<storage, read> words: array<u32>;
@group(0) @binding(10) var<storage, read_write> out: array<u32>;

fn hit_of(pixel: u32) -> Hit {
    let low = words[2u * pixel];
    let number = (~low >> TRIANGLE_BITS) - 1u;
    // A number beyond the list is none of this frame's.
    let covered = low != 0u && number < arrayLength(&visible);
    return Hit(covered, words[2u * pixel + 1u], number, ~low & ((1u << TRIANGLE_BITS) - 1u));
}

// Three bytes per pixel: four pixels are three words.
fn store_bytes(first: u32, rgb: array<u32, 4>) {
    let at = first / 4u * 3u;
    out[at] = rgb[0] | rgb[1] << 24u;
    out[at + 1u] = rgb[1] >> 8u | rgb[2] << 16u;
    out[at + 2u] = rgb[2] >> 16u | rgb[3] << 8u;
}
