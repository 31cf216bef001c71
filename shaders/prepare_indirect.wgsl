// Prepares the indirect arguments of what follows the culling of a pass: whether the second pass runs, what is renumbered,
// and whether a depth pyramid is built.
// One invocation.
// Reads the counts of both passes. Writes indirect arguments.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> occluded_dispatch: Dispatch;
@group(0) @binding(2) var<storage, read> draws: array<Dispatch, LISTS>;
@group(0) @binding(3) var<storage, read_write> counters: Counters;
// Of the other pass.
@group(0) @binding(4) var<storage, read_write> other_counters: Counters;
// Words of the bits of groups, pixels to renumber, and the rounds of the pyramid.
@group(0) @binding(5) var<storage, read_write> indirect: array<Dispatch, INDIRECT_ENTRIES>;

fn build_pyramid() {
    // From the pixels on, each dispatch starts from the last level of the one before.
    for (var level = 0u; level == 0u || level + 1u < view.levels; level += LEVELS_PER_DISPATCH) {
        let side = 1u << LEVELS_PER_DISPATCH;
        let size = (view.pyramid[level].xy + side - 1u) / side;
        let entry = INDIRECT_PYRAMID + level / LEVELS_PER_DISPATCH;
        indirect[entry] = Dispatch(size.x, size.y, 1u, 0u, 0u, 0u, array<u32, 2>());
    }
    atomicStore(&counters.pyramid, 1u);
    if SECOND {
        // What was drawn to by now, in either pass.
        for (var row = 0u; row < TILES; row++) {
            atomicOr(&counters.tiles[row], atomicLoad(&other_counters.tiles[row]));
        }
    }
}

@compute @workgroup_size(1)
fn main() {
    if !SECOND {
        if occluded_dispatch.count > 0u || atomicLoad(&counters.occluded) > 0u {
            indirect[INDIRECT_GROUPS] = workgroups(view.group_words, GROUP_BLOCK, view.group_words);
            build_pyramid();
        }
        return;
    }
    let fresh = draws[LIST_SMALL].count + draws[LIST_LARGE].count + draws[LIST_CLIPPED].count
        + draws[LIST_ALPHA_TESTED].count;
    if fresh > 0u && atomicLoad(&other_counters.visible) > 0u {
        let columns = (view.width + WIDTH - 1u) / WIDTH;
        let blocks = columns * ((view.height + PIXELS_PER_LANE - 1u) / PIXELS_PER_LANE);
        indirect[INDIRECT_PIXELS] = workgroups(blocks, 1u, blocks);
    }
    let triangles = atomicLoad(&other_counters.drawn_small) + atomicLoad(&other_counters.drawn_large);
    // That of the first pass will do for the next frame unless much came to it.
    if fresh > atomicLoad(&other_counters.visible) / 2u || (atomicLoad(&other_counters.pyramid) == 0u && triangles > PYRAMID_ABOVE) {
        build_pyramid();
    }
}
