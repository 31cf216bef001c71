// Stage 1, instance culling: transforms the instances of the scene for the view, and tests their boxes against the frustum
// and the depth pyramid (two-pass occlusion culling: Haar and Aaltonen 2015, Karis 2021).
// One invocation handles one instance.
// Reads instance transforms and the pyramid of an earlier frame. Writes instances as the view sees them. Appends the root
// node of each visible instance to the traversal queue. It defers an occluded one to the second pass, and all of them
// where the first pass starts from the visible clusters of the frame before.
// Needs: derive.wgsl, occlusion.wgsl, append.wgsl, defer.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> transforms: array<InstanceTransform>;
@group(0) @binding(2) var<storage, read_write> instances: array<Instance>;
@group(0) @binding(3) var<storage, read_write> items_out: array<TraversalItem>;
@group(0) @binding(4) var<storage, read_write> next: DispatchArgsOut;
@group(0) @binding(5) var<storage, read> pyramid: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read_write> occluded_queue: array<TraversalItem>;
@group(0) @binding(7) var<storage, read_write> occluded_dispatch: DispatchArgsOut;

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let instance = workgroup_number(workgroup) * WIDTH + lane;
    if instance >= view.instances {
        return;
    }
    let pages = view.history == HISTORY_PAGES;
    if (transforms[instance].visible & select(SEEN_BY_VIEWS, SEEN_BY_LIGHTS, pages)) == 0u {
        // Words of bits tell instances apart, those too that are not seen.
        instances[instance].group_words = transforms[instance].group_words;
        // It may be on the list of the frame before: this tells that nothing of it is to be seen.
        instances[instance].lod_focal = 0.0;
        return;
    }
    var seen = derive(transforms[instance], instances[instance].screen);
    let place = footprint(seen.screen, seen.center, seen.extent);
    // What faces away from a light stops it as well.
    seen.double_sided |= select(0u, NONE, pages);
    // For the second pass, which looks at the box again.
    seen.rect = place.rect;
    seen.near_key = place.near_key;
    instances[instance] = seen;
    if !place.seen {
        return;
    }
    if view.history == HISTORY_LIST || hidden(place, instance, seen.center, seen.extent) {
        defer(TraversalItem(instance, 0u));
    } else {
        append(claim(1u), TraversalItem(instance, 0u));
    }
}
