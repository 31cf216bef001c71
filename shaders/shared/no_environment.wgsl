// A scene without light from all around by a map.

fn reflect_surroundings(bsdf: Bsdf, diffuse: vec3<f32>, f0: vec3<f32>, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(0.0);
}

fn shows_surroundings() -> bool {
    return false;
}

fn light_behind(pixel: u32) -> vec3<f32> {
    return vec3<f32>(0.0);
}
