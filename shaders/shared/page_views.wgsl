// What rasterizers draw of shadow maps: entries are clusters and pages that they may touch, and each page is a view.
// Needs: derive.wgsl, visible, draws.

@group(0) @binding(0) var<storage, read> instances: array<InstanceTransform>;
@group(0) @binding(10) var<storage, read> page_views: array<View>;
@group(0) @binding(11) var<uniform> pairs: PairLists;

// The view of the page that a workgroup draws, and an instance as seen from it.
var<private> view: View;
var<private> seen_to_eye: array<vec4<f32>, 3>;
var<private> seen_screen: array<vec4<f32>, 3>;

// The number of entry `index` of a list; NONE behind its end.
fn listed(list: u32, index: u32) -> u32 {
    let there = index < min(draws[list].count, pairs.room);
    return select(NONE, pair_slot(list, index, pairs.room), there);
}

// Before anything of an entry is drawn.
fn look_at(number: u32) {
    view = page_views[visible[number].large];
    seen_to_eye = eye_rows(instances[visible[number].instance]);
    seen_screen = screen_rows(seen_to_eye);
}

fn screen_of(instance: u32) -> array<vec4<f32>, 3> {
    return seen_screen;
}

fn to_eye_of(instance: u32) -> array<vec4<f32>, 3> {
    return seen_to_eye;
}

fn mirrors(instance: u32) -> bool {
    return (instances[instance].mirrored ^ view.mirrored) != 0u;
}

// What faces away from a light stops it as well.
fn shows_backs(instance: u32, record: u32) -> bool {
    return true;
}
