// The tiles of a material: a workgroup looks at 8 x 8 pixels of one, and shades those that show the material.

@group(1) @binding(1) var<storage, read> numbers: array<u32>;
@group(1) @binding(2) var<storage, read> lists: array<u32>;
@group(1) @binding(3) var picture: texture_storage_2d<r32uint, write>;

@compute @workgroup_size(BLOCK * BLOCK)
fn shade_tiles(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tile = lists[turn.material * turn.tiles + workgroup.y];
    let across = TILE / BLOCK;
    let block = vec2<u32>(workgroup.x % across, workgroup.x / across);
    // Lanes that run together lie together, however many they are.
    let own = vec2<u32>(
        (lane & 1u) | (lane >> 1u & 2u) | (lane >> 2u & 4u),
        (lane >> 1u & 1u) | (lane >> 2u & 2u) | (lane >> 3u & 4u),
    );
    let at = vec2<u32>(tile % turn.columns, tile / turn.columns) * TILE + block * BLOCK + own;
    if at.x >= view.width || at.y >= view.height {
        return;
    }
    let pixel = at.y * view.width + at.x;
    if numbers[pixel] == turn.material {
        textureStore(picture, at, vec4<u32>(color_at(pixel)));
    }
}
