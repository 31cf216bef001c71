// Opaque surfaces: every pixel inside a triangle is covered.

fn offer(pixel: u32, key: u32, low: u32) {
    put(pixel, key, low);
}
