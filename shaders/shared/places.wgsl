// Addresses of cluster records among the words of the pages of all meshes.
// Needs: page_offsets, instances.

// Pages lie in several arrays where one is too short for them; no page does. The array of a word, and its place there.
fn page_array(at: u32) -> u32 {
    return at >> PAGE_ARRAY_BITS;
}

fn place_in_array(at: u32) -> u32 {
    return at & ((1u << PAGE_ARRAY_BITS) - 1u);
}

fn page_start(instance: u32, cluster: u32) -> u32 {
    return page_offsets[instances[instance].first_page + (cluster >> PAGE_SLOT_BITS)];
}

fn record_start(page: u32, cluster: u32) -> u32 {
    return page + (cluster & ((1u << PAGE_SLOT_BITS) - 1u)) * RECORD_WORDS;
}

// Of bits by material, that of a material: src/scene/material.rs.
fn material_bit(bits: u32, material: u32) -> bool {
    return (bits >> min(material, 31u) & 1u) != 0u;
}
