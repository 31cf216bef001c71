// Stage 3, cluster culling: tests the clusters of candidate groups by the second half of the rule of the cut, the frustum,
// the backface cone and the depth pyramid.
// One workgroup handles GROUPS_PER_WORKGROUP candidate groups and shares their clusters out among its invocations.
// Reads candidate groups and cluster records. Writes a bit for each cluster that is drawn, and one more for those of large
// triangles. A first pass that starts from the visible clusters of the frame before tests the first half of the rule, too.
// The second pass keeps what the first one drew, and tests all other clusters.
// Needs: occlusion.wgsl, lod.wgsl, cluster_bounds.wgsl, cone.wgsl, tiles.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> pages: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> candidate_groups: array<CandidateGroup>;
@group(0) @binding(5) var<storage, read> culling: Dispatch;
// What the frame before drew, where that is the list; then what this one draws.
@group(0) @binding(6) var<storage, read_write> drawn: array<u32>;
@group(0) @binding(7) var<storage, read_write> marks: array<Marks>;
@group(0) @binding(8) var<storage, read_write> counters: Counters;
@group(0) @binding(9) var<storage, read> pyramid: array<vec4<u32>>;
// Of the first pass; not read there.
@group(0) @binding(10) var<storage, read> first_drawn: array<u32>;
@group(0) @binding(11) var<storage, read> groups: array<Group>;
@group(0) @binding(12) var<storage, read> pages_1: array<vec4<u32>>;
@group(0) @binding(13) var<storage, read> pages_2: array<vec4<u32>>;
@group(0) @binding(14) var<storage, read> pages_3: array<vec4<u32>>;

// Members of each group that are to be looked at.
var<workgroup> waiting: array<u32, GROUPS_PER_WORKGROUP>;
var<workgroup> drawn_bits: array<atomic<u32>, GROUPS_PER_WORKGROUP>;
var<workgroup> large_bits: array<atomic<u32>, GROUPS_PER_WORKGROUP>;
var<workgroup> clipped_bits: array<atomic<u32>, GROUPS_PER_WORKGROUP>;
// What the workgroup adds to the counters: one addition there for all its lanes.
var<workgroup> held: atomic<u32>;
var<workgroup> triangles_small: atomic<u32>;
var<workgroup> triangles_large: atomic<u32>;

// Pixels between the picture and the sides of the viewport that it lies in the middle of.
fn viewport_margin() -> u32 {
    return (view.viewport - max(view.width, view.height)) / 2u;
}

fn cull(candidate: CandidateGroup, group: u32, member: u32) {
    let instance = candidate.instance;
    let cluster = candidate.first + member;
    let bit = 1u << member;
    let record = record_start(page_start(instance, cluster), cluster);
    let detail = detail_of(record);
    // What it was made from is drawn instead, where that is there.
    if exceeds(lod_view(instance), detail.lod_sphere, detail.error) {
        let refined = instances[instance].first_page + detail.refined_page;
        if page_offsets[refined] != ABSENT {
            return;
        }
    }
    let shape = cluster_bounds(instance, record);
    let place = footprint(instances[instance].screen, shape.center, shape.extent);
    if !place.seen {
        return;
    }
    if !material_bit(instances[instance].double_sided, detail.material)
        && faces_away(instance, shape.center, shape.radius, shape.cone) {
        return;
    }
    if hidden(place, instance, shape.center, shape.extent) {
        atomicAdd(&held, 1u);
        return;
    }
    if view.two_passes != 0u {
        touch(place.rect);
    }
    atomicOr(&drawn_bits[group], bit);
    // A patch of n triangles has some sqrt(n / 2) edges across.
    let edge = quotient(f32(place.span), max(root(f32(detail.triangles) * 0.5), 1.0));
    if material_bit(instances[instance].alpha_tested, detail.material) {
        atomicOr(&clipped_bits[group], bit);
        atomicAdd(&triangles_large, detail.triangles);
    } else if place.clipped || place.span > MAX_SPAN || edge > SMALL_EDGE {
        atomicOr(&large_bits[group], bit);
        if view.viewport != 0u && (place.clipped || place.span >= viewport_margin()) {
            atomicOr(&clipped_bits[group], bit);
        }
        atomicAdd(&triangles_large, detail.triangles);
    } else {
        atomicAdd(&triangles_small, detail.triangles);
    }
}

// The n-th of the bits that are set.
fn nth_bit(bits: u32, n: u32) -> u32 {
    if !SECOND && view.history != HISTORY_LIST {
        // All from the first on.
        return n;
    }
    var rest = bits;
    for (var i = 0u; i < n; i++) {
        rest &= rest - 1u;
    }
    return firstTrailingBit(rest);
}

// Whether clusters of a candidate that an earlier frame found may still be in the cut: what the walk says of it otherwise.
fn still_refined(candidate: CandidateGroup) -> bool {
    let instance = candidate.instance;
    let page = instances[instance].first_page + (candidate.first >> PAGE_SLOT_BITS);
    // Nothing is to be seen of an instance without a focal length.
    if instances[instance].lod_focal == 0.0 || page_offsets[page] == ABSENT {
        return false;
    }
    let group = groups[instances[instance].first_group + candidate.group];
    return exceeds(lod_view(instance), group.lod_sphere, group.error);
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let lane = local.x;
    let first = workgroup_number(workgroup) * GROUPS_PER_WORKGROUP;
    let count = min(culling.count, arrayLength(&candidate_groups));
    let own = first + lane;
    let leads = lane < GROUPS_PER_WORKGROUP;
    if lane == 0u {
        atomicStore(&held, 0u);
        atomicStore(&triangles_small, 0u);
        atomicStore(&triangles_large, 0u);
    }
    var kept = 0u;
    if leads {
        var members = 0u;
        if own < count {
            let candidate = candidate_groups[own];
            members = NONE >> (32u - candidate.count);
            if SECOND {
                if candidate.before != NONE {
                    kept = first_drawn[candidate.before];
                    members &= ~kept;
                }
            } else if view.history == HISTORY_LIST {
                members = select(0u, drawn[own], drawn[own] != 0u && still_refined(candidate));
            }
        }
        waiting[lane] = members;
        atomicStore(&drawn_bits[lane], kept);
        atomicStore(&large_bits[lane], 0u);
        atomicStore(&clipped_bits[lane], 0u);
    }
    workgroupBarrier();
    // Lanes share out what waits, of all groups together.
    var total = 0u;
    for (var group = 0u; group < GROUPS_PER_WORKGROUP; group++) {
        total += countOneBits(waiting[group]);
    }
    for (var entry = lane; entry < total; entry += WIDTH) {
        var rest = entry;
        var group = 0u;
        var end = 0u;
        for (var before = 0u; before + 1u < GROUPS_PER_WORKGROUP; before++) {
            end += countOneBits(waiting[before]);
            if entry >= end {
                group = before + 1u;
                rest = entry - end;
            }
        }
        cull(candidate_groups[first + group], group, nth_bit(waiting[group], rest));
    }
    workgroupBarrier();
    if leads && own < count {
        drawn[own] = atomicLoad(&drawn_bits[lane]);
        marks[own] = Marks(atomicLoad(&large_bits[lane]), kept, 0u, atomicLoad(&clipped_bits[lane]));
    }
    if lane == 0u {
        atomicAdd(&counters.visited_clusters, total);
        atomicAdd(&counters.occluded, atomicLoad(&held));
        atomicAdd(&counters.triangles_small, atomicLoad(&triangles_small));
        atomicAdd(&counters.triangles_large, atomicLoad(&triangles_large));
    }
}
