// Cluster records and their streams: src/model/cluster.rs. Needs `pages`, `pages_1` to `pages_3`, `page_offsets` and
// `instances`.

// A word of the pages of all meshes. They lie in several arrays where one is too short for them; no page does.
fn page_word(at: u32) -> u32 {
    if PAGE_ARRAYS == 1u {
        return pages[at];
    }
    let word = at & ((1u << PAGE_ARRAY_BITS) - 1u);
    switch at >> PAGE_ARRAY_BITS {
        case 0u: { return pages[word]; }
        case 1u: { return pages_1[word]; }
        case 2u: { return pages_2[word]; }
        default: { return pages_3[word]; }
    }
}

fn page_start(instance: u32, cluster: u32) -> u32 {
    return page_offsets[instances[instance].first_page + (cluster >> PAGE_SLOT_BITS)];
}

fn record_start(page: u32, cluster: u32) -> u32 {
    return page + (cluster & ((1u << PAGE_SLOT_BITS) - 1u)) * RECORD_WORDS;
}

fn real(at: u32) -> f32 {
    return bitcast<f32>(page_word(at));
}

fn reals(at: u32) -> vec3<f32> {
    return vec3<f32>(real(at), real(at + 1u), real(at + 2u));
}

fn vertex_count(record: u32) -> u32 {
    return page_word(record + RECORD_COUNTS) & 0xffu;
}

fn triangle_count(record: u32) -> u32 {
    return page_word(record + RECORD_COUNTS) >> 8u & 0xffu;
}

fn byte(start: u32, at: u32) -> u32 {
    return page_word(start + (at >> 2u)) >> (8u * (at & 3u)) & 0xffu;
}

// The corners of a triangle, whose bytes start at word `start`.
fn triangle_corners(start: u32, triangle: u32) -> vec3<u32> {
    let at = 3u * triangle;
    return vec3<u32>(byte(start, at), byte(start, at + 1u), byte(start, at + 2u));
}
