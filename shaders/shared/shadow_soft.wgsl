// How much of a light with a size reaches a receiver: rays to points of the light, marched through the levels of its map:
// src/cpu/shadow_soft.rs and src/shadow/soft.rs, where each receiver is told by itself. What needs no ray is told first:
// levels in which everything is below all rays, or above.
// Needs: shadow_light.wgsl, shadow_pages.wgsl.

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
fn shadow_climbed(light: ShadowLight, from: i32, band: u32) -> i32 {
    let level = from + shadow_coarser(band);
    return select(min(level, i32(SHADOW_BOUNDED_LEVELS) - 1), level, shadow_parallel(light));
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

// The least and the largest height of two keys of a page.
fn shadow_heights_of(light: ShadowLight, page: ShadowPage, word: u32) -> vec2<f32> {
    return vec2<f32>(
        shadow_height(light, page, shadow_pages[word]),
        shadow_height(light, page, shadow_pages[word + 1u]),
    );
}

// The whole of a page, behind its tiles.
const SHADOW_WHOLE: u32 = SHADOW_PAGE_TEXELS + 2u * SHADOW_TILES;

// Whether a rectangle of texels reaches beyond a face of a map that has an end.
fn shadow_beyond(level: i32, rect: vec4<f32>) -> bool {
    let texels = f32(SHADOW_SIDE >> u32(level));
    return rect.x < 0.0 || rect.y < 0.0 || rect.z >= texels || rect.w >= texels;
}

// Between which heights everything is in a rectangle of texels of a level, or more than that, where it is all below what
// rays there are between, or above.
fn shadow_range(light: ShadowLight, start: ShadowStart, level: i32, beneath: vec4<f32>, rays: vec2<f32>) -> vec2<f32> {
    let side = f32(SHADOW_PAGE_SIDE);
    var rect = beneath;
    var found = vec2<f32>(LARGEST, SHADOW_NOTHING);
    if !shadow_parallel(light) && shadow_beyond(level, rect) {
        // Beyond the border of a spot's map is nothing.
        found.x = SHADOW_NOTHING;
        let texels = f32(SHADOW_SIDE >> u32(level));
        if rect.x >= texels || rect.y >= texels || rect.z < 0.0 || rect.w < 0.0 {
            return vec2<f32>(SHADOW_NOTHING);
        }
        rect = clamp(rect, vec4<f32>(0.0), vec4<f32>(texels - 1.0));
    }
    let pages = vec4<i32>(floor(rect * (1.0 / side)));
    var page = ShadowPage(start.moved.face, level, vec3<i32>(0, 0, shadow_slab(light, level, start.height)));
    for (var y = pages.y; y <= pages.w; y++) {
        for (var x = pages.x; x <= pages.z; x++) {
            page.at = vec3<i32>(x, y, page.at.z);
            let texels = shadow_page(light, page);
            if texels == SHADOW_ABSENT {
                return vec2<f32>(SHADOW_NOTHING, LARGEST);
            }
            // Mostly all of a page is below rays, or above.
            let whole = shadow_heights_of(light, page, texels + SHADOW_WHOLE);
            if whole.y > rays.x && whole.x <= rays.y {
                let corner = vec4<f32>(vec2<f32>(page.at.xy), vec2<f32>(page.at.xy)) * side;
                let within = vec4<u32>(clamp(rect - corner, vec4<f32>(0.0), vec4<f32>(side - 1.0)));
                let tiles = within / SHADOW_TILE_SIDE;
                for (var row = tiles.y; row <= tiles.w; row++) {
                    for (var column = tiles.x; column <= tiles.z; column++) {
                        let tile = row * (SHADOW_PAGE_SIDE / SHADOW_TILE_SIDE) + column;
                        let own = shadow_heights_of(light, page, texels + SHADOW_PAGE_TEXELS + 2u * tile);
                        found = vec2<f32>(min(found.x, own.x), max(found.y, own.y));
                    }
                }
            } else {
                found = vec2<f32>(min(found.x, whole.x), max(found.y, whole.y));
            }
        }
    }
    return found;
}

// Between which heights everything is that any face of a cube sees: no higher, in a face, than by its depth there.
fn shadow_farther(light: ShadowLight) -> vec2<f32> {
    var high = SHADOW_NOTHING;
    for (var face = 0u; face < 6u; face++) {
        let page = ShadowPage(face, i32(SHADOW_BOUNDED_LEVELS) - 1, vec3<i32>(0));
        let texels = shadow_page(light, page);
        if texels == SHADOW_ABSENT {
            return vec2<f32>(SHADOW_NOTHING, LARGEST);
        }
        high = max(high, shadow_height(light, page, shadow_pages[texels + SHADOW_WHOLE + 1u]));
    }
    return vec2<f32>(SHADOW_NOTHING, high);
}

// The rectangle of texels of a level in which rays are in a band: left, top, right and bottom.
fn shadow_beneath(light: ShadowLight, start: ShadowStart, band: u32, level: i32) -> vec4<f32> {
    let moved = start.moved;
    // In the coarsest level rays may go farther.
    let reach = shadow_power(i32(band) + 1 + moved.level - level) + 1.0;
    var middle: vec2<f32>;
    if shadow_parallel(light) {
        let anchor = shadow_anchor(light, level);
        let inverse = shadow_power(-level);
        middle = vec2<f32>(moved.at.x * inverse + anchor.x, anchor.y - moved.at.y * inverse);
    } else {
        let half = 0.5 * f32(SHADOW_SIDE >> u32(level));
        let seen = shadow_in_face(light, moved.face, moved.at).xy * (1.0 / (light.tangent * -start.height));
        middle = half + vec2<f32>(half * seen.x, -half * seen.y);
    }
    return vec4<f32>(middle - reach, middle + reach);
}

// The bands, as bits, in which rays of a receiver may hit something.
fn shadow_undecided(light: ShadowLight, start: ShadowStart) -> u32 {
    let moved = start.moved;
    let own = moved.texel * max(start.raise, 0.0);
    var undecided = 0u;
    // Of the band before, the highest that anything is.
    var before = SHADOW_NOTHING;
    for (var band = 0u; band < start.bands; band++) {
        let first = shadow_risen(light, start, shadow_power(i32(band)));
        let last = shadow_risen(light, start, shadow_power(i32(band) + 1));
        let texel = shadow_power(shadow_coarser(band));
        let level = shadow_climbed(light, moved.level, band);
        var rays: vec2<f32>;
        if shadow_parallel(light) {
            let stored = moved.texel * texel * f32(SHADOW_SIDE) + last;
            let raised = own * texel + (moved.distance + stored) * SHADOW_ROUNDING;
            rays = vec2<f32>(start.height + first, start.height + last + raised);
        } else {
            let raised = own * texel + (moved.distance + moved.length + moved.texel) * SHADOW_ROUNDING;
            rays = vec2<f32>(
                start.height * (1.0 - first) - first * light.radius,
                start.height * (1.0 - last) + last * light.radius + raised,
            );
        }
        let rect = shadow_beneath(light, start, band, level);
        var low = rays.x;
        var found: vec2<f32>;
        if light.kind == SHADOW_CUBE && shadow_beyond(level, rect) {
            low = (first - 1.0) * moved.length - first * light.radius;
            found = shadow_farther(light);
        } else {
            found = shadow_range(light, start, level, rect, rays);
        }
        let below = found.y <= low && before <= low;
        // Where rays end, nothing is above them.
        let above = found.x > rays.y && band + 1u < start.bands;
        undecided |= select(1u << band, 0u, below || above);
        before = found.y;
    }
    return undecided;
}

// Where a ray is that has gone so far to the side, the outermost ones, in texels of the receiver.
fn shadow_point(light: ShadowLight, start: ShadowStart, aside: vec3<f32>, side: f32) -> vec3<f32> {
    let risen = shadow_risen(light, start, side);
    if shadow_parallel(light) {
        return start.moved.at + vec3<f32>(aside.xy, 1.0) * risen;
    }
    return aside * risen + start.moved.at * (1.0 - risen);
}

// How high a point of a ray is, as the map has it.
fn shadow_point_height(light: ShadowLight, at: vec3<f32>, face: u32) -> f32 {
    return shadow_in_face(light, face, at).z;
}

// Whether something is in the way of a ray in some bands. `own` is what the map says where it begins.
fn shadow_blocked(light: ShadowLight, start: ShadowStart, aside: vec3<f32>, own: f32, bands: u32) -> bool {
    let moved = start.moved;
    let parallel = shadow_parallel(light);
    // It leaves the triangle backwards.
    let way = select(aside - moved.at, vec3<f32>(aside.xy, 1.0), parallel);
    if !(inner(moved.normal, way) > 0.0) {
        return true;
    }
    // What the map says where the ray was last.
    var before = own;
    for (var band = 0u; band < start.bands; band++) {
        if (bands >> band & 1u) == 0u {
            continue;
        }
        // Bands are as wide as the way to them.
        let width = shadow_power(i32(band));
        let count = min(1u << band, SHADOW_BAND_STEPS);
        let side = width / f32(count);
        if band > 0u && (bands >> (band - 1u) & 1u) == 0u {
            let level = shadow_climbed(light, moved.level, band - 1u);
            let last = width - 0.25 * width / f32(min(1u << (band - 1u), SHADOW_BAND_STEPS));
            let slab = shadow_slab(light, level, moved.at.z);
            before = shadow_sample(light, shadow_point(light, start, aside, last), level, slab).height;
        }
        let raised = shadow_raised(light, start, band);
        // As high as the band before left off, so that nothing is between the two.
        var raised_before = shadow_raised(light, start, max(band, 1u) - 1u);
        let level = shadow_climbed(light, moved.level, band);
        let slab = shadow_slab(light, level, moved.at.z);
        let texel = moved.texel * shadow_power(level - moved.level) * SHADOW_SOFT_STEP;
        var entry = 0.0;
        for (var step = 0u; step < count; step++) {
            let from_side = width + f32(step) * side;
            let to_side = width + f32(step + 1u) * side;
            let middle = shadow_point(light, start, aside, 0.5 * (from_side + to_side));
            let found = shadow_sample(light, middle, level, slab);
            let c = found.height;
            var from_height = entry;
            if !(parallel && step > 0u) {
                let at = shadow_point(light, start, aside, from_side);
                from_height = shadow_point_height(light, at, found.face) + raised_before;
            }
            let at = shadow_point(light, start, aside, to_side);
            var to_height = shadow_point_height(light, at, found.face) + raised;
            // Where rays end, nothing is above them.
            if band + 1u == start.bands && step + 1u == count {
                to_height = LARGEST;
            }
            entry = to_height;
            raised_before = raised;
            let left = select(1.0 - shadow_risen(light, start, to_side), 1.0, parallel);
            let fall = texel * max(left, 0.0);
            let ground = start.height + start.lean * to_side * moved.texel;
            // It was below, and is above. If that is one surface, it is hit. If the ray comes out from under an edge,
            // something else begins there: if that is above the receiver, the ray came through it, below the edge, where the
            // light does not see it.
            let crossed = c > from_height && c <= to_height;
            let passed = before > from_height && c <= from_height && (before - c <= fall || c > ground);
            if crossed || passed {
                return true;
            }
            before = c;
        }
    }
    return false;
}

// Between 0 and 1, evenly over any few neighbouring pixels, and always the same for a place on the picture.
//
// Jimenez, "Next Generation Post Processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014.
fn shadow_noise(point: vec2<f32>) -> f32 {
    let wave = times(0.06711056, point.x) + times(0.00583715, point.y);
    return fract(times(52.982918, fract(wave)));
}

// How much of a light with a size a receiver on a pixel sees.
fn shadow_share(light: ShadowLight, receiver: ShadowReceiver, point: vec2<f32>) -> f32 {
    let moved = shadow_moved(light, receiver);
    if moved.outcome != SHADOW_LOOKS_UP {
        return f32(moved.outcome == SHADOW_LIT);
    }
    let start = shadow_start(light, moved);
    let slab = shadow_slab(light, moved.level, moved.at.z);
    // What the light sees there, which rays leave by no more than a texel.
    let own = shadow_sample(light, moved.at, moved.level, slab).height;
    let next = shadow_risen(light, start, 1.0);
    let parallel = shadow_parallel(light);
    let high = select(start.height * (1.0 - next), start.height + next, parallel);
    if own > start.height + shadow_raised(light, start, 0u) && own <= high {
        return 0.0;
    }
    let bands = shadow_undecided(light, start);
    // All of the light is above the horizon of the triangle.
    let above = select(-inner(moved.normal, moved.at), moved.normal.z, parallel) > light.radius;
    if bands == 0u && above && own <= high {
        return 1.0;
    }
    // Less half a turn, where sines are most exact.
    let turn = (shadow_noise(point) - 0.5) * SHADOW_TAU;
    let sine = -sin(turn);
    let cosine = -cos(turn);
    var dark = 0u;
    for (var number = 0u; number < light.samples; number++) {
        let pair = bitcast<vec4<f32>>(shadow_table[light.points + number / 2u]);
        let on_disk = select(pair.xy, pair.zw, (number & 1u) == 1u);
        let x = cosine * on_disk.x - sine * on_disk.y;
        let y = sine * on_disk.x + cosine * on_disk.y;
        let aside = x * start.right + y * start.up;
        dark += u32(shadow_blocked(light, start, aside, own, bands));
    }
    return 1.0 - f32(dark) / f32(light.samples);
}

// How much of a light reaches a receiver on a pixel: 1 or 0, or, of a light with a size, a part.
fn shadow_reached(number: u32, receiver: ShadowReceiver, point: vec2<f32>) -> f32 {
    let light = shadow_light(number);
    if light.kind == SHADOW_NONE {
        return 1.0;
    }
    if shadow_soft(light) {
        return shadow_share(light, receiver, point);
    }
    return f32(shadow_lit(light, receiver));
}
