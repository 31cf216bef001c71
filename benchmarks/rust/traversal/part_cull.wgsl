// The flat form, first step: every part of every instance on the screen, a lane each -> bits of the parts that may hold
// a cluster to draw. Parts are records like groups; where the hierarchy of a mesh would start stands how many it has.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> parts: array<Group>;
@group(0) @binding(3) var<storage, read> starts: array<TraversalItem>;
@group(0) @binding(4) var<storage, read> looking: Dispatch;
@group(0) @binding(5) var<storage, read_write> group_bits: array<atomic<u32>>;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = workgroup_number(workgroup);
    if number / BLOCKS >= looking.count {
        return;
    }
    let instance = starts[number / BLOCKS].instance;
    let at = number % BLOCKS * WIDTH + lane;
    if at >= instances[instance].first_node {
        return;
    }
    let part = parts[instances[instance].first_group + at];
    if may_be_in_cut(lod_view(instance), part.lod_sphere, part.error, part.min_own_error)
        && footprint(instances[instance].screen, part.center, part.extent).seen {
        mark_group(instances[instance].group_words, at);
    }
}
