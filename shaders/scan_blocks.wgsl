// Makes an exclusive prefix sum of the sums of blocks: the second step of stream compaction.
// One workgroup handles all of them.
// Reads and writes the sums of blocks. Writes the total behind the last.
// Needs: workgroup_scan.wgsl.

@group(0) @binding(0) var<storage, read> blocks: Dispatch;
@group(0) @binding(1) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(SCAN_WIDTH)
fn main(@builtin(local_invocation_id) local: vec3<u32>) {
    let lane = local.x;
    let count = min((blocks.count + SCAN_BLOCK - 1u) / SCAN_BLOCK, arrayLength(&sums) - 1u);
    var before = 0u;
    for (var start = 0u; start < count; start += SCAN_WIDTH) {
        let block = start + lane;
        var own = 0u;
        if block < count {
            own = sums[block];
        }
        let upto = inclusive_sum(lane, own);
        if block < count {
            sums[block] = before + upto - own;
        }
        before += lanes[SCAN_WIDTH - 1u];
        workgroupBarrier();
    }
    if lane == 0u {
        sums[count] = before;
    }
}
