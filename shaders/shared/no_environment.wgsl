// A scene without an environment map.
// Needs: bsdf.wgsl.

fn image_based_light(bsdf: Bsdf, diffuse: vec3<f32>, f0: vec3<f32>, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(0.0);
}

fn shows_environment() -> bool {
    return false;
}

fn light_behind(pixel: u32) -> vec3<f32> {
    return vec3<f32>(0.0);
}
