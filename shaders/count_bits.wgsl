// The set bits of each block of SCAN_BLOCK words; `others` are those of the first phase, or the same again. Where most
// words are zero, bits behind them tell which are not.

@group(0) @binding(0) var<storage, read> bits: array<u32>;
@group(0) @binding(1) var<storage, read> blocks: Dispatch;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
@group(0) @binding(3) var<storage, read> others: array<u32>;

@compute @workgroup_size(SCAN_WIDTH)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let block = workgroup_number(workgroup);
    let words = words_of_lane(block, lane, min(blocks.count, min(arrayLength(&bits), arrayLength(&others))));
    var count = 0u;
    if SPARSE {
        var filled = filled_words(words, bits[blocks.count + words.x / 32u] | others[blocks.count + words.x / 32u]);
        while filled != 0u {
            let word = words.x + firstTrailingBit(filled);
            filled &= filled - 1u;
            count += countOneBits(bits[word] | others[word]);
        }
    } else {
        for (var word = words.x; word < words.y; word++) {
            count += countOneBits(bits[word] | others[word]);
        }
    }
    let sum = inclusive_sum(lane, count);
    if lane == SCAN_WIDTH - 1u && block < arrayLength(&sums) {
        sums[block] = sum;
    }
}
