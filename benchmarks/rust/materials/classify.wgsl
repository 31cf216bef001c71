// Which materials occur in which tile: a workgroup looks at a tile, and puts it on the list of each that it finds.

@group(1) @binding(1) var<storage, read_write> numbers: array<u32>;
// Of each material as many as there are in the picture.
@group(1) @binding(2) var<storage, read_write> lists: array<u32>;
// Of each material: blocks of a tile, tiles, 1.
@group(1) @binding(3) var<storage, read_write> draw_args: array<atomic<u32>>;
@group(1) @binding(4) var picture: texture_storage_2d<r32uint, write>;

const OCCURS: u32 = MOST_MATERIALS / 32u;

var<workgroup> occurs: array<atomic<u32>, OCCURS>;

@compute @workgroup_size(LANES)
fn classify(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    for (var i = lane; i < OCCURS; i += LANES) {
        atomicStore(&occurs[i], 0u);
    }
    workgroupBarrier();
    var last = NONE;
    for (var i = lane; i < TILE * TILE; i += LANES) {
        let at = tile.xy * TILE + vec2<u32>(i % TILE, i / TILE);
        if at.x < view.width && at.y < view.height {
            let pixel = at.y * view.width + at.x;
            let material = material_at(pixel);
            numbers[pixel] = material;
            if material == NONE {
                textureStore(picture, at, vec4<u32>(NONE));
            } else if material != last {
                atomicOr(&occurs[material / 32u], 1u << (material % 32u));
                last = material;
            }
        }
    }
    workgroupBarrier();
    for (var i = lane; i < turn.materials; i += LANES) {
        if (atomicLoad(&occurs[i / 32u]) >> (i % 32u) & 1u) != 0u {
            let place = atomicAdd(&draw_args[3u * i + 1u], 1u);
            lists[i * turn.tiles + place] = tile.y * turn.columns + tile.x;
        }
    }
}
