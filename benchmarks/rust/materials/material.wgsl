// What the passes of both ways share, behind the product's shading, whose `material_of` is `own_material` here: there it
// looks a material up for each pixel, here a pass has one.

struct Turn {
    // The material of a pass.
    material: u32,
    // Materials, and one for all instances without a place in the table.
    materials: u32,
    // Tiles across, and all of them.
    columns: u32,
    tiles: u32,
}

@group(1) @binding(0) var<uniform> turn: Turn;

fn material_of(surfel: Surfel) -> u32 {
    return turn.material;
}

// The material that a pixel shows; NONE where nothing is.
fn material_at(pixel: u32) -> u32 {
    let hit = hit_of(pixel);
    if !hit.covered {
        return NONE;
    }
    let instance = visible[hit.number].instance;
    if instance_materials[instance].first_material == NONE {
        return turn.materials - 1u;
    }
    let cluster = visible[hit.number].cluster;
    // All that a material depends on.
    var surfel: Surfel;
    surfel.instance = instance;
    surfel.record = record_start(page_start(instance, cluster), cluster);
    return own_material(surfel);
}

// The bytes of a pixel, as the product encodes them.
fn color_at(pixel: u32) -> u32 {
    let color = value_of(surfel_of(pixel, hit_of(pixel)));
    return encode(color.x) | encode(color.y) << 8u | encode(color.z) << 16u;
}
