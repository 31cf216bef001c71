// Counts the covered pixels of a visibility buffer that stays on the device.
// One invocation handles PIXELS_PER_LANE pixels.
// Reads the visibility buffer. Adds to the counters.
// Needs: key.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read_write> counters: Counters;

var<workgroup> covered: atomic<u32>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane == 0u {
        atomicStore(&covered, 0u);
    }
    workgroupBarrier();
    let first = workgroup_number(workgroup) * WIDTH * PIXELS_PER_LANE + lane;
    let end = min(first + WIDTH * PIXELS_PER_LANE, view.width * view.height);
    var own = 0u;
    for (var pixel = first; pixel < end; pixel += WIDTH) {
        own += u32(covered_at(pixel));
    }
    atomicAdd(&covered, own);
    workgroupBarrier();
    if lane == 0u {
        atomicAdd(&counters.covered, atomicLoad(&covered));
    }
}
