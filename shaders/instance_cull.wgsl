// Stage 1. Instances of the scene -> as seen from the view, and the roots of those that may be on the screen. What an
// earlier frame hid is put off to the second phase, and all where the first has a list to start from.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> placed: array<Placed>;
@group(0) @binding(2) var<storage, read_write> instances: array<Instance>;
@group(0) @binding(3) var<storage, read_write> visits_out: array<Visit>;
@group(0) @binding(4) var<storage, read_write> next: DispatchOut;
@group(0) @binding(5) var<storage, read> pyramid: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read_write> later: array<Visit>;
@group(0) @binding(7) var<storage, read_write> later_level: DispatchOut;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) all: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let instance = workgroup_number(workgroup, all) * WIDTH + lane;
    if instance >= view.instances {
        return;
    }
    if placed[instance].visible == 0u {
        // Words of bits tell instances apart, those too that are not seen.
        instances[instance].group_words = placed[instance].group_words;
        // It may be on the list of the frame before: this tells that nothing of it is to be seen.
        instances[instance].lod_focal = 0.0;
        return;
    }
    var seen = derive(placed[instance], instances[instance].screen);
    let place = footprint(seen.screen, seen.center, seen.extent);
    // For the second phase, which looks at the box again.
    seen.rect = place.rect;
    seen.near_key = place.near_key;
    instances[instance] = seen;
    if !place.seen {
        return;
    }
    if view.history == HISTORY_LIST || hidden(place, instance, seen.center, seen.extent) {
        put_off(Visit(instance, 0u));
    } else {
        append(claim(1u), Visit(instance, 0u));
    }
}
