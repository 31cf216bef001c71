// The bits of groups -> the list of groups whose clusters may be drawn, in scene order. The second phase lists those of
// both, and where they were in the list of the first.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> groups: array<Group>;
@group(0) @binding(3) var<storage, read> bits: array<u32>;
@group(0) @binding(4) var<storage, read> blocks: Dispatch;
@group(0) @binding(5) var<storage, read> sums: array<u32>;
@group(0) @binding(6) var<storage, read_write> candidates: array<Candidate>;
// For culling their clusters, and for counting what is left of them.
@group(0) @binding(7) var<storage, read_write> culling: Dispatch;
@group(0) @binding(8) var<storage, read_write> counting: Dispatch;
// Of the first phase; not read there.
@group(0) @binding(9) var<storage, read> first_bits: array<u32>;
@group(0) @binding(10) var<storage, read> first_sums: array<u32>;

// The instance that a word belongs to: the last one that starts at or before it.
fn instance_of(word: u32) -> u32 {
    var low = 0u;
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

@compute @workgroup_size(SCAN_WIDTH)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let block = workgroup_number(workgroup);
    let word = block * SCAN_WIDTH + lane;
    var mask = 0u;
    var first_mask = 0u;
    var first_at = 0u;
    if SECOND {
        if word < blocks.count {
            first_mask = first_bits[word];
        }
        first_at = inclusive_sum(lane, countOneBits(first_mask)) - countOneBits(first_mask);
        workgroupBarrier();
    }
    if word < blocks.count {
        mask = bits[word] | first_mask;
    }
    let upto = inclusive_sum(lane, countOneBits(mask));
    if word == 0u {
        let total = sums[(blocks.count + SCAN_WIDTH - 1u) / SCAN_WIDTH];
        let kept = min(total, arrayLength(&candidates));
        culling = workgroups(kept, GROUPS_PER_WORKGROUP, total);
        counting = workgroups(kept, SCAN_WIDTH, kept);
    }
    if mask == 0u {
        return;
    }
    var at = sums[block] + upto - countOneBits(mask);
    if SECOND {
        first_at += first_sums[block];
    }
    let instance = instance_of(word);
    let first = 32u * (word - instances[instance].group_words);
    while mask != 0u {
        let bit = firstTrailingBit(mask);
        mask &= mask - 1u;
        var before = NONE;
        if (first_mask >> bit & 1u) == 1u {
            before = first_at;
            first_at++;
        }
        if at < arrayLength(&candidates) {
            let group = instances[instance].first_group + first + bit;
            candidates[at] = Candidate(instance, groups[group].first, groups[group].count, before);
        }
        at++;
    }
}
