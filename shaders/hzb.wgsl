// Stage 6, hierarchical Z-buffer: reduces the visibility buffer to a pyramid of the farthest key of every 2, 4, 8, ...
// pixels (Greene, Kass and Miller 1993).
// One dispatch makes LEVELS_PER_DISPATCH levels from the one below. One workgroup handles as many texels of that as make
// one texel of the last level, one invocation a square of two by two of them.
// Reads the visibility buffer, only in tiles that something was drawn to, or the level below. Writes the depth pyramid.
// Needs: key.wgsl, target.wgsl, tiles.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read_write> pyramid: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read_write> counters: Counters;

// The level that a dispatch starts from.
const SOURCE: u32 = PYRAMID_DISPATCH * LEVELS_PER_DISPATCH;
// Texels of it across and down that a workgroup looks at.
const REGION: u32 = 2u * PYRAMID_SIDE;
// Where nothing is: nearer than anything.
const NOWHERE: u32 = 0xffffffffu;

// Whether anything may have been drawn to the region.
var<workgroup> drawn: u32;
// The keys of the level made last.
var<workgroup> keys: array<array<u32, PYRAMID_SIDE>, PYRAMID_SIDE>;

// The key of a texel of the source; of a pixel where nothing was drawn to, 0.
fn source(x: u32, y: u32, drawn: bool) -> u32 {
    let level = view.pyramid[SOURCE];
    if x >= level.x || y >= level.y {
        return NOWHERE;
    }
    if PYRAMID_DISPATCH > 0u {
        return pyramid[(level.z + y * level.w + x) / 4u][x % 4u];
    }
    var key = 0u;
    if drawn {
        key = key_of(pixel_address(x, y));
    }
    if level.w > 0u {
        store(0u, x, y, key);
    }
    return key;
}

fn store(level: u32, x: u32, y: u32, key: u32) {
    if level < view.levels && x < view.pyramid[level].x && y < view.pyramid[level].y {
        pyramid[(view.pyramid[level].z + y * view.pyramid[level].w + x) / 4u][x % 4u] = key;
    }
}

@compute @workgroup_size(PYRAMID_SIDE, PYRAMID_SIDE)
fn main(
    @builtin(workgroup_id) region: vec3<u32>,
    @builtin(local_invocation_id) lane: vec3<u32>,
    @builtin(global_invocation_id) id: vec3<u32>,
) {
    if all(lane == vec3<u32>()) {
        let start = REGION * region.xy;
        let size = vec2<u32>(view.width, view.height);
        drawn = u32(PYRAMID_DISPATCH > 0u || touched(vec4<u32>(start, min(start + REGION, size) - 1u)));
    }
    workgroupBarrier();
    let at = 2u * id.xy;
    let any = drawn != 0u;
    let upper = min(source(at.x, at.y, any), source(at.x + 1u, at.y, any));
    var key = min(upper, min(source(at.x, at.y + 1u, any), source(at.x + 1u, at.y + 1u, any)));
    store(SOURCE + 1u, id.x, id.y, key);
    // Each level has half as many texels across and down.
    for (var level = 2u; level <= LEVELS_PER_DISPATCH; level++) {
        keys[lane.y][lane.x] = key;
        workgroupBarrier();
        let side = REGION >> level;
        if all(lane.xy < vec2<u32>(side)) {
            let at = 2u * lane.xy;
            key = min(
                min(keys[at.y][at.x], keys[at.y][at.x + 1u]),
                min(keys[at.y + 1u][at.x], keys[at.y + 1u][at.x + 1u]),
            );
            store(SOURCE + level, side * region.x + lane.x, side * region.y + lane.y, key);
        }
        workgroupBarrier();
    }
}
