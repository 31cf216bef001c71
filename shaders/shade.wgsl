// Stage 7, shading: evaluates glTF's metallic-roughness BRDF, or pyrender's: src/cpu/shade.rs, operation for operation.
// One invocation handles four pixels.
// Reads the visibility buffer, pages, materials, lights. Writes colour, encoded or linear.
// Needs: frame_bindings.wgsl, surface.wgsl, unproject.wgsl, bsdf_of, image_based_light, receiver_of, lit_part.

@group(0) @binding(11) var<uniform> lighting: Lighting;
@group(0) @binding(12) var<storage, read> lights: array<Light>;
// The least value of each byte, and what is above all; then the environment's.
@group(0) @binding(13) var<storage, read> tables: array<f32>;

const PI: f32 = 3.14159265358979;

// Light reflected to `v` for light of intensity 1 from `l`.
fn reflect_light(bsdf: Bsdf, diffuse: vec3<f32>, f0: vec3<f32>, v: vec3<f32>, l: vec3<f32>) -> vec3<f32> {
    let n = bsdf.normal;
    let r = bsdf.roughness;
    let alpha2 = (r * r) * (r * r);
    let h = unit(l + v);
    let cosine = dot3(n, h);
    let nh = between(cosine, 0.0, 1.0);
    let side = cross3(n, h);
    let m = -(between(dot3(v, h), 0.0, 1.0) - 1.0);
    let schlick = m * m * m * m * m;
    // 1 - (n h)² is the square of |n × h|, which has no digits to lose where highlights are sharpest (Guy and Agopian,
    // "Physically Based Rendering in Filament").
    let d = select(dot3(side, side), 1.0, cosine < 0.0) + nh * nh * alpha2;
    var nl: f32;
    var gloss: f32;
    if lighting.shading == SHADING_GLTF {
        nl = between(dot3(n, l), 0.0, 1.0);
        let nv = between(dot3(n, v), LEAST_COSINE, 1.0);
        let rest = -(alpha2 - 1.0);
        let heights = nl * sqrt(nv * nv * rest + alpha2) + nv * sqrt(nl * nl * rest + alpha2);
        gloss = alpha2 * 0.5 / (d * d * PI * heights);
    } else {
        nl = between(dot3(n, l), LEAST_COSINE, 1.0);
        let nv = between(abs(dot3(n, v)), LEAST_COSINE, 1.0);
        let k = (r + 1.0) * (r + 1.0) / 8.0;
        let rest = -(k - 1.0);
        let smith = (nv * rest + k) * (nl * rest + k);
        gloss = nv * nl * alpha2 / (smith * (d * d * PI) * (nl * nv * 4.0 + LEAST_COSINE));
    }
    let f = schlick * -(f0 - 1.0) + f0;
    return nl * (-(f - 1.0) * (diffuse * (1.0 / PI)) + f * gloss);
}

// A surface point as the frame shades it, and where it is seen from.
struct Seen {
    bsdf: Bsdf,
    // Camera space.
    position: vec3<f32>,
    // Unit, to the eye.
    view: vec3<f32>,
}

fn seen_of(surfel: Surfel) -> Seen {
    var bsdf = bsdf_of(surfel);
    let position = unprojected(surfel.point, surfel.distance);
    var v = unit(-position);
    // pyrender's vertex colours come after the light, and its back faces have the normals of the front.
    if lighting.shading != SHADING_PYRENDER {
        bsdf.base = bsdf.base * surfel.tint;
        if view.orthographic != 0u {
            v = vec3<f32>(0.0, 0.0, 1.0);
        }
        if dot3(surfel.face, v) < 0.0 {
            bsdf.normal = -bsdf.normal;
        }
    }
    return Seen(bsdf, position, v);
}

fn to_world(n: vec3<f32>) -> vec3<f32> {
    return n.x * view.rotate[0].xyz + n.y * view.rotate[1].xyz + n.z * view.rotate[2].xyz;
}

// What is asked for of a surface point.
fn value_of(surfel: Surfel) -> vec3<f32> {
    let seen = seen_of(surfel);
    switch OUTPUT {
        case OUTPUT_BASE_COLOR: { return seen.bsdf.base; }
        case OUTPUT_SHADING_NORMAL: { return to_world(seen.bsdf.normal); }
        case OUTPUT_ORM: { return vec3<f32>(seen.bsdf.occlusion, seen.bsdf.roughness, seen.bsdf.metallic); }
        case OUTPUT_EMISSIVE: { return seen.bsdf.emissive; }
        default: { return color_of(seen, surfel.tint, receiver_of(surfel, seen.position)); }
    }
}

// The light that it sends to the eye.
fn color_of(seen: Seen, tint: vec3<f32>, receiver: Receiver) -> vec3<f32> {
    let bsdf = seen.bsdf;
    if lighting.shading == SHADING_NORMALS {
        return to_world(bsdf.normal) * 0.5 + 0.5;
    }
    if lighting.shading == SHADING_FLAT {
        return bsdf.base;
    }
    let gltf = lighting.shading == SHADING_GLTF;
    var color = bsdf.base * lighting.ambient;
    if gltf {
        color = color * bsdf.occlusion;
    }
    // pyrender takes what is reflected at right angles off once more.
    let rest = -(bsdf.metallic - 1.0);
    let diffuse = bsdf.base * select(rest * (1.0 - DIELECTRIC_F0), rest, gltf);
    let f0 = rest * DIELECTRIC_F0 + bsdf.base * bsdf.metallic;
    color = color + image_based_light(bsdf, diffuse, f0, seen.view) * bsdf.occlusion;
    for (var i = 0u; i < lighting.lights; i++) {
        let light = lights[i];
        var l = light.vector;
        var falloff = 1.0;
        if light.point != 0u {
            let to = light.vector - seen.position;
            let square = dot3(to, to);
            let q = square * (light.inverse_range * light.inverse_range);
            let window = -(q * q - 1.0);
            l = unit(to);
            let along = between(-dot3(light.direction, l), 0.0, 1.0);
            let cone = between(along * light.cone_scale + light.cone_offset, 0.0, 1.0);
            falloff = select(0.0, window, window > 0.0) / square * (cone * cone);
        }
        falloff = lit_part(falloff, i, receiver);
        color = color + reflect_light(bsdf, diffuse, f0, seen.view, l) * falloff * light.radiance;
    }
    if !gltf {
        color = color * bsdf.occlusion;
    }
    color = select(bsdf.base, color + bsdf.emissive, bsdf.lit);
    if !gltf {
        color = color * tint;
    }
    return color;
}

// The byte of a value: near it, then exactly.
fn encode(value: f32) -> u32 {
    let c = between(value, 0.0, 1.0);
    var byte = u32(min(pow(c, lighting.power) * 255.0 + 0.5, 255.0));
    while tables[byte + 1u] <= c {
        byte++;
    }
    while byte > 0u && tables[byte] > c {
        byte--;
    }
    return byte;
}

fn encoded(color: vec3<f32>) -> u32 {
    return encode(color.x) | encode(color.y) << 8u | encode(color.z) << 16u;
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let first = 4u * (workgroup_number(workgroup) * WIDTH + lane);
    let pixels = view.width * view.height;
    if first >= pixels {
        return;
    }
    var rgb: array<u32, 4>;
    for (var i = 0u; i < 4u; i++) {
        rgb[i] = lighting.background;
        var color = select(lighting.behind, vec3<f32>(0.0), OUTPUT_SURFACE);
        let pixel = first + i;
        if pixel < pixels {
            let hit = hit_of(pixel);
            if hit.covered {
                color = value_of(surfel_of(pixel, hit));
                if OUTPUT_RGB {
                    rgb[i] = encoded(color);
                }
            } else if shows_environment() && !OUTPUT_SURFACE {
                color = light_behind(pixel);
                if OUTPUT_RGB {
                    rgb[i] = encoded(color);
                }
            }
            if !OUTPUT_RGB {
                for (var k = 0u; k < 3u; k++) {
                    out[3u * pixel + k] = bitcast<u32>(select(between(color[k], 0.0, LARGEST), color[k], OUTPUT_SURFACE));
                }
            }
        }
    }
    if OUTPUT_RGB {
        store_bytes(first, rgb);
    }
}
