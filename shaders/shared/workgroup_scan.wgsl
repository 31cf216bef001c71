// Inclusive prefix sums over the invocations of a workgroup.

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
