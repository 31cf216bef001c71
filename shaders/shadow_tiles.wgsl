// Pages of shadow maps: the least and the largest key of each tile, and of all: src/shadow/page.rs.
// One workgroup handles one page, each invocation a tile.
// Reads the keys of pages that were drawn. Writes behind them.

@group(0) @binding(0) var<storage, read> page_views: array<View>;
@group(0) @binding(1) var<storage, read_write> words: array<u32>;

var<workgroup> least: atomic<u32>;
var<workgroup> largest: atomic<u32>;

@compute @workgroup_size(SHADOW_TILES)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) tile: u32,
) {
    let page = workgroup_number(workgroup);
    if tile == 0u {
        atomicStore(&least, NONE);
        atomicStore(&largest, 0u);
    }
    workgroupBarrier();
    // There is at least one; those behind the last do it again.
    let first = page_views[min(page, arrayLength(&page_views) - 1u)].first_word;
    let across = SHADOW_PAGE_SIDE / SHADOW_TILE_SIDE;
    let corner = first + (tile / across * SHADOW_PAGE_SIDE + tile % across) * SHADOW_TILE_SIDE;
    var low = NONE;
    var high = 0u;
    for (var y = 0u; y < SHADOW_TILE_SIDE; y++) {
        for (var x = 0u; x < SHADOW_TILE_SIDE; x++) {
            let key = words[corner + y * SHADOW_PAGE_SIDE + x];
            low = min(low, key);
            high = max(high, key);
        }
    }
    let tiles = first + SHADOW_PAGE_TEXELS;
    words[tiles + 2u * tile] = low;
    words[tiles + 2u * tile + 1u] = high;
    atomicMin(&least, low);
    atomicMax(&largest, high);
    workgroupBarrier();
    if tile == 0u {
        words[tiles + 2u * SHADOW_TILES] = atomicLoad(&least);
        words[tiles + 2u * SHADOW_TILES + 1u] = atomicLoad(&largest);
    }
}
