// The visibility buffer of the first phase -> the same, with the numbers that clusters have in the list of both.

@group(0) @binding(0) var<storage, read> steps: array<Dispatch, STEPS>;
@group(0) @binding(1) var<storage, read> renumbered: array<u32>;
@group(0) @binding(2) var<storage, read_write> words: array<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) all: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = workgroup_number(workgroup, all) * WIDTH * PIXELS_PER_LANE + lane;
    let count = steps[STEP_PIXELS].count;
    for (var pixel = first; pixel < min(first + WIDTH * PIXELS_PER_LANE, count); pixel += WIDTH) {
        let low = words[2u * pixel];
        if low == 0u {
            continue;
        }
        let number = (~low >> TRIANGLE_BITS) - 1u;
        let triangle = ~low & ((1u << TRIANGLE_BITS) - 1u);
        if number < arrayLength(&renumbered) {
            words[2u * pixel] = ~(((renumbered[number] + 1u) << TRIANGLE_BITS) | triangle);
        }
    }
}
