// Writes the visibility buffer by one 64-bit atomic maximum.

@group(0) @binding(5) var<storage, read_write> words: array<atomic<u64>>;

fn put(pixel: u32, key: u32, low: u32) {
    atomicMax(&words[pixel], (u64(key) << 32u) | u64(low));
}
