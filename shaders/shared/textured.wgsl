// Surfaces of a scene with textures.
// Needs: bsdf.wgsl, texture.wgsl, material.wgsl.

@group(0) @binding(14) var<storage, read> materials: array<Material>;
@group(0) @binding(15) var<storage, read> texels: array<u32>;

fn as_in_pyrender() -> bool {
    return lighting.shading == SHADING_PYRENDER;
}

fn bsdf_of(surfel: Surfel) -> Bsdf {
    if instance_materials[surfel.instance].first_material == NONE {
        return plain_bsdf(surfel);
    }
    let number = material_of(surfel);
    let change = change_of(surfel);
    // A loop, so that compilers have what samples but once.
    var samples: array<vec4<f32>, SLOTS>;
    for (var slot = 0u; slot < SLOTS; slot++) {
        samples[slot] = sample_of(surfel, change, number, slot);
    }
    let map = samples[SLOT_METALLIC_ROUGHNESS];
    let open = samples[SLOT_OCCLUSION].x;
    return Bsdf(
        mapped_normal(surfel, number, samples[SLOT_NORMAL].xyz),
        materials[number].base * samples[SLOT_BASE_COLOR].xyz,
        between(materials[number].metallic * map.z, 0.0, 1.0),
        between(materials[number].roughness * map.y, LEAST_ROUGHNESS, 1.0),
        shaded_emission(materials[number].emissive) * samples[SLOT_EMISSIVE].xyz,
        1.0 + materials[number].occlusion_strength * (open - 1.0),
        (materials[number].flags & MATERIAL_UNLIT) == 0u,
    );
}
