// The visibility buffer of the first phase -> the same, with the numbers that clusters have in the list of both.

@group(0) @binding(0) var<storage, read> steps: array<Dispatch, STEPS>;
@group(0) @binding(1) var<storage, read> renumbered: array<u32>;
// Two pixels each, of which one may lie behind the picture.
@group(0) @binding(2) var<storage, read_write> words: array<vec4<u32>>;

// The low half of a word, 0 where nothing is, with the new number.
fn with_number(low: u32) -> u32 {
    let number = (~low >> TRIANGLE_BITS) - 1u;
    if low == 0u || number >= arrayLength(&renumbered) {
        return low;
    }
    let triangle = ~low & ((1u << TRIANGLE_BITS) - 1u);
    return ~(((renumbered[number] + 1u) << TRIANGLE_BITS) | triangle);
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) all: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let pairs = WIDTH * PIXELS_PER_LANE / 2u;
    let first = workgroup_number(workgroup, all) * pairs;
    let end = min(first + pairs, (steps[STEP_PIXELS].count + 1u) / 2u);
    for (var pair = first + lane; pair < end; pair += WIDTH) {
        let both = words[pair];
        if (both.x | both.z) != 0u {
            words[pair].x = with_number(both.x);
            words[pair].z = with_number(both.z);
        }
    }
}
