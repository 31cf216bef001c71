// Surfaces of a scene without textures.
// Needs: bsdf.wgsl.

fn bsdf_of(surfel: Surfel) -> Bsdf {
    return plain_bsdf(surfel);
}
