// Clears the bits of groups that an earlier frame marked.
// One invocation handles 32 words of bits: it clears those that the summary bits behind them name.
// Reads and writes the bits of groups and their summary bits.

@group(0) @binding(0) var<storage, read> blocks: Dispatch;
@group(0) @binding(1) var<storage, read_write> bits: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = workgroup_number(workgroup) * WIDTH + lane;
    let at = blocks.count + number;
    if 32u * number >= blocks.count {
        return;
    }
    for (var filled = bits[at]; filled != 0u; filled &= filled - 1u) {
        bits[32u * number + firstTrailingBit(filled)] = 0u;
    }
    bits[at] = 0u;
}
