// Stage 6. Visibility buffer -> depth pyramid: for every square of 2, 4, 8, ... pixels the farthest key in it. A round
// makes LEVELS_PER_ROUND levels, a lane for each texel of the last of them: no lane waits for another. Pixels are looked
// at in tiles that something was drawn to.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read_write> pyramid: array<u32>;
@group(0) @binding(3) var<storage, read_write> counters: Counters;

const FIRST_LEVEL: u32 = ROUND * LEVELS_PER_ROUND;
// Pixels across and down that a lane of the first round looks at.
const LANE_PIXELS: u32 = 1u << LEVELS_PER_ROUND;
// Where nothing is: nearer than anything.
const NOWHERE: u32 = 0xffffffffu;

// The key at a place of what the round starts from.
fn source(x: u32, y: u32) -> u32 {
    if FIRST_LEVEL == 0u {
        if x >= view.width || y >= view.height {
            return NOWHERE;
        }
        return key_of(y * view.width + x);
    }
    let level = view.pyramid[max(FIRST_LEVEL, 1u) - 1u];
    if x >= level.x || y >= level.y {
        return NOWHERE;
    }
    return pyramid[level.z + y * level.w + x];
}

fn store(level: u32, x: u32, y: u32, key: u32) {
    if level < view.levels && x < view.pyramid[level].x && y < view.pyramid[level].y {
        pyramid[view.pyramid[level].z + y * view.pyramid[level].w + x] = key;
    }
}

// Whether anything may have been drawn to the pixels of a lane, which starts at this one.
fn drawn_to(start: vec2<u32>) -> bool {
    let size = vec2<u32>(view.width, view.height);
    return all(start < size) && touched(vec4<u32>(start, min(start + LANE_PIXELS, size) - 1u));
}

// The key of a texel of the round's first level; 0 where nothing was drawn.
fn first(x: u32, y: u32, drawn: bool) -> u32 {
    var key = 0u;
    if drawn {
        key = source(2u * x, 2u * y);
    }
    // Nothing is farther than where nothing is drawn: of the background one place in four is looked at.
    if key != 0u {
        key = min(key, source(2u * x + 1u, 2u * y));
        let lower = min(source(2u * x, 2u * y + 1u), source(2u * x + 1u, 2u * y + 1u));
        key = min(key, lower);
    }
    store(FIRST_LEVEL, x, y, key);
    return key;
}

@compute @workgroup_size(PYRAMID_SIDE, PYRAMID_SIDE)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    var third = NOWHERE;
    let drawn = FIRST_LEVEL > 0u || drawn_to(LANE_PIXELS * id.xy);
    for (var i = 0u; i < 4u; i++) {
        let x = 2u * id.x + (i & 1u);
        let y = 2u * id.y + (i >> 1u);
        let upper = min(first(2u * x, 2u * y, drawn), first(2u * x + 1u, 2u * y, drawn));
        let lower = min(first(2u * x, 2u * y + 1u, drawn), first(2u * x + 1u, 2u * y + 1u, drawn));
        let second = min(upper, lower);
        store(FIRST_LEVEL + 1u, x, y, second);
        third = min(third, second);
    }
    store(FIRST_LEVEL + 2u, id.x, id.y, third);
}
