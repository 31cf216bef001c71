// Writes a visibility buffer of keys alone by one 32-bit atomic maximum.

@group(0) @binding(5) var<storage, read_write> words: array<atomic<u32>>;

fn put(pixel: u32, key: u32, low: u32) {
    atomicMax(&words[pixel], key);
}
