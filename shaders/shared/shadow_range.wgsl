// Lights that have a size: what needs no ray. Levels are told in which everything is below all rays of a receiver, or above:
// src/cpu/shadow_soft.rs, where each receiver is told by itself.
// Needs: shadow_soft.wgsl.

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
