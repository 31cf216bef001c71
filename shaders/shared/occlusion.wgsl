// Occlusion culling by the depth pyramid: src/cpu/hzb.rs.
// The first pass tests against the pyramid of an earlier frame, where instances were then. Where that frame shows nothing of
// them, it takes what is far away as occluded. It defers what is occluded to the second pass, which tests against the
// pyramid of what the first pass drew. So no picture depends on the earlier frame.
// Needs: cull.wgsl, view, instances, pyramid.

// True when the texels of a level say that everything drawn so far is nearer than the box on every pixel that it may
// touch.
fn hides_at(level: u32, place: Footprint) -> bool {
    let texels = place.rect >> vec4<u32>(level);
    // Four texels of a row are read at a time.
    let first = texels.x / 4u;
    let last = texels.z / 4u;
    let stride = view.pyramid[level].w / 4u;
    let count = (last - first + 1u) * (texels.w - texels.y + 1u);
    var row = view.pyramid[level].z / 4u + texels.y * stride;
    var quad = first;
    // One loop over rows and quads: lanes wait for the box with most of them, not for most rows times most columns.
    for (var n = 0u; n < count; n++) {
        let columns = vec4<u32>(4u * quad) + vec4<u32>(0u, 1u, 2u, 3u);
        let beside = (columns < vec4<u32>(texels.x)) | (columns > vec4<u32>(texels.z));
        if !all((vec4<u32>(place.near_key) < pyramid[row + quad]) | beside) {
            return false;
        }
        quad++;
        if quad > last {
            quad = first;
            row += stride;
        }
    }
    return true;
}

// True when everything drawn so far is nearer than the box on every pixel that it may touch.
fn hides(place: Footprint) -> bool {
    if !place.seen || place.near_key == NO_KEY {
        return false;
    }
    // The first that has keys.
    let least = u32(view.pyramid[0].w == 0u);
    var level = least;
    while level + 1u < view.levels {
        let block = (place.rect.zw >> vec2<u32>(level)) - (place.rect.xy >> vec2<u32>(level));
        if max(block.x, block.y) < PYRAMID_REACH {
            break;
        }
        level++;
    }
    // What is seen is mostly seen in the middle: a look there saves most boxes all others.
    let finer = max(level, PYRAMID_FINER + least) - PYRAMID_FINER;
    let middle = ((place.rect.xy + place.rect.zw) / 2u) >> vec2<u32>(finer);
    let at = view.pyramid[finer].z + middle.y * view.pyramid[finer].w + middle.x;
    if place.near_key >= pyramid[at / 4u][at % 4u] {
        return false;
    }
    return hides_at(level, place) || (level > least && hides_at(finer, place));
}

// Whether a box touches a page of a shadow map that is to be drawn: `pyramid` has for each corner of their grid how many of
// them lie above it and to its left.
fn touches_page(place: Footprint) -> bool {
    let rect = place.rect / vec4<u32>(SHADOW_PAGE_SIDE);
    let above = rect.y * SHADOW_CORNERS;
    let below = (rect.w + 1u) * SHADOW_CORNERS;
    return pages_to(below + rect.z + 1u) + pages_to(above + rect.x) > pages_to(below + rect.x) + pages_to(above + rect.z + 1u);
}

fn pages_to(corner: u32) -> u32 {
    return pyramid[corner / 4u][corner % 4u];
}

// Whether a box, which now lies at `place`, is hidden as far as this pass knows.
fn hidden(place: Footprint, instance: u32, center: vec3<f32>, extent: vec3<f32>) -> bool {
    if SECOND {
        return hides(place);
    }
    if view.history == HISTORY_PAGES {
        return !touches_page(place);
    }
    if view.history != 0u {
        let before = footprint(instances[instance].before, center, extent);
        if before.seen {
            return hides(before);
        }
    }
    return place.near_key < view.occluders;
}
