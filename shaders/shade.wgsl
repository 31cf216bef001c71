// Stage 7. Visibility buffer -> colour, encoded or not, four pixels a lane: src/cpu/shade.rs, operation for operation.
// pyrender's reflectance model, glTF's metallic-roughness BRDF.

@group(0) @binding(11) var<uniform> lighting: Lighting;
@group(0) @binding(12) var<storage, read> lights: array<Light>;
// The least value of each byte, and what is above all.
@group(0) @binding(13) var<storage, read> steps: array<f32>;

const PI: f32 = 3.14159265358979;

// Light reflected to `v` for light of intensity 1.
fn reflect_light(look: Look, n: vec3<f32>, v: vec3<f32>, l: vec3<f32>) -> vec3<f32> {
    let h = unit(l + v);
    let nl = between(dot3(n, l), 0.001, 1.0);
    let nv = between(abs(dot3(n, v)), 0.001, 1.0);
    let nh = between(dot3(n, h), 0.0, 1.0);
    let m = -(between(dot3(v, h), 0.0, 1.0) - 1.0);
    let schlick = m * m * m * m * m;
    let smith = (nv * (1.0 - look.k) + look.k) * (nl * (1.0 - look.k) + look.k);
    let d = nh * nh * (look.alpha2 - 1.0) + 1.0;
    let gloss = nv * nl * look.alpha2 / (smith * (d * d * PI) * (nl * nv * 4.0 + 0.001));
    let f = schlick * (1.0 - look.f0) + look.f0;
    return nl * (-(f - 1.0) * (look.diffuse * (1.0 / PI)) + f * gloss);
}

fn color_of(surfel: Surfel) -> vec3<f32> {
    let look = looks[surfel.instance];
    let scale = select(surfel.distance, 1.0, view.orthographic != 0u);
    let at = surfel.point - view.center;
    let position = vec3<f32>(
        at.x * view.inverse_focal.x * scale,
        -at.y * view.inverse_focal.y * scale,
        -surfel.distance,
    );
    let v = unit(-position);
    let base = vec3<f32>(look.normal[0].w, look.normal[1].w, look.normal[2].w);
    var color = base * lighting.ambient + look.emissive;
    for (var i = 0u; i < lighting.lights; i++) {
        let light = lights[i];
        var l = light.vector;
        var falloff = 1.0;
        if light.point != 0u {
            let to = light.vector - position;
            let square = dot3(to, to);
            let q = square * (light.inverse_range * light.inverse_range);
            let window = -(q * q - 1.0);
            l = unit(to);
            let along = between(-dot3(light.direction, l), 0.0, 1.0);
            let cone = between(along * light.cone_scale + light.cone_offset, 0.0, 1.0);
            falloff = select(0.0, window, window > 0.0) / square * (cone * cone);
        }
        color = color + reflect_light(look, surfel.normal, v, l) * falloff * light.radiance;
    }
    return color * surfel.tint;
}

// The byte of a value: near it, then exactly.
fn encode(value: f32) -> u32 {
    let c = between(value, 0.0, 1.0);
    var byte = u32(min(pow(c, lighting.power) * 255.0 + 0.5, 255.0));
    while steps[byte + 1u] <= c {
        byte++;
    }
    while byte > 0u && steps[byte] > c {
        byte--;
    }
    return byte;
}

@compute @workgroup_size(WIDTH)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let first = 4u * (workgroup_number(workgroup) * WIDTH + lane);
    let pixels = view.width * view.height;
    if first >= pixels {
        return;
    }
    var rgb: array<u32, 4>;
    for (var i = 0u; i < 4u; i++) {
        rgb[i] = lighting.background;
        var color = lighting.behind;
        let pixel = first + i;
        if pixel < pixels {
            let hit = hit_of(pixel);
            if hit.covered {
                color = color_of(surfel_of(pixel, hit));
                if OUTPUT_RGB {
                    rgb[i] = encode(color.x) | encode(color.y) << 8u | encode(color.z) << 16u;
                }
            }
            if !OUTPUT_RGB {
                for (var k = 0u; k < 3u; k++) {
                    out[3u * pixel + k] = bitcast<u32>(between(color[k], 0.0, LARGEST));
                }
            }
        }
    }
    if OUTPUT_RGB {
        store_bytes(first, rgb);
    }
}
