// Cluster records and their streams: src/model/cluster.rs. Needs `pages`, `page_offsets` and `instances`.

fn page_start(instance: u32, cluster: u32) -> u32 {
    return page_offsets[instances[instance].first_page + (cluster >> PAGE_SLOT_BITS)];
}

fn record_start(page: u32, cluster: u32) -> u32 {
    return page + (cluster & ((1u << PAGE_SLOT_BITS) - 1u)) * RECORD_WORDS;
}

fn real(at: u32) -> f32 {
    return bitcast<f32>(pages[at]);
}

fn reals(at: u32) -> vec3<f32> {
    return vec3<f32>(real(at), real(at + 1u), real(at + 2u));
}

fn vertex_count(record: u32) -> u32 {
    return pages[record + RECORD_COUNTS] & 0xffu;
}

fn triangle_count(record: u32) -> u32 {
    return pages[record + RECORD_COUNTS] >> 8u & 0xffu;
}

fn byte(start: u32, at: u32) -> u32 {
    return pages[start + (at >> 2u)] >> (8u * (at & 3u)) & 0xffu;
}

// The corners of a triangle, whose bytes start at word `start`.
fn triangle_corners(start: u32, triangle: u32) -> vec3<u32> {
    let at = 3u * triangle;
    return vec3<u32>(byte(start, at), byte(start, at + 1u), byte(start, at + 2u));
}
