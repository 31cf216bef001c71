// The bits of clusters -> the frame's visible list in scene order, and the numbers in it that each rasterizer draws. The
// first phase marks their groups for the second, which lists those of both, and which numbers those of the first have
// become.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> candidates: array<Candidate>;
@group(0) @binding(2) var<storage, read> blocks: Dispatch;
@group(0) @binding(3) var<storage, read> drawn: array<u32>;
@group(0) @binding(4) var<storage, read_write> marks: array<Marks>;
@group(0) @binding(5) var<storage, read> sums: array<u32>;
@group(0) @binding(6) var<storage, read_write> visible: array<VisibleCluster>;
// Of the clusters of each list; see `number_slot`.
@group(0) @binding(7) var<storage, read_write> numbers: array<u32>;
// Small, large, clipped, with holes.
@group(0) @binding(8) var<storage, read_write> draws: array<DispatchOut, LISTS>;
@group(0) @binding(9) var<storage, read_write> counters: Counters;
// Of the first phase; not read there.
@group(0) @binding(10) var<storage, read> first_marks: array<Marks>;
@group(0) @binding(11) var<storage, read_write> renumbered: array<u32>;
// The same lists for the hardware rasterizer.
@group(0) @binding(12) var<storage, read_write> calls: array<CallOut, LISTS>;

@group(0) @binding(13) var<storage, read> instances: array<Instance>;
// Of the second phase; not written there.
@group(0) @binding(14) var<storage, read_write> group_bits: array<atomic<u32>>;

fn claim(list: u32) -> u32 {
    let at = atomicAdd(&draws[list].count, 1u);
    atomicMax(&draws[list].x, min(at + 1u, MAX_WORKGROUPS));
    atomicMax(&draws[list].y, at / MAX_WORKGROUPS + 1u);
    atomicMax(&draws[list].z, 1u);
    atomicAdd(&calls[list].instances, 1u);
    return at;
}

// Lists the clusters of a candidate, the first of them by this number.
fn list(word: u32, mask_of_word: u32, first_number: u32) {
    var mask = mask_of_word;
    var number = first_number;
    let candidate = candidates[word];
    let large = marks[word].large;
    let clipped = marks[word].clipped;
    var slow = large | clipped;
    let room = arrayLength(&numbers) / 2u;
    // Those of the first phase keep their order.
    var old = 0u;
    var old_number = 0u;
    if SECOND {
        old = marks[word].old;
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
        let is_large = (large >> member & 1u) == 1u;
        let is_clipped = (clipped >> member & 1u) == 1u;
        if number < arrayLength(&visible) {
            visible[number] = VisibleCluster(candidate.instance, candidate.first + member, slow >> member & 1u);
        }
        if (old >> member & 1u) == 1u {
            if old_number < arrayLength(&renumbered) {
                renumbered[old_number] = number;
            }
            old_number++;
        } else {
            var list = select(LIST_SMALL, LIST_LARGE, is_large);
            if is_clipped {
                list = select(LIST_MASKED, LIST_CLIPPED, is_large);
            }
            let at = claim(list);
            if at < room {
                numbers[number_slot(list, at, room)] = number;
            }
        }
        number++;
    }
}

@compute @workgroup_size(SCAN_WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) all: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = workgroup_number(workgroup, all);
    let words = words_of_lane(block, lane, blocks.count);
    var count = 0u;
    for (var word = words.x; word < words.y; word++) {
        count += countOneBits(drawn[word]);
    }
    if !SECOND && view.two_phases != 0u {
        for (var word = words.x; word < words.y; word++) {
            // Of a list those alone that are still drawn; what else there is to see, the second phase finds.
            if view.history != HISTORY_LIST || drawn[word] != 0u {
                mark_group(instances[candidates[word].instance].group_words, candidates[word].group);
            }
        }
    }
    var number = sums[block] + inclusive_sum(lane, count) - count;
    if block == 0u && lane == 0u {
        calls[LIST_SMALL].vertices = 3u * CLUSTER_MAX_TRIANGLES;
        calls[LIST_LARGE].vertices = 3u * CLUSTER_MAX_TRIANGLES;
        atomicStore(&counters.visible, sums[(blocks.count + SCAN_BLOCK - 1u) / SCAN_BLOCK]);
    }
    if count == 0u {
        return;
    }
    for (var word = words.x; word < words.y; word++) {
        let mask = drawn[word];
        if mask != 0u {
            list(word, mask, number);
            number += countOneBits(mask);
        }
    }
}
