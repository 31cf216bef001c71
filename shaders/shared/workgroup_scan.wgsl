// Prefix sums over the lanes of a workgroup.

// The first of the words that a lane takes of a block, and the one behind the last, of `count` in all.
fn words_of_lane(block: u32, lane: u32, count: u32) -> vec2<u32> {
    let first = block * SCAN_BLOCK + lane * WORDS_PER_LANE;
    return vec2<u32>(first, min(first + WORDS_PER_LANE, count));
}

var<workgroup> lanes: array<u32, SCAN_WIDTH>;

// The sum of `value` over this lane and those before it; afterwards `lanes` has that of every lane.
fn inclusive_sum(lane: u32, value: u32) -> u32 {
    lanes[lane] = value;
    workgroupBarrier();
    for (var stride = 1u; stride < SCAN_WIDTH; stride *= 2u) {
        var sum = lanes[lane];
        if lane >= stride {
            sum += lanes[lane - stride];
        }
        workgroupBarrier();
        lanes[lane] = sum;
        workgroupBarrier();
    }
    return lanes[lane];
}
