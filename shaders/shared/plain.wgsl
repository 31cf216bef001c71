// Surfaces of a scene without textures.

fn bsdf_of(surfel: Surfel) -> Bsdf {
    return plain_bsdf(surfel);
}
