// Texture filtering, anisotropic over mip levels: src/cpu/texture.rs, operation for operation. `texels` begins with the linear
// light of sRGB bytes.
// Needs: texels.

// Where a pixel lies on an image, in the image's sides from its upper left corner.
struct Place {
    at: vec2<f32>,
    // To the next pixel on the right, and to the one below.
    right: vec2<f32>,
    below: vec2<f32>,
}

fn turned(texture: Texture, d: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(
        texture.rows[0].x * d.x + texture.rows[0].y * d.y,
        texture.rows[1].x * d.x + texture.rows[1].y * d.y,
    );
}

// From UVs and their changes to the image.
fn place_of(texture: Texture, uv: vec2<f32>, right: vec2<f32>, below: vec2<f32>) -> Place {
    let at = turned(texture, uv) + vec2<f32>(texture.rows[0].z, texture.rows[1].z);
    return Place(at, turned(texture, right), turned(texture, below));
}

// The logarithm of a normal number, within 2.2e-5: the exponent, and a polynomial for the rest.
fn log2_of(v: f32) -> f32 {
    let bits = bitcast<u32>(v);
    let exponent = f32(bits >> 23u) - 127.0;
    let t = bitcast<f32>(bits & 0x7fffffu | 0x3f800000u) - 1.0;
    let bend = ((LOG2_BEND_0 * t + LOG2_BEND_1) * t + LOG2_BEND_2) * t + LOG2_BEND_3;
    return exponent + (t + t * (1.0 - t) * bend);
}

// The light of a number that is sRGB, between those of two bytes.
fn srgb_light(v: f32) -> f32 {
    let at = v * 255.0;
    let byte = min(u32(at), 254u);
    let below = bitcast<f32>(texels[byte]);
    let above = bitcast<f32>(texels[byte + 1u]);
    return below + (above - below) * (at - f32(byte));
}

// Two halves, which are normal numbers or 0.
fn halves(bits: u32) -> vec2<f32> {
    let h = vec2<u32>(bits & 0xffffu, bits >> 16u);
    let number = h & vec2<u32>(0x7fffu);
    let rebased = ((h & vec2<u32>(0x8000u)) << vec2<u32>(16u)) | ((number << vec2<u32>(13u)) + (112u << 23u));
    return bitcast<vec2<f32>>(select(rebased, vec2<u32>(0u), number == vec2<u32>(0u)));
}

fn texel(texture: Texture, start: u32, at: u32) -> vec4<f32> {
    let format = texture.flags >> TEXTURE_FORMAT & 3u;
    if format == FORMAT_HALF {
        let first = start + 2u * at;
        return vec4<f32>(halves(texels[first]), halves(texels[first + 1u]));
    }
    let bits = texels[start + at];
    let bytes = vec4<u32>(bits & 0xffu, bits >> 8u & 0xffu, bits >> 16u & 0xffu, bits >> 24u);
    let values = vec4<f32>(bytes) * (1.0 / 255.0);
    if format == FORMAT_SRGB_8 {
        return vec4<f32>(
            bitcast<f32>(texels[bytes.x]),
            bitcast<f32>(texels[bytes.y]),
            bitcast<f32>(texels[bytes.z]),
            values.w,
        );
    }
    return values;
}

// A coordinate brought to where it has a period: 0 to 1, or to 2 for a mirror.
fn wrapped_point(wrap: u32, at: f32) -> f32 {
    switch wrap {
        case WRAP_REPEAT: { return between(at - floor(at), 0.0, 1.0); }
        case WRAP_MIRROR: { return between(at - 2.0 * floor(at * 0.5), 0.0, 2.0); }
        default: { return between(at, 0.0, 1.0); }
    }
}

// The texel of a number up to one beyond its period.
fn wrapped_texel(wrap: u32, at: i32, count: i32) -> u32 {
    var i = at;
    switch wrap {
        case WRAP_REPEAT: {
            if i < 0 {
                i += count;
            } else if i >= count {
                i -= count;
            }
        }
        case WRAP_MIRROR: {
            if i < 0 {
                i = -1 - i;
            } else if i >= 2 * count {
                i -= 2 * count;
            } else if i >= count {
                i = 2 * count - 1 - i;
            }
        }
        default: { i = clamp(i, 0, count - 1); }
    }
    return u32(i);
}

// At a point of a level.
fn level_at(texture: Texture, at: vec2<f32>, level: u32) -> vec4<f32> {
    var size = vec2<u32>(u32(texture.rows[0].w), u32(texture.rows[1].w));
    var start = texture.start;
    let words = select(1u, 2u, (texture.flags >> TEXTURE_FORMAT & 3u) == FORMAT_HALF);
    for (var l = 0u; l < level; l++) {
        start += words * size.x * size.y;
        size = max(size >> vec2<u32>(1u), vec2<u32>(1u));
    }
    let wrap = vec2<u32>(texture.flags >> TEXTURE_WRAP & 3u, texture.flags >> (TEXTURE_WRAP + 2u) & 3u);
    let count = vec2<i32>(size);
    let point = vec2<f32>(wrapped_point(wrap.x, at.x), wrapped_point(wrap.y, at.y)) * vec2<f32>(size);
    if (texture.flags >> TEXTURE_LINEAR & 1u) == 0u {
        let x = wrapped_texel(wrap.x, i32(floor(point.x)), count.x);
        let y = wrapped_texel(wrap.y, i32(floor(point.y)), count.y);
        return texel(texture, start, y * size.x + x);
    }
    let corner = floor(point - 0.5);
    let part = (point - 0.5) - corner;
    let first = vec2<i32>(corner);
    let left = wrapped_texel(wrap.x, first.x, count.x);
    let right = wrapped_texel(wrap.x, first.x + 1, count.x);
    let top = size.x * wrapped_texel(wrap.y, first.y, count.y);
    let bottom = size.x * wrapped_texel(wrap.y, first.y + 1, count.y);
    let a = texel(texture, start, top + left);
    let above = a + (texel(texture, start, top + right) - a) * part.x;
    let b = texel(texture, start, bottom + left);
    let below = b + (texel(texture, start, bottom + right) - b) * part.x;
    return above + (below - above) * part.y;
}

// At a point, between levels.
fn filtered(texture: Texture, at: vec2<f32>, lod: f32) -> vec4<f32> {
    var level = u32(lod + 0.5);
    var part = 0.0;
    if (texture.flags >> TEXTURE_MIPMAPS & 3u) == MIPMAPS_LINEAR {
        level = u32(lod);
        part = lod - f32(level);
    }
    let near = level_at(texture, at, level);
    if part > 0.0 {
        return near + (level_at(texture, at, level + 1u) - near) * part;
    }
    return near;
}

fn footprint_length(d: vec2<f32>, size: vec2<f32>) -> f32 {
    let t = d * size;
    return between(t.x * t.x + t.y * t.y, 0.0, LONGEST_FOOTPRINT);
}

// What a pixel sees of a texture, linear RGBA.
fn sampled(texture: Texture, place: Place) -> vec4<f32> {
    let size = vec2<f32>(texture.rows[0].w, texture.rows[1].w);
    let a = footprint_length(place.right, size);
    let b = footprint_length(place.below, size);
    let axis = select(place.below, place.right, a >= b);
    let long = select(b, a, a >= b);
    let short = select(a, b, a >= b);
    var count = 1u;
    var lod = 0.0;
    if (texture.flags >> TEXTURE_MIPMAPS & 3u) != MIPMAPS_OFF {
        while f32(count) < texture.anisotropy && long > f32(count * count) * select(1.0, short, short > 1.0) {
            count++;
        }
        let narrow = long * (1.0 / f32(count * count));
        let width = select(short, narrow, narrow > short);
        lod = between(0.5 * log2_of(width), 0.0, f32(texture.levels - 1u));
    }
    var sum = vec4<f32>(0.0);
    for (var i = 0u; i < count; i++) {
        let along = (f32(i) + 0.5) * (1.0 / f32(count)) - 0.5;
        sum += filtered(texture, place.at + axis * along, lod);
    }
    let mean = sum * (1.0 / f32(count));
    if (texture.flags >> TEXTURE_FORMAT & 3u) == FORMAT_ENCODED_8 {
        return vec4<f32>(srgb_light(mean.x), srgb_light(mean.y), srgb_light(mean.z), mean.w);
    }
    return mean;
}
