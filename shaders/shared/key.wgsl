// Words of the visibility buffer, or the keys that it has where depth alone is drawn.
// Needs: view, words.

// Whether a pixel shows anything.
fn covered_at(pixel: u32) -> bool {
    if view.depth_only != 0u {
        return words[pixel] != 0u;
    }
    return (words[2u * pixel] | words[2u * pixel + 1u]) != 0u;
}

// The key of a pixel, 0 where nothing is.
fn key_of(pixel: u32) -> u32 {
    return words[select(2u * pixel + 1u, pixel, view.depth_only != 0u)];
}
