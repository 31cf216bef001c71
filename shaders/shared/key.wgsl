// The key of a pixel, 0 where nothing is: the high half of its word, or where depth is all that is asked for the whole.
// Needs `view` and `words`.

fn key_of(pixel: u32) -> u32 {
    return words[select(2u * pixel + 1u, pixel, view.depth_only != 0u)];
}
