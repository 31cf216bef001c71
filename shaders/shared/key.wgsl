// The key of a pixel, 0 where nothing is: the high half of its word, or all of it where depth alone is drawn.
// Needs: view, words.

fn key_of(pixel: u32) -> u32 {
    return words[select(2u * pixel + 1u, pixel, view.depth_only != 0u)];
}
