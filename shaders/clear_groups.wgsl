// The bits of groups of an earlier frame -> none. Bits behind them tell which words are not zero, few of a large scene.

@group(0) @binding(0) var<storage, read> blocks: Dispatch;
@group(0) @binding(1) var<storage, read_write> bits: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) all: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = workgroup_number(workgroup, all) * WIDTH + lane;
    let at = blocks.count + number;
    if 32u * number >= blocks.count {
        return;
    }
    for (var filled = bits[at]; filled != 0u; filled &= filled - 1u) {
        bits[32u * number + firstTrailingBit(filled)] = 0u;
    }
    bits[at] = 0u;
}
