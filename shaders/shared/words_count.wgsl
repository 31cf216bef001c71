// Counts the triangles that cover each pixel (overdraw) instead of writing a visibility buffer.

@group(0) @binding(5) var<storage, read_write> words: array<atomic<u32>>;

fn put(pixel: u32, key: u32, low: u32) {
    atomicAdd(&words[pixel], 1u);
}
