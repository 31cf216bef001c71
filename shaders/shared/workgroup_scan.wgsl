// Prefix sums over the lanes of a workgroup.

// The first of the words that a lane takes of a block, and the one behind the last, of `count` in all.
fn words_of_lane(block: u32, lane: u32, count: u32) -> vec2<u32> {
    let first = block * SCAN_BLOCK + lane * WORDS_PER_LANE;
    return vec2<u32>(first, min(first + WORDS_PER_LANE, count));
}

// Of those words the ones that are not zero, from the bit of the first on: `filled` is the word of such bits that it is in.
fn filled_words(words: vec2<u32>, filled: u32) -> u32 {
    return select(filled >> (words.x % 32u) & ((1u << WORDS_PER_LANE) - 1u), 0u, words.x >= words.y);
}

var<workgroup> lanes: array<u32, SCAN_WIDTH>;
// Of every SCAN_ROW lanes.
var<workgroup> row_sums: array<u32, SCAN_WIDTH / SCAN_ROW>;

// The sum of `value` over this lane and those before it; afterwards `lanes` has that of every lane. Waiting for others
// costs more than a few additions: so it waits three times, whatever the number of lanes.
fn inclusive_sum(lane: u32, value: u32) -> u32 {
    lanes[lane] = value;
    workgroupBarrier();
    let row = lane / SCAN_ROW;
    var sum = value;
    for (var other = row * SCAN_ROW; other < lane; other++) {
        sum += lanes[other];
    }
    if lane % SCAN_ROW == SCAN_ROW - 1u {
        row_sums[row] = sum;
    }
    workgroupBarrier();
    for (var other = 0u; other < row; other++) {
        sum += row_sums[other];
    }
    lanes[lane] = sum;
    workgroupBarrier();
    return sum;
}
