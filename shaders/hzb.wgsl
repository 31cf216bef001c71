// Stage 6. Visibility buffer -> depth pyramid: for every square of 2, 4, 8, ... pixels the farthest key in it. A round
// makes LEVELS_PER_ROUND levels, a workgroup for each square of the last of them.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read_write> pyramid: array<u32>;

const SIDE: u32 = 1u << (LEVELS_PER_ROUND - 1u);
const FIRST_LEVEL: u32 = ROUND * LEVELS_PER_ROUND;
// Where nothing is: nearer than anything.
const NOWHERE: u32 = 0xffffffffu;

var<workgroup> keys: array<u32, SIDE * SIDE>;

// The key at a place of what the round starts from.
fn source(at: vec2<u32>) -> u32 {
    if FIRST_LEVEL == 0u {
        if at.x >= view.width || at.y >= view.height {
            return NOWHERE;
        }
        return words[2u * (at.y * view.width + at.x) + 1u];
    }
    let level = view.pyramid[max(FIRST_LEVEL, 1u) - 1u];
    if at.x >= level.x || at.y >= level.y {
        return NOWHERE;
    }
    return pyramid[level.z + at.y * level.x + at.x];
}

fn store(level: u32, at: vec2<u32>, key: u32) {
    if level < view.levels && at.x < view.pyramid[level].x && at.y < view.pyramid[level].y {
        pyramid[view.pyramid[level].z + at.y * view.pyramid[level].x + at.x] = key;
    }
}

@compute @workgroup_size(SIDE, SIDE)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let at = workgroup.xy * SIDE + local.xy;
    let upper = min(source(2u * at), source(2u * at + vec2<u32>(1u, 0u)));
    let lower = min(source(2u * at + vec2<u32>(0u, 1u)), source(2u * at + vec2<u32>(1u, 1u)));
    var key = min(upper, lower);
    store(FIRST_LEVEL, at, key);
    var side = SIDE;
    for (var k = 1u; k < LEVELS_PER_ROUND; k++) {
        workgroupBarrier();
        if local.x < side && local.y < side {
            keys[local.y * SIDE + local.x] = key;
        }
        workgroupBarrier();
        side /= 2u;
        if local.x < side && local.y < side {
            let i = 2u * local.y * SIDE + 2u * local.x;
            key = min(min(keys[i], keys[i + 1u]), min(keys[i + SIDE], keys[i + SIDE + 1u]));
            store(FIRST_LEVEL + k, workgroup.xy * side + local.xy, key);
        }
    }
}
