// Which words of a block of bits each invocation of a workgroup takes.
// Needs: workgroup_scan.wgsl.

// The first of the words that a lane takes of a block, and the one behind the last, of `count` in all.
fn words_of_lane(block: u32, lane: u32, count: u32) -> vec2<u32> {
    let own = SCAN_BLOCK / SCAN_WIDTH;
    let first = block * SCAN_BLOCK + lane * own;
    return vec2<u32>(first, min(first + own, count));
}
