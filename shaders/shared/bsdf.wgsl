// The BSDF of a surface point: src/cpu/material.rs.
// Needs: surface.wgsl, instance_materials, lighting.

struct Bsdf {
    // Unit, camera space.
    normal: vec3<f32>,
    base: vec3<f32>,
    metallic: f32,
    // Perceptual, 0.04 to 1.
    roughness: f32,
    // Emitted light.
    emissive: vec3<f32>,
    // How much of the light from everywhere arrives.
    occlusion: f32,
    // Whether light counts.
    lit: bool,
}

// What a material gives off: pyrender multiplies by it twice.
fn shaded_emission(emissive: vec3<f32>) -> vec3<f32> {
    return select(emissive, emissive * emissive, lighting.shading == SHADING_PYRENDER);
}

// Of a material without textures.
fn plain_bsdf(surfel: Surfel) -> Bsdf {
    let instance_material = instance_materials[surfel.instance];
    let base = vec3<f32>(instance_material.normal[0].w, instance_material.normal[1].w, instance_material.normal[2].w);
    let lit = (instance_material.flags & MATERIAL_UNLIT) == 0u;
    return Bsdf(surfel.normal, base, instance_material.metallic, instance_material.roughness, shaded_emission(instance_material.emissive), 1.0, lit);
}
