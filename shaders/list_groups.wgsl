// The bits of groups -> the list of groups whose clusters may be drawn, in scene order.

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

fn dispatch(entries: u32, per_workgroup: u32, count: u32) -> Dispatch {
    let workgroups = (entries + per_workgroup - 1u) / per_workgroup;
    let rows = (workgroups + MAX_WORKGROUPS - 1u) / MAX_WORKGROUPS;
    return Dispatch(min(workgroups, MAX_WORKGROUPS), rows, 1u, count, 0u, array<u32, 3>(0u, 0u, 0u));
}

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
    if word < blocks.count {
        mask = bits[word];
    }
    let upto = inclusive_sum(lane, countOneBits(mask));
    if word == 0u {
        let total = sums[(blocks.count + SCAN_WIDTH - 1u) / SCAN_WIDTH];
        let kept = min(total, arrayLength(&candidates));
        culling = dispatch(kept, GROUPS_PER_WORKGROUP, total);
        counting = dispatch(kept, SCAN_WIDTH, kept);
    }
    if mask == 0u {
        return;
    }
    var at = sums[block] + upto - countOneBits(mask);
    let instance = instance_of(word);
    let first = 32u * (word - instances[instance].group_words);
    while mask != 0u {
        let number = first + firstTrailingBit(mask);
        mask &= mask - 1u;
        if at < arrayLength(&candidates) {
            let group = instances[instance].first_group + number;
            candidates[at] = Candidate(instance, groups[group].first, groups[group].count);
        }
        at++;
    }
}
