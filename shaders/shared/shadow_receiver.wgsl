// From a point that a camera sees to the texel that says whether a light sees it: src/shadow/receiver.rs, operation for
// operation.
// Needs: shadow_view.wgsl, shadow_pages.wgsl.

// A point that a camera sees: camera space, world units.
struct ShadowReceiver {
    position: vec3<f32>,
    // Unit normal of its triangle, towards the eye, and the one that is interpolated, on the same side where both agree.
    normal: vec3<f32>,
    interpolated: vec3<f32>,
    // By how much it may be off the source.
    error: f32,
}

// What is known of a receiver before the map is looked up.
const SHADOW_DARK: u32 = 0u;
const SHADOW_LIT: u32 = 1u;
const SHADOW_LOOKS_UP: u32 = 2u;

// A receiver that was moved, along the light's axes: `Moved`.
struct ShadowMoved {
    outcome: u32,
    at: vec3<f32>,
    normal: vec3<f32>,
    cosine: f32,
    face: u32,
    level: i32,
    // World units.
    texel: f32,
    // From the camera, and from the light's place.
    distance: f32,
    length: f32,
}

// The sine of an angle of a cosine.
fn shadow_sine(cosine: f32) -> f32 {
    return root(max(1.0 - times(cosine, cosine), 0.0));
}

// Moves a receiver along its normal, so that the surface that it is on does not shade it.
fn shadow_moved(light: ShadowLight, receiver: ShadowReceiver) -> ShadowMoved {
    let seen = shadow_pixel(light, receiver.position);
    let distance = seen.x;
    let at = shadow_along_axes(light, receiver.position);
    let length = root(inner(at, at));
    var moved = ShadowMoved(SHADOW_DARK, at, at, 0.0, 0u, 0, 0.0, distance, length);
    let parallel = shadow_parallel(light);
    var towards = vec3<f32>(0.0, 0.0, 1.0);
    // Of a light with a size the least part is enough.
    var size = light.radius;
    if !parallel {
        towards = vec3<f32>(quotient(-at.x, length), quotient(-at.y, length), quotient(-at.z, length));
        size = quotient(light.radius, length);
    }
    moved.normal = shadow_turned(light, receiver.normal);
    // A cut's triangle may be turned where the source is not: where the two normals disagree, the map decides.
    let facing = inner(moved.normal, towards);
    let faces = facing > 0.0;
    var way = moved.normal;
    if !faces {
        way = shadow_turned(light, receiver.interpolated);
        if !(inner(way, towards) > -size || facing > -size) {
            return moved;
        }
    }
    let level = shadow_level(light, at, seen.y);
    if !level.there {
        moved.outcome = SHADOW_LIT;
        return moved;
    }
    moved.outcome = SHADOW_LOOKS_UP;
    moved.face = shadow_face(light, at);
    moved.level = level.level;
    moved.texel = level.texel;
    var slope = 1.0;
    if faces {
        slope = shadow_sine(shadow_in_face(light, moved.face, way).z);
        moved.cosine = facing;
    }
    let own = receiver.error + shadow_rounding(distance, seen.y);
    var by = own + times(times(slope, SHADOW_TEXEL_REACH) + light.threshold, level.texel);
    // To the middle of a light with a size, so that its shadows stay where they are: as far as along the normal.
    if shadow_soft(light) && moved.cosine >= SHADOW_LEAST_COSINE {
        by = quotient(by, moved.cosine);
        way = towards;
    }
    moved.at = at + times3(vec3<f32>(by), way);
    return moved;
}

// The key of a moved receiver at a place: what is nearer to the light shades it.
fn shadow_key(light: ShadowLight, moved: ShadowMoved, depth: f32) -> u32 {
    let rounding = moved.distance * SHADOW_ROUNDING;
    if shadow_parallel(light) {
        // Depths of up to so many texels were rounded in the page.
        let own = depth - (rounding + moved.texel * (f32(SHADOW_SIDE) * SHADOW_ROUNDING));
        return ~bitcast<u32>(select(0.0, own, own > 0.0));
    }
    let own = depth - (rounding + (moved.length + moved.texel) * SHADOW_ROUNDING);
    return bitcast<u32>(quotient(light.near, own));
}

// Whether a receiver is lit by a light without a size.
fn shadow_lit(light: ShadowLight, receiver: ShadowReceiver) -> bool {
    let moved = shadow_moved(light, receiver);
    if moved.outcome != SHADOW_LOOKS_UP {
        return moved.outcome == SHADOW_LIT;
    }
    // Of a cube it may be on another face now.
    let place = shadow_place(light, moved.at, moved.level);
    if !place.there {
        return true;
    }
    let page = shadow_page(light, place.page);
    if page == SHADOW_ABSENT {
        return true;
    }
    return shadow_pages[page + place.texel] <= shadow_key(light, moved, place.depth);
}
