// Where the pixels of a view lie in its target. No other place knows.
// Needs: view.

// The word of a pixel: row by row from the first on. Those of a row follow each other.
fn pixel_address(x: u32, y: u32) -> u32 {
    return view.first_word + y * view.width + x;
}

// The pixel of a word.
fn pixel_of(address: u32) -> vec2<u32> {
    let pixel = address - view.first_word;
    return vec2<u32>(pixel % view.width, pixel / view.width);
}
