// Writes the visibility buffer without 64-bit atomics, in two passes: first the nearest key of every pixel, then the largest
// low half among those with that key. The halves lie as in a 64-bit word.

@group(0) @binding(5) var<storage, read_write> words: array<atomic<u32>>;

fn put(pixel: u32, key: u32, low: u32) {
    if FIRST_PASS {
        if atomicMax(&words[2u * pixel + 1u], key) < key {
            // What an earlier pass left is farther.
            atomicStore(&words[2u * pixel], 0u);
        }
    } else if atomicLoad(&words[2u * pixel + 1u]) == key {
        atomicMax(&words[2u * pixel], low);
    }
}
