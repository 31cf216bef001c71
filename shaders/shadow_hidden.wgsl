// Pages of shadow maps: which of the deferred clusters are not hidden from the light: src/cpu/shadow_raster.rs.
// One invocation handles one cluster in one page.
// Reads the deferred list and the tiles of what was drawn. Appends to the lists of clusters and pages, which rasterizers draw.
// Needs: page_views.wgsl, cull.wgsl, cluster_bounds.wgsl.

@group(0) @binding(1) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(2) var<storage, read> pages: array<vec4<u32>>;
// Those that were deferred.
@group(0) @binding(3) var<storage, read> visible: array<VisibleCluster>;
@group(0) @binding(4) var<storage, read> draws: array<Dispatch, LISTS>;
// Keys of pages, and behind them the least and the largest of tiles.
@group(0) @binding(5) var<storage, read> words: array<u32>;
@group(0) @binding(6) var<storage, read_write> page_clusters: array<PageClusters>;
@group(0) @binding(7) var<storage, read> pages_1: array<vec4<u32>>;
@group(0) @binding(8) var<storage, read> pages_2: array<vec4<u32>>;
@group(0) @binding(9) var<storage, read> pages_3: array<vec4<u32>>;
@group(0) @binding(12) var<storage, read_write> drawn: array<VisibleCluster>;
@group(0) @binding(13) var<storage, read_write> drawn_draws: array<DispatchArgsOut, LISTS>;

// Whether all that was drawn of the page is nearer to the light than a box, wherever that may be.
fn hidden_in_page(place: Footprint) -> bool {
    if place.near_key == NO_KEY {
        return false;
    }
    let tiles = place.rect / vec4<u32>(SHADOW_TILE_SIDE);
    let first = view.first_word + SHADOW_PAGE_TEXELS;
    for (var y = tiles.y; y <= tiles.w; y++) {
        for (var x = tiles.x; x <= tiles.z; x++) {
            let least = words[first + 2u * (y * (SHADOW_PAGE_SIDE / SHADOW_TILE_SIDE) + x)];
            if place.near_key >= least {
                return false;
            }
        }
    }
    return true;
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = listed(LIST, workgroup_number(workgroup) * WIDTH + lane);
    if number == NONE {
        return;
    }
    look_at(number);
    let pair = visible[number];
    let record = record_start(page_start(pair.instance, pair.cluster), pair.cluster);
    let shape = cluster_bounds(pair.instance, record);
    let place = footprint(seen_screen, shape.center, shape.extent);
    if !place.seen || hidden_in_page(place) {
        return;
    }
    let entry = atomicAdd(&drawn_draws[LIST].count, 1u);
    atomicMax(&drawn_draws[LIST].x, min(entry + 1u, MAX_WORKGROUPS));
    atomicMax(&drawn_draws[LIST].y, entry / MAX_WORKGROUPS + 1u);
    atomicMax(&drawn_draws[LIST].z, 1u);
    atomicAdd(&page_clusters[pair.large].triangles, detail_of(record).triangles);
    // There are no more than were deferred, for which there was room.
    drawn[pair_slot(LIST, entry, pairs.room)] = pair;
}
