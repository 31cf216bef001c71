// Gives the pixels of the first pass the numbers that its clusters have in the visible cluster list of both passes.
// One workgroup handles a block of pixels, one invocation a column of it; blocks that the first pass did not touch are
// skipped.
// Reads the new numbers. Reads and writes the visibility buffer.
// Needs: target.wgsl, tiles.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> renumbered: array<u32>;
@group(0) @binding(2) var<storage, read_write> words: array<vec2<u32>>;
// Of the first pass.
@group(0) @binding(3) var<storage, read_write> counters: Counters;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let columns = (view.width + WIDTH - 1u) / WIDTH;
    let block = workgroup_number(workgroup);
    let first = vec2<u32>(block % columns, block / columns) * vec2<u32>(WIDTH, PIXELS_PER_LANE);
    let end = min(first + vec2<u32>(WIDTH, PIXELS_PER_LANE), vec2<u32>(view.width, view.height));
    let column = first.x + lane;
    if any(first >= end) || column >= end.x || !touched(vec4<u32>(first, end - 1u)) {
        return;
    }
    for (var row = first.y; row < end.y; row++) {
        let pixel = pixel_address(column, row);
        let low = words[pixel].x;
        let number = (~low >> TRIANGLE_BITS) - 1u;
        if low != 0u && number < arrayLength(&renumbered) {
            let triangle = ~low & ((1u << TRIANGLE_BITS) - 1u);
            words[pixel].x = ~(((renumbered[number] + 1u) << TRIANGLE_BITS) | triangle);
        }
    }
}
