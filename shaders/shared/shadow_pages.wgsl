// Pages of shadow maps on the device: a table from what a page is called to where it lies, and what it holds:
// src/gpu/shadow_table.rs and src/shadow/page.rs.
// Needs: hash.wgsl, shadow_view.wgsl, SHADOW_BINDING.

// Pages, one in each slot: see SHADOW_SLOT_WORDS.
@group(0) @binding(SHADOW_BINDING + 1u) var<storage, read> shadow_pages: array<u32>;

// No slot.
const SHADOW_ABSENT: u32 = 0xffffffffu;

// The page that was found last: its table, its name, and its slot. The next one is mostly the same.
var<private> shadow_last: vec4<u32> = vec4<u32>(0xffffffffu);
var<private> shadow_last_tag: u32;
var<private> shadow_last_slot: u32;

// Face and level as one number.
fn shadow_tag(page: ShadowPage) -> u32 {
    return page.face | (u32(page.level + (1 << (SHADOW_LEVEL_BITS - 1u))) << SHADOW_FACE_BITS);
}

// Where the search for a page begins in every table.
fn shadow_hash(at: vec3<u32>, tag: u32) -> u32 {
    return hash(at.x, at.y, (at.z << 16u) ^ tag);
}

// The first word of a page of a light whose table starts there, in the pool; SHADOW_ABSENT where it is not there.
fn shadow_page(light: ShadowLight, page: ShadowPage) -> u32 {
    let at = bitcast<vec3<u32>>(page.at);
    let tag = shadow_tag(page);
    let name = vec4<u32>(at, light.table);
    if all(name == shadow_last) && tag == shadow_last_tag {
        return shadow_last_slot;
    }
    var slot = SHADOW_ABSENT;
    var number = shadow_hash(at, tag) & light.mask;
    // A table is never full.
    for (var tries = 0u; tries <= light.mask; tries++) {
        let entry = shadow_table[light.table + number];
        if entry.w == 0u {
            break;
        }
        if all(entry.xyz == at) && extractBits(entry.w, 0u, SHADOW_TAG_BITS) == tag {
            slot = ((entry.w >> SHADOW_TAG_BITS) - 1u) * SHADOW_SLOT_WORDS;
            break;
        }
        number = (number + 1u) & light.mask;
    }
    shadow_last = name;
    shadow_last_tag = tag;
    shadow_last_slot = slot;
    return slot;
}
