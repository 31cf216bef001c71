// Instances on the screen -> the workgroups that look at all their parts. One lane.

@group(0) @binding(0) var<storage, read> level: Dispatch;
@group(0) @binding(1) var<storage, read_write> looking: Dispatch;

@compute @workgroup_size(1)
fn main() {
    looking = workgroups(level.count * BLOCKS, 1u, level.count);
}
