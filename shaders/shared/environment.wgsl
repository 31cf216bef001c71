// Image-based lighting by an environment map: src/cpu/environment.rs, operation for operation.
// Needs: bsdf.wgsl, target.wgsl, lighting.

// Where directions lie on an unfolded octahedron, -1 to 1.
fn unfolded(d: vec3<f32>) -> vec2<f32> {
    let inverse = 1.0 / (abs(d.x) + abs(d.y) + abs(d.z));
    let u = d.x * inverse;
    let v = d.z * inverse;
    let p = -(abs(v) - 1.0);
    let q = -(abs(u) - 1.0);
    return select(vec2<f32>(u, v), vec2<f32>(select(p, -p, u < 0.0), select(q, -q, v < 0.0)), d.y < 0.0);
}

fn to_map(d: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        dot3(d, lighting.to_map[0].xyz),
        dot3(d, lighting.to_map[1].xyz),
        dot3(d, lighting.to_map[2].xyz),
    );
}

// A node and the way from there to the next, of so many along a side.
struct Step {
    node: u32,
    part: f32,
}

fn step_of(part: f32, side: u32) -> Step {
    let at = part * f32(side - 1u);
    let node = min(u32(at), side - 2u);
    return Step(node, at - f32(node));
}

fn entry(at: u32) -> vec3<f32> {
    return vec3<f32>(tables[at], tables[at + 1u], tables[at + 2u]);
}

// Between the four values about a place, of a square of them.
fn bilinear(side: u32, start: u32, place: vec2<f32>) -> vec3<f32> {
    let x = step_of(place.x, side);
    let y = step_of(place.y, side);
    let first = start + 3u * (y.node * side + x.node);
    let below = first + 3u * side;
    let a = entry(first);
    let upper = a + (entry(first + 3u) - a) * x.part;
    let b = entry(below);
    let lower = b + (entry(below + 3u) - b) * x.part;
    return upper + (lower - upper) * y.part;
}

// The light of a grid at a place.
fn light_at(grid: u32, place: vec2<f32>) -> vec3<f32> {
    let own = lighting.grids[grid];
    return bilinear(own.x, BYTE_STEPS + own.y, place * 0.5 + 0.5);
}

// Light reflected to `v`.
fn image_based_light(bsdf: Bsdf, diffuse: vec3<f32>, f0: vec3<f32>, v: vec3<f32>) -> vec3<f32> {
    let n = bsdf.normal;
    let nv = dot3(n, v);
    let irradiance = light_at(IRRADIANCE, unfolded(to_map(n)));
    let mirrored = n * (nv * 2.0) - v;
    // Rough surfaces reflect nearer to their normals.
    let alpha = bsdf.roughness * bsdf.roughness;
    let smoothness = -(alpha - 1.0);
    let main = n + (mirrored - n) * (smoothness * (sqrt(smoothness) + alpha));
    let place = unfolded(to_map(main));
    let level = step_of(bsdf.roughness, ROUGHNESS_LEVELS);
    let finer = light_at(level.node, place);
    let gloss = finer + (light_at(level.node + 1u, place) - finer) * level.part;
    let albedo = bilinear(ALBEDO_SIDE, BYTE_STEPS, vec2<f32>(sqrt(between(nv, 0.0, 1.0)), bsdf.roughness));
    let kept = (1.0 - f0) * (1.0 - albedo.z);
    return (irradiance * (diffuse * kept) + gloss * (f0 * albedo.x + albedo.y)) * lighting.intensity;
}

fn shows_environment() -> bool {
    return lighting.environment_visible != 0u;
}

// What is seen of the map itself at a pixel.
fn light_behind(pixel: u32) -> vec3<f32> {
    let point = vec2<f32>(pixel_of(pixel)) + 0.5;
    var direction = unprojected(point, 1.0);
    if view.orthographic != 0u {
        direction = vec3<f32>(0.0, 0.0, -1.0);
    }
    return light_at(0u, unfolded(to_map(direction))) * lighting.intensity;
}
