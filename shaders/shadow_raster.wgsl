// Pages of shadow maps: which clusters are drawn into which pages of a block: src/cpu/shadow_raster.rs.
// One workgroup handles one cluster; its invocations share out the pages that its box may touch.
// Reads a list of the clusters that a block's view sees. First notes how near to the light those of each page are. Then appends
// the nearer half to the lists of clusters and pages, which rasterizers draw, and defers the others.
// Needs: cull.wgsl, cluster_bounds.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> pages: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> visible: array<VisibleCluster>;
@group(0) @binding(5) var<storage, read> numbers: array<u32>;
@group(0) @binding(6) var<storage, read> draws: array<Dispatch, LISTS>;
// Behind the sums of corners, for each place of the grid the page there plus one; 0 where none is drawn.
@group(0) @binding(7) var<storage, read> grid: array<u32>;
@group(0) @binding(8) var<uniform> pair_lists: PairLists;
@group(0) @binding(9) var<storage, read_write> pairs: array<VisibleCluster>;
@group(0) @binding(10) var<storage, read_write> pair_draws: array<DispatchArgsOut, LISTS>;
@group(0) @binding(11) var<storage, read_write> deferred: array<VisibleCluster>;
@group(0) @binding(12) var<storage, read_write> deferred_draws: array<DispatchArgsOut, LISTS>;
@group(0) @binding(13) var<storage, read_write> page_clusters: array<PageClusters>;
@group(0) @binding(14) var<storage, read> pages_1: array<vec4<u32>>;
@group(0) @binding(15) var<storage, read> pages_2: array<vec4<u32>>;
@group(0) @binding(16) var<storage, read> pages_3: array<vec4<u32>>;

// Whether a cluster of a page is drawn before it is known what others hide. So are all where nothing was noted.
fn comes_first(page: u32, near_key: u32) -> bool {
    let nearest = atomicLoad(&page_clusters[page].nearest);
    let farthest = ~atomicLoad(&page_clusters[page].farthest);
    let few = atomicLoad(&page_clusters[page].clusters) <= SHADOW_FEW_CLUSTERS;
    return few || near_key >= farthest + (nearest - farthest) / 2u;
}

fn note(page: u32, near_key: u32) {
    atomicAdd(&page_clusters[page].clusters, 1u);
    // What reaches the eye has no distance.
    if near_key != NO_KEY {
        atomicMax(&page_clusters[page].nearest, near_key);
        atomicMax(&page_clusters[page].farthest, ~near_key);
    }
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = workgroup_number(workgroup);
    let room = arrayLength(&numbers) / 2u;
    if index >= min(draws[LIST].count, room) {
        return;
    }
    let number = numbers[number_slot(LIST, index, room)];
    if number >= arrayLength(&visible) {
        return;
    }
    let instance = visible[number].instance;
    let cluster = visible[number].cluster;
    let record = record_start(page_start(instance, cluster), cluster);
    let shape = cluster_bounds(instance, record);
    let place = footprint(instances[instance].screen, shape.center, shape.extent);
    let rect = place.rect / vec4<u32>(SHADOW_PAGE_SIDE);
    let across = rect.z - rect.x + 1u;
    let count = across * (rect.w - rect.y + 1u);
    let triangles = detail_of(record).triangles;
    for (var at = lane; at < count; at += WIDTH) {
        let page = grid[SHADOW_GRID_PAGES + (rect.y + at / across) * SHADOW_BLOCK_PAGES + rect.x + at % across];
        if page == 0u {
            continue;
        }
        if MEASURES {
            note(page - 1u, place.near_key);
            continue;
        }
        let pair = VisibleCluster(instance, cluster, page - 1u);
        if comes_first(page - 1u, place.near_key) {
            let entry = atomicAdd(&pair_draws[LIST].count, 1u);
            atomicMax(&pair_draws[LIST].x, min(entry + 1u, MAX_WORKGROUPS));
            atomicMax(&pair_draws[LIST].y, entry / MAX_WORKGROUPS + 1u);
            atomicMax(&pair_draws[LIST].z, 1u);
            atomicAdd(&page_clusters[page - 1u].triangles, triangles);
            if entry < pair_lists.room {
                pairs[pair_slot(LIST, entry, pair_lists.room)] = pair;
            }
        } else {
            let entry = atomicAdd(&deferred_draws[LIST].count, 1u);
            if entry % WIDTH == 0u {
                atomicMax(&deferred_draws[LIST].x, min(entry / WIDTH + 1u, MAX_WORKGROUPS));
                atomicMax(&deferred_draws[LIST].y, entry / WIDTH / MAX_WORKGROUPS + 1u);
                atomicMax(&deferred_draws[LIST].z, 1u);
            }
            if entry < pair_lists.room {
                deferred[pair_slot(LIST, entry, pair_lists.room)] = pair;
            }
        }
    }
}
