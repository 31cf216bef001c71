// A surface point with all that light needs: src/cpu/material.rs.

struct Bsdf {
    // Unit, camera space.
    normal: vec3<f32>,
    base: vec3<f32>,
    metallic: f32,
    // Perceptual, 0.04 to 1.
    roughness: f32,
    // Light given off.
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
    let look = looks[surfel.instance];
    let base = vec3<f32>(look.normal[0].w, look.normal[1].w, look.normal[2].w);
    let lit = (look.flags & LOOK_UNLIT) == 0u;
    return Bsdf(surfel.normal, base, look.metallic, look.roughness, shaded_emission(look.emissive), 1.0, lit);
}
