// Lists the candidate groups in scene order: the third step of stream compaction.
// One workgroup handles a block of words, one invocation a run of them. The second pass also finds where a group was in
// the list of the first.
// Reads bits of groups, sums of blocks, instances. Writes candidate groups and the indirect arguments of cluster_cull.
// Needs: word_blocks.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> groups: array<Group>;
@group(0) @binding(3) var<storage, read> bits: array<u32>;
@group(0) @binding(4) var<storage, read> blocks: Dispatch;
@group(0) @binding(5) var<storage, read> sums: array<u32>;
@group(0) @binding(6) var<storage, read_write> candidate_groups: array<CandidateGroup>;
// For culling their clusters, and for counting what is left of them.
@group(0) @binding(7) var<storage, read_write> culling: Dispatch;
@group(0) @binding(8) var<storage, read_write> counting: Dispatch;
// Of the first pass; not read there.
@group(0) @binding(9) var<storage, read> first_bits: array<u32>;
@group(0) @binding(10) var<storage, read> first_sums: array<u32>;

// The instance that a word belongs to, the last one that starts at or before it, from one on that does.
fn instance_of(word: u32, earliest: u32) -> u32 {
    var low = earliest;
    var high = view.instances;
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if instances[middle].group_words <= word {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

// Lists the groups of a word of an instance, from a place on; those of the first pass are listed there from `first_at` on.
fn list(instance: u32, word: u32, mask_of_word: u32, at_of_word: u32, first_mask: u32, first_at: u32) {
    var mask = mask_of_word;
    var at = at_of_word;
    let first = 32u * (word - instances[instance].group_words);
    let first_group = instances[instance].first_group + first;
    while mask != 0u {
        let bit = firstTrailingBit(mask);
        mask &= mask - 1u;
        var before = NONE;
        if (first_mask >> bit & 1u) == 1u {
            before = first_at + countOneBits(first_mask & ((1u << bit) - 1u));
        }
        if at < arrayLength(&candidate_groups) {
            let group = first_group + bit;
            candidate_groups[at] = CandidateGroup(instance, groups[group].first, groups[group].count, before, first + bit);
        }
        at++;
    }
}

// Of 32 words from `first` on those that are not zero.
fn filled_from(first: u32) -> u32 {
    let at = blocks.count + first / 32u;
    if SECOND {
        return bits[at] | first_bits[at];
    }
    return bits[at];
}

@compute @workgroup_size(SCAN_WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let lane = local.x;
    let block = workgroup_number(workgroup);
    if block == 0u && lane == 0u {
        let total = sums[(blocks.count + SCAN_BLOCK - 1u) / SCAN_BLOCK];
        let kept = min(total, arrayLength(&candidate_groups));
        culling = workgroups(kept, GROUPS_PER_WORKGROUP, total);
        counting = workgroups(kept, CLUSTER_BLOCK, kept);
    }
    // Of most instances nothing is to be seen.
    if sums[block] == sums[block + 1u] {
        return;
    }
    let words = words_of_lane(block, lane, blocks.count);
    var count = 0u;
    var first_count = 0u;
    for (var first = words.x; first < words.y; first += 32u) {
        for (var rest = filled_from(first); rest != 0u; rest &= rest - 1u) {
            let word = first + firstTrailingBit(rest);
            if SECOND {
                first_count += countOneBits(first_bits[word]);
            }
            count += countOneBits(bits[word]);
        }
    }
    var first_at = 0u;
    if SECOND {
        first_at = first_sums[block] + inclusive_sum(lane, first_count) - first_count;
        workgroupBarrier();
    }
    var at = sums[block] + inclusive_sum(lane, count) - count;
    var instance = 0u;
    for (var first = words.x; first < words.y; first += 32u) {
        for (var rest = filled_from(first); rest != 0u; rest &= rest - 1u) {
            let word = first + firstTrailingBit(rest);
            let mask = bits[word];
            var first_mask = 0u;
            if SECOND {
                first_mask = first_bits[word];
            }
            if mask != 0u {
                instance = instance_of(word, instance);
                list(instance, word, mask, at, first_mask, first_at);
            }
            at += countOneBits(mask);
            first_at += countOneBits(first_mask);
        }
    }
}
