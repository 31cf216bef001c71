// Stage 6, hierarchical Z-buffer: reduces the visibility buffer to a pyramid of the farthest key of every 2, 4, 8, ...
// pixels (Greene, Kass and Miller 1993).
// One dispatch makes LEVELS_PER_DISPATCH levels from the one below; one invocation handles one texel of the last of them.
// Reads the visibility buffer, only in tiles that something was drawn to, or the level below. Writes the depth pyramid.
// Needs: key.wgsl, tiles.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read_write> pyramid: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read_write> counters: Counters;

// What a round starts from.
const SOURCE: u32 = PYRAMID_DISPATCH * LEVELS_PER_DISPATCH;
// Texels of it across and down that a lane looks at.
const LANE_TEXELS: u32 = 1u << LEVELS_PER_DISPATCH;
// Where nothing is: nearer than anything.
const NOWHERE: u32 = 0xffffffffu;

// The keys of four texels of a row of the source; of pixels of which none was drawn to, 0.
fn source(x: u32, y: u32, drawn: bool) -> vec4<u32> {
    let level = view.pyramid[SOURCE];
    var keys = vec4<u32>();
    if y >= level.y {
        return vec4<u32>(NOWHERE);
    }
    if PYRAMID_DISPATCH > 0u {
        keys = pyramid[(level.z + y * level.w + x) / 4u];
    } else if drawn {
        // Reading behind the end of a row does no harm.
        let pixel = y * level.x + x;
        keys = vec4<u32>(key_of(pixel), key_of(pixel + 1u), key_of(pixel + 2u), key_of(pixel + 3u));
    }
    return select(keys, vec4<u32>(NOWHERE), vec4<u32>(x) + vec4<u32>(0u, 1u, 2u, 3u) >= vec4<u32>(level.x));
}

// Stores four texels of a row.
fn store(level: u32, x: u32, y: u32, keys: vec4<u32>) {
    if level < view.levels && x < view.pyramid[level].x && y < view.pyramid[level].y {
        pyramid[(view.pyramid[level].z + y * view.pyramid[level].w + x) / 4u] = keys;
    }
}

// Stores one.
fn store_one(level: u32, x: u32, y: u32, key: u32) {
    if level < view.levels && x < view.pyramid[level].x && y < view.pyramid[level].y {
        pyramid[(view.pyramid[level].z + y * view.pyramid[level].w + x) / 4u][x % 4u] = key;
    }
}

// Whether anything may have been drawn to the pixels of a lane, which starts at this one.
fn drawn_to(start: vec2<u32>) -> bool {
    let size = vec2<u32>(view.width, view.height);
    return all(start < size) && touched(vec4<u32>(start, min(start + LANE_TEXELS, size) - 1u));
}

// The farther of every two.
fn pairs(keys: vec4<u32>) -> vec2<u32> {
    return min(keys.xz, keys.yw);
}

// The keys of two squares beside each other, of two texels of the source across and down; stores those of pixels.
fn squares(x: u32, y: u32, drawn: bool) -> vec2<u32> {
    let upper = source(x, y, drawn);
    let lower = source(x, y + 1u, drawn);
    if PYRAMID_DISPATCH == 0u && view.pyramid[0].w > 0u {
        store(0u, x, y, upper);
        store(0u, x, y + 1u, lower);
    }
    return pairs(min(upper, lower));
}

@compute @workgroup_size(PYRAMID_SIDE, PYRAMID_SIDE)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let drawn = PYRAMID_DISPATCH > 0u || drawn_to(LANE_TEXELS * id.xy);
    var second = vec2<u32>(NOWHERE);
    var third = NOWHERE;
    for (var row = 0u; row < LANE_TEXELS / 2u; row++) {
        let at = LANE_TEXELS * id.xy + vec2<u32>(0u, 2u * row);
        var first: vec4<u32>;
        // A loop: in software the same code twice is slower by a third.
        for (var half = 0u; half < 2u; half++) {
            let two = squares(at.x + 4u * half, at.y, drawn);
            first = select(vec4<u32>(two, 0u, 0u), vec4<u32>(first.xy, two), half == 1u);
        }
        store(SOURCE + 1u, 4u * id.x, 4u * id.y + row, first);
        second = min(second, pairs(first));
        if row % 2u == 1u {
            let y = 2u * id.y + row / 2u;
            store_one(SOURCE + 2u, 2u * id.x, y, second.x);
            store_one(SOURCE + 2u, 2u * id.x + 1u, y, second.y);
            third = min(third, min(second.x, second.y));
            second = vec2<u32>(NOWHERE);
        }
    }
    store_one(SOURCE + 3u, id.x, id.y, third);
}
