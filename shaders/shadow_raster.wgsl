// Pages of shadow maps: which clusters are drawn into which pages of a block.
// One workgroup handles one cluster; its invocations share out the pages that its box may touch.
// Reads a list of the clusters that a block's view sees. Appends to the lists of clusters and pages, which rasterizers draw.
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
@group(0) @binding(11) var<storage, read_write> counters: Counters;
@group(0) @binding(12) var<storage, read> pages_1: array<vec4<u32>>;
@group(0) @binding(13) var<storage, read> pages_2: array<vec4<u32>>;
@group(0) @binding(14) var<storage, read> pages_3: array<vec4<u32>>;

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
        if page != 0u {
            let entry = atomicAdd(&pair_draws[LIST].count, 1u);
            atomicMax(&pair_draws[LIST].x, min(entry + 1u, MAX_WORKGROUPS));
            atomicMax(&pair_draws[LIST].y, entry / MAX_WORKGROUPS + 1u);
            atomicMax(&pair_draws[LIST].z, 1u);
            atomicAdd(&counters.triangles_small, triangles);
            if entry < pair_lists.room {
                pairs[pair_slot(LIST, entry, pair_lists.room)] = VisibleCluster(instance, cluster, page - 1u);
            }
        }
    }
}
