// Stage 1. Instances of the scene -> the roots of those that may be on the screen.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read_write> visits_out: array<Visit>;
@group(0) @binding(3) var<storage, read_write> next: DispatchOut;

@compute @workgroup_size(WIDTH)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let instance = workgroup_number(workgroup) * WIDTH + lane;
    if instance >= view.instances {
        return;
    }
    if footprint(instance, instances[instance].center, instances[instance].extent).seen {
        append(claim(1u), Visit(instance, 0u));
    }
}
