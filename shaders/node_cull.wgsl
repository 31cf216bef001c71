// Stage 2, node culling: tests one level of the hierarchies (level of detail, frustum, depth pyramid), as a breadth-first
// traversal with one dispatch for each level.
// One invocation handles one node of one instance.
// Reads the traversal queue of this level. Appends children to that of the next, marks the candidate groups of leaves, and
// defers occluded nodes to the second pass, which resumes there. Requests the pages of groups that are not resident.
// Needs: occlusion.wgsl, lod.wgsl, group_bits.wgsl, append.wgsl, defer.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> nodes: array<Node>;
@group(0) @binding(3) var<storage, read> groups: array<Group>;
@group(0) @binding(4) var<storage, read> items: array<TraversalItem>;
@group(0) @binding(5) var<storage, read> level: Dispatch;
@group(0) @binding(6) var<storage, read_write> items_out: array<TraversalItem>;
@group(0) @binding(7) var<storage, read_write> next: DispatchArgsOut;
@group(0) @binding(8) var<storage, read_write> group_bits: array<atomic<u32>>;
@group(0) @binding(9) var<storage, read> pyramid: array<vec4<u32>>;
@group(0) @binding(10) var<storage, read_write> occluded_queue: array<TraversalItem>;
@group(0) @binding(11) var<storage, read_write> occluded_dispatch: DispatchArgsOut;
@group(0) @binding(12) var<storage, read> page_offsets: array<u32>;
// How much pages that are not there are missed: the bits of pixels.
@group(0) @binding(13) var<storage, read_write> wanted: array<atomic<u32>>;

// What a box is to a pass.
const OFF_SCREEN: u32 = 0u;
const HIDDEN: u32 = 1u;
const SEEN: u32 = 2u;

fn test(instance: u32, screen: array<vec4<f32>, 3>, center: vec3<f32>, extent: vec3<f32>) -> u32 {
    let place = footprint(screen, center, extent);
    if !place.seen {
        return OFF_SCREEN;
    }
    return select(SEEN, HIDDEN, hidden(place, instance, center, extent));
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = workgroup_number(workgroup) * WIDTH + lane;
    if number >= min(level.count, arrayLength(&items)) {
        return;
    }
    let item = items[number];
    if SECOND && item.node == 0u {
        // Most instances end here.
        if hides(Footprint(true, false, 0u, instances[item.instance].rect, instances[item.instance].near_key)) {
            return;
        }
        atomicAdd(&next.unhidden, 1u);
    }
    let node = nodes[instances[item.instance].first_node + item.node];
    let lod = lod_view(item.instance);
    if !may_be_in_cut(lod, node.lod_sphere, node.max_parent_error, node.min_own_error) {
        return;
    }
    let screen = instances[item.instance].screen;
    let found = test(item.instance, screen, node.center, node.extent);
    if found != SEEN {
        if found == HIDDEN && !SECOND {
            defer(item);
        }
        return;
    }
    let count = node.count & 0xffffu;
    if (node.count >> 16u) == 0u {
        let at = claim(count);
        for (var i = 0u; i < count; i++) {
            append(at + i, TraversalItem(item.instance, node.first + i));
        }
        return;
    }
    atomicAdd(&next.visited, count);
    let first_group = instances[item.instance].first_group;
    let first_page = instances[item.instance].first_page;
    let words = instances[item.instance].group_words;
    var waits = false;
    for (var i = 0u; i < count; i++) {
        let number = node.first + i;
        if SECOND && is_marked(words, number) {
            // The first pass drew some of it: it is in the cut, seen and there.
            continue;
        }
        let group = groups[first_group + number];
        if !may_be_in_cut(lod, group.lod_sphere, group.error, group.min_own_error) {
            continue;
        }
        var found = test(item.instance, screen, group.center, group.extent);
        if found == SEEN {
            let page = first_page + (group.first >> PAGE_SLOT_BITS);
            if page_offsets[page] != ABSENT {
                mark_group(words, number);
            } else if SECOND || view.two_passes == 0u {
                let pixels = error_pixels(lod, group.lod_sphere, group.error);
                atomicMax(&wanted[page], bitcast<u32>(pixels));
            } else {
                // What is drawn instead, with all else, may hide it.
                found = HIDDEN;
            }
        }
        waits |= found == HIDDEN;
    }
    if waits && !SECOND {
        defer(item);
    }
}
