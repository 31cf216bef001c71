// Counts the set bits of each block of words: the first step of stream compaction (count, scan, list).
// One workgroup handles a block, one invocation a run of its words. Sparse sets have summary bits that name the words
// which are not zero.
// Reads bits of groups or of clusters. Writes one sum for each block.
// Needs: workgroup_scan.wgsl, word_blocks.wgsl.

@group(0) @binding(0) var<storage, read> bits: array<u32>;
@group(0) @binding(1) var<storage, read> blocks: Dispatch;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(SCAN_WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
) {
    let lane = local.x;
    let block = workgroup_number(workgroup);
    let words = words_of_lane(block, lane, min(blocks.count, arrayLength(&bits)));
    var count = 0u;
    if SPARSE {
        for (var first = words.x; first < words.y; first += 32u) {
            for (var filled = bits[blocks.count + first / 32u]; filled != 0u; filled &= filled - 1u) {
                let word = first + firstTrailingBit(filled);
                count += countOneBits(bits[word]);
            }
        }
    } else {
        for (var word = words.x; word < words.y; word++) {
            count += countOneBits(bits[word]);
        }
    }
    let sum = inclusive_sum(lane, count);
    if lane == SCAN_WIDTH - 1u && block < arrayLength(&sums) {
        sums[block] = sum;
    }
}
