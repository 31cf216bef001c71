// Lights that have a size: where the rays of a receiver begin, the bands that they climb, and what the map says of how high
// things are: src/shadow/soft.rs and src/cpu/shadow_soft.rs.
// Needs: shadow_receiver.wgsl.

// Nothing is as low as this.
const SHADOW_NOTHING: f32 = -LARGEST;
const SHADOW_TAU: f32 = 6.28318530717958647692;

// Where the rays of a receiver begin: `Start`, and how they go to the side.
struct ShadowStart {
    moved: ShadowMoved,
    // Its height, as the map has it.
    height: f32,
    // By how much coarser texels raise it, for each world unit that they are larger by.
    raise: f32,
    bands: u32,
    // How fast its surface may rise to the side, towards the light.
    lean: f32,
    // Of a directional light what rays to points right and up on its edge go to the side for each unit that they rise; else
    // all that they go to the side.
    right: vec3<f32>,
    up: vec3<f32>,
}

// By how many levels texels are coarser in a band than those of receivers.
fn shadow_coarser(band: u32) -> i32 {
    return i32(max(band, SHADOW_BAND_STEPS_LOG2) - SHADOW_BAND_STEPS_LOG2);
}

// The level in which rays of a receiver are compared in a band.
fn shadow_climbed(light: ShadowLight, level: i32, band: u32) -> i32 {
    let higher = level + shadow_coarser(band);
    return select(min(higher, i32(SHADOW_BOUNDED_LEVELS) - 1), higher, shadow_parallel(light));
}

// Where rays are that have gone so far to the side, world units: how high, or the part of the way to a light with a position.
fn shadow_way(light: ShadowLight, side: f32) -> f32 {
    let way = side * light.inverse_radius;
    return select(way / (1.0 + way), way, shadow_parallel(light));
}

// The same by texels of the receiver.
fn shadow_risen(light: ShadowLight, start: ShadowStart, side: f32) -> f32 {
    return shadow_way(light, side * start.moved.texel);
}

// How many bands rays climb, until they are above everything, or at the light.
fn shadow_bands(light: ShadowLight, moved: ShadowMoved) -> u32 {
    var side = light.radius * (1.0 / SHADOW_NEAREST);
    var most = SHADOW_SOFT_BANDS;
    if shadow_parallel(light) {
        let levels = light.first + i32(SHADOW_LEVELS) - 1 - moved.level;
        side = (light.top - moved.at.z) * light.radius;
        most = min(most, u32(levels) + 1u + SHADOW_BAND_STEPS_LOG2);
    }
    let least = 0.5 * side / moved.texel;
    if least > 1.0 {
        return u32(clamp(shadow_exponent(least) + 2, 1, i32(most)));
    }
    return 1u;
}

fn shadow_start(light: ShadowLight, moved: ShadowMoved) -> ShadowStart {
    let cosine = max(moved.cosine, SHADOW_LEAST_COSINE);
    let slope = shadow_sine(cosine);
    let raise = (slope * SHADOW_TEXEL_REACH + light.threshold) / cosine;
    let lean = SHADOW_LEAN * max(slope / cosine, 1.0);
    let height = shadow_in_face(light, moved.face, moved.at).z;
    var right = vec3<f32>(1.0, 0.0, 0.0);
    var up = vec3<f32>(0.0, 1.0, 0.0);
    if !shadow_parallel(light) {
        // Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
        let z = moved.at * (1.0 / sqrt(inner(moved.at, moved.at)));
        let sign = select(-1.0, 1.0, z.z >= 0.0);
        let a = -1.0 / (sign + z.z);
        let b = z.x * z.y * a;
        right = vec3<f32>(1.0 + sign * z.x * z.x * a, sign * b, -sign * z.x);
        up = vec3<f32>(b, sign + z.y * z.y * a, -z.y);
    }
    let bands = shadow_bands(light, moved);
    return ShadowStart(moved, height, raise, bands, lean, right * light.radius, up * light.radius);
}

// By how much rays are raised in a band, for its coarser texels and for rounding.
fn shadow_raised(light: ShadowLight, start: ShadowStart, band: u32) -> f32 {
    let moved = start.moved;
    let texel = moved.texel * shadow_power(shadow_coarser(band));
    var left = 1.0;
    var stored = moved.length + moved.texel;
    if shadow_parallel(light) {
        stored = texel * f32(SHADOW_SIDE) + shadow_risen(light, start, shadow_power(i32(band) + 1));
    } else {
        // Texels are smaller where the light is nearer.
        left = 1.0 - shadow_risen(light, start, shadow_power(i32(band)));
    }
    return start.raise * (texel - moved.texel) * left + (moved.distance + stored) * SHADOW_ROUNDING;
}

// The slab whose pages rays from a height are compared with in a level of a parallel map: the one that they leave it in.
fn shadow_slab(light: ShadowLight, level: i32, height: f32) -> i32 {
    if !shadow_parallel(light) {
        return 0;
    }
    // Products with powers of two, as exact as the quotients.
    let risen = height + times(f32(SHADOW_SOFT_TEXELS) * shadow_power(level), light.inverse_radius);
    let top = min(risen, max(light.top, height)) * shadow_power(-level) + shadow_anchor(light, level).z;
    return i32(floor(top * (1.0 / f32(SHADOW_SIDE))));
}

// Of a key of a page, how high that is: above the camera along the light's axis or, from a light with a position, less the
// depth in the page's face.
fn shadow_height(light: ShadowLight, page: ShadowPage, key: u32) -> f32 {
    if key == 0u {
        return SHADOW_NOTHING;
    }
    if !shadow_parallel(light) {
        return -(light.near / bitcast<f32>(key));
    }
    let anchor = shadow_anchor(light, page.level).z;
    let top = (f32(page.at.z + 1) * f32(SHADOW_SIDE) - anchor) * shadow_power(page.level);
    return top - bitcast<f32>(~key);
}

// What is seen of a map where something is: how high, and in which face.
struct ShadowSample {
    height: f32,
    face: u32,
}

// How high what the light sees is where a point lies, in a level and, of a parallel map, a slab.
fn shadow_sample(light: ShadowLight, at: vec3<f32>, level: i32, slab: i32) -> ShadowSample {
    let place = shadow_place(light, at, level);
    if !place.there {
        return ShadowSample(SHADOW_NOTHING, place.page.face);
    }
    var page = place.page;
    page.at.z = slab;
    let texels = shadow_page(light, page);
    if texels == SHADOW_ABSENT {
        return ShadowSample(SHADOW_NOTHING, page.face);
    }
    return ShadowSample(shadow_height(light, page, shadow_pages[texels + place.texel]), page.face);
}
