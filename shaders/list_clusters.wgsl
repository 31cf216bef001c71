// Lists the visible clusters in scene order, and for each rasterizer which of them it draws.
// One workgroup handles a block of candidate groups, one invocation a run of them. The first pass marks their groups for
// the second. The second pass lists the clusters of both passes, and which numbers those of the first get.
// Reads candidate groups, bits of clusters, sums of blocks. Writes the visible cluster list, the lists of the rasterizers
// and their indirect arguments.
// Needs: word_blocks.wgsl, group_bits.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> candidate_groups: array<CandidateGroup>;
@group(0) @binding(2) var<storage, read> blocks: Dispatch;
@group(0) @binding(3) var<storage, read> drawn: array<u32>;
@group(0) @binding(4) var<storage, read_write> marks: array<Marks>;
@group(0) @binding(5) var<storage, read> sums: array<u32>;
@group(0) @binding(6) var<storage, read_write> visible: array<VisibleCluster>;
// Of the clusters of each list; see `number_slot`.
@group(0) @binding(7) var<storage, read_write> numbers: array<u32>;
// Small, large, clipped, alpha-tested.
@group(0) @binding(8) var<storage, read_write> draws: array<DispatchArgsOut, LISTS>;
@group(0) @binding(9) var<storage, read_write> counters: Counters;
// Of the first pass; not read there.
@group(0) @binding(10) var<storage, read> first_marks: array<Marks>;
@group(0) @binding(11) var<storage, read_write> renumbered: array<u32>;
// The same lists for the hardware rasterizer.
@group(0) @binding(12) var<storage, read_write> draw_args: array<DrawArgsOut, LISTS>;

@group(0) @binding(13) var<storage, read> instances: array<Instance>;
// Of the second pass; not written there.
@group(0) @binding(14) var<storage, read_write> group_bits: array<atomic<u32>>;

// Room for `count` entries of a list; the number of the first.
fn claim(list: u32, count: u32) -> u32 {
    if count == 0u {
        return 0u;
    }
    let at = atomicAdd(&draws[list].count, count);
    atomicMax(&draws[list].x, min(at + count, MAX_WORKGROUPS));
    atomicMax(&draws[list].y, (at + count - 1u) / MAX_WORKGROUPS + 1u);
    atomicMax(&draws[list].z, 1u);
    atomicAdd(&draw_args[list].instances, count);
    return at;
}

// Of the clusters of a candidate those that this pass draws, by lists.
fn parts(word: u32, mask: u32) -> vec4<u32> {
    let large = marks[word].large;
    let clipped = marks[word].clipped;
    var fresh = mask;
    if SECOND {
        fresh &= ~marks[word].old;
    }
    var parts: vec4<u32>;
    parts[LIST_SMALL] = fresh & ~large & ~clipped;
    parts[LIST_LARGE] = fresh & large & ~clipped;
    parts[LIST_CLIPPED] = fresh & large & clipped;
    parts[LIST_ALPHA_TESTED] = fresh & ~large & clipped;
    return parts;
}

// Lists the clusters of a candidate, the first of them by this number, from these places in the lists on; returns the
// places behind.
fn list(word: u32, mask_of_word: u32, first_number: u32, first_places: vec4<u32>) -> vec4<u32> {
    var mask = mask_of_word;
    var number = first_number;
    var places = first_places;
    let candidate = candidate_groups[word];
    let parts = parts(word, mask);
    var slow = marks[word].large | marks[word].clipped;
    let room = arrayLength(&numbers) / 2u;
    // Those of the first pass keep their order.
    var old_number = 0u;
    if SECOND {
        let old = marks[word].old;
        if old != 0u {
            let before = first_marks[candidate.before];
            old_number = before.first;
            slow |= (before.large | before.clipped) & old;
        }
    } else {
        marks[word].first = number;
    }
    while mask != 0u {
        let member = firstTrailingBit(mask);
        mask &= mask - 1u;
        if number < arrayLength(&visible) {
            visible[number] = VisibleCluster(candidate.instance, candidate.first + member, slow >> member & 1u);
        }
        let own = parts >> vec4<u32>(member) & vec4<u32>(1u);
        if all(own == vec4<u32>()) {
            if old_number < arrayLength(&renumbered) {
                renumbered[old_number] = number;
            }
            old_number++;
        } else {
            let list = own[LIST_LARGE] * LIST_LARGE + own[LIST_CLIPPED] * LIST_CLIPPED + own[LIST_ALPHA_TESTED] * LIST_ALPHA_TESTED;
            let at = places[list];
            if at < room {
                numbers[number_slot(list, at, room)] = number;
            }
            places += own;
        }
        number++;
    }
    return places;
}

@compute @workgroup_size(SCAN_WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let lane = local.x;
    let block = workgroup_number(workgroup);
    let words = words_of_lane(block, lane, blocks.count);
    var count = 0u;
    for (var word = words.x; word < words.y; word++) {
        count += countOneBits(drawn[word]);
    }
    if !SECOND && view.two_passes != 0u {
        for (var word = words.x; word < words.y; word++) {
            // Of a list those alone that are still drawn; what else there is to see, the second pass finds.
            if view.history != HISTORY_LIST || drawn[word] != 0u {
                mark_group(instances[candidate_groups[word].instance].group_words, candidate_groups[word].group);
            }
        }
    }
    var number = sums[block] + inclusive_sum(lane, count) - count;
    if block == 0u && lane == 0u {
        draw_args[LIST_SMALL].vertices = 3u * CLUSTER_MAX_TRIANGLES;
        draw_args[LIST_LARGE].vertices = 3u * CLUSTER_MAX_TRIANGLES;
        atomicStore(&counters.visible, sums[(blocks.count + SCAN_BLOCK - 1u) / SCAN_BLOCK]);
    }
    if count == 0u {
        return;
    }
    var own = vec4<u32>();
    for (var word = words.x; word < words.y; word++) {
        own += countOneBits(parts(word, drawn[word]));
    }
    // Once for all that a lane lists.
    var places = vec4<u32>();
    for (var list = 0u; list < LISTS; list++) {
        places[list] = claim(list, own[list]);
    }
    for (var word = words.x; word < words.y; word++) {
        let mask = drawn[word];
        if mask != 0u {
            places = list(word, mask, number, places);
            number += countOneBits(mask);
        }
    }
}
