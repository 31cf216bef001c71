// Tiles of the screen that clusters of a pass may cover: one bit each, at most TILES across and down.
// Needs: view, counters.

// Pixels across and down of a tile, as a power of two.
fn tile_bits() -> u32 {
    return 32u - countLeadingZeros((max(view.width, view.height) - 1u) / TILES);
}

// Of the rows of tiles that a rectangle of pixels, both ends included, touches: the first, the last, and the columns.
fn tiles_of(rect: vec4<u32>) -> vec3<u32> {
    let tiles = rect >> vec4<u32>(tile_bits());
    return vec3<u32>(tiles.y, tiles.w, (NONE << tiles.x) & (NONE >> (TILES - 1u - tiles.z)));
}

fn touch(rect: vec4<u32>) {
    let tiles = tiles_of(rect);
    for (var row = tiles.x; row <= tiles.y; row++) {
        // Mostly others did.
        if (atomicLoad(&counters.tiles[row]) & tiles.z) != tiles.z {
            atomicOr(&counters.tiles[row], tiles.z);
        }
    }
}

fn touched(rect: vec4<u32>) -> bool {
    let tiles = tiles_of(rect);
    for (var row = tiles.x; row <= tiles.y; row++) {
        if (atomicLoad(&counters.tiles[row]) & tiles.z) != 0u {
            return true;
        }
    }
    return false;
}
