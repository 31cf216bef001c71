// Stage 3. Groups whose clusters may be drawn -> one bit for each cluster that is, and one more for the large ones:
// the second half of the rule of the cut, the picture's bounds, the backface cone and the depth pyramid. The second
// phase keeps what the first one drew, and looks at what waited for the pyramid alone.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> pages: array<u32>;
@group(0) @binding(4) var<storage, read> candidates: array<Candidate>;
@group(0) @binding(5) var<storage, read> culling: Dispatch;
@group(0) @binding(6) var<storage, read_write> drawn: array<u32>;
@group(0) @binding(7) var<storage, read_write> marks: array<Marks>;
@group(0) @binding(8) var<storage, read_write> counters: Counters;
@group(0) @binding(9) var<storage, read> pyramid: array<u32>;
// Of the first phase; not read there.
@group(0) @binding(10) var<storage, read> first_drawn: array<u32>;
@group(0) @binding(11) var<storage, read> first_marks: array<Marks>;
@group(0) @binding(12) var<storage, read> pages_1: array<u32>;
@group(0) @binding(13) var<storage, read> pages_2: array<u32>;
@group(0) @binding(14) var<storage, read> pages_3: array<u32>;

var<workgroup> drawn_bits: array<atomic<u32>, GROUPS_PER_WORKGROUP>;
var<workgroup> large_bits: array<atomic<u32>, GROUPS_PER_WORKGROUP>;
var<workgroup> clipped_bits: array<atomic<u32>, GROUPS_PER_WORKGROUP>;
var<workgroup> held_bits: array<atomic<u32>, GROUPS_PER_WORKGROUP>;

// Pixels between the picture and the sides of the viewport that it lies in the middle of.
fn viewport_margin() -> u32 {
    return (view.viewport - max(view.width, view.height)) / 2u;
}

fn cull(candidate: Candidate, group: u32, member: u32) {
    let instance = candidate.instance;
    let cluster = candidate.first + member;
    let bit = 1u << member;
    let again = SECOND && candidate.before != NONE;
    if again {
        if (first_drawn[candidate.before] & bit) != 0u {
            atomicOr(&drawn_bits[group], bit);
            atomicOr(&held_bits[group], bit);
            atomicOr(&large_bits[group], first_marks[candidate.before].large & bit);
            return;
        }
        if (first_marks[candidate.before].held & bit) == 0u {
            return;
        }
    }
    let record = record_start(page_start(instance, cluster), cluster);
    let at = record + RECORD_LOD_SPHERE;
    let sphere = Sphere(array<f32, 3>(real(at), real(at + 1u), real(at + 2u)), real(at + 3u));
    // What it was made from is drawn instead, where that is there.
    if !again && exceeds(instance, sphere, real(record + RECORD_ERROR)) {
        let refined = instances[instance].first_page + page_word(record + RECORD_REFINED_PAGE);
        if page_offsets[refined] != ABSENT {
            return;
        }
    }
    let center = reals(record + RECORD_CENTER);
    let extent = reals(record + RECORD_EXTENT);
    let place = footprint(instances[instance].screen, center, extent);
    if !again && (!place.seen || (!two_sided(instance, record) && faces_away(instance, record))) {
        return;
    }
    if hidden(place, instance, center, extent) {
        atomicAdd(&counters.held, 1u);
        if !SECOND {
            atomicOr(&held_bits[group], bit);
        }
        return;
    }
    atomicOr(&drawn_bits[group], bit);
    // A patch of n triangles has some sqrt(n / 2) edges across.
    let edge = f32(place.span) / max(sqrt(f32(triangle_count(record)) * 0.5), 1.0);
    if has_holes(instance, record) {
        atomicOr(&clipped_bits[group], bit);
        atomicAdd(&counters.triangles_large, triangle_count(record));
    } else if place.clipped || place.span > MAX_SPAN || edge > SMALL_EDGE {
        atomicOr(&large_bits[group], bit);
        if view.viewport != 0u && (place.clipped || place.span >= viewport_margin()) {
            atomicOr(&clipped_bits[group], bit);
        }
        atomicAdd(&counters.triangles_large, triangle_count(record));
    } else {
        atomicAdd(&counters.triangles_small, triangle_count(record));
    }
}

@compute @workgroup_size(WIDTH)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let group = lane / LANES_PER_GROUP;
    let first = lane % LANES_PER_GROUP;
    let number = workgroup_number(workgroup) * GROUPS_PER_WORKGROUP + group;
    let exists = number < min(culling.count, arrayLength(&candidates));
    if first == 0u {
        atomicStore(&drawn_bits[group], 0u);
        atomicStore(&large_bits[group], 0u);
        atomicStore(&clipped_bits[group], 0u);
        atomicStore(&held_bits[group], 0u);
    }
    workgroupBarrier();
    if exists {
        let candidate = candidates[number];
        if first == 0u {
            var looked_at = candidate.count;
            if SECOND && candidate.before != NONE {
                looked_at = countOneBits(first_marks[candidate.before].held);
            }
            atomicAdd(&counters.visited_clusters, looked_at);
        }
        for (var member = first; member < candidate.count; member += LANES_PER_GROUP) {
            cull(candidate, group, member);
        }
    }
    workgroupBarrier();
    if exists && first == 0u {
        drawn[number] = atomicLoad(&drawn_bits[group]);
        let clipped = atomicLoad(&clipped_bits[group]);
        marks[number] = Marks(atomicLoad(&large_bits[group]), atomicLoad(&held_bits[group]), 0u, clipped);
    }
}
