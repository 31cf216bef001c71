// Pages of shadow maps that the pixels of a view may look up: src/cpu/shadow_mark.rs and src/shadow/receiver.rs.
// One invocation handles one pixel.
// Reads the visibility buffer, cluster records and how the view sees lights. Writes, for each light, a table of columns of
// pages and between which heights receivers are in each, by open addressing.
// Needs: exact.wgsl, target.wgsl, unproject.wgsl, receiver_error.wgsl, hash.wgsl, shadow_view.wgsl.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;
@group(0) @binding(2) var<storage, read> page_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> pages: array<u32>;
@group(0) @binding(4) var<storage, read> pages_1: array<u32>;
@group(0) @binding(5) var<storage, read> pages_2: array<u32>;
@group(0) @binding(6) var<storage, read> pages_3: array<u32>;
@group(0) @binding(7) var<storage, read> visible: array<VisibleCluster>;
@group(0) @binding(8) var<storage, read> words: array<u32>;
// How many columns found no room, then the tables.
@group(0) @binding(9) var<storage, read_write> columns: array<atomic<u32>>;

// Words before the tables, and of an entry: the column, one more than its bits; the complement of the least height, and the
// largest, in the order of numbers.
const COLUMN_HEAD: u32 = 4u;
const COLUMN_WORDS: u32 = 3u;
// Entries that are looked at before a table counts as full.
const COLUMN_TRIES: u32 = 64u;

// A number whose order is that of the numbers.
fn in_order(v: f32) -> u32 {
    let bits = bitcast<u32>(v);
    return bits ^ select(0x80000000u, NONE, bits >> 31u != 0u);
}

// A column as one number; NONE where it does not fit.
fn column_bits(light: ShadowLight, page: ShadowPage) -> u32 {
    let half = 1 << (SHADOW_COLUMN_BITS - 1u);
    if shadow_parallel(light) {
        let at = page.at.xy + half;
        if any(at < vec2<i32>()) || any(at >= vec2<i32>(2 * half - 1)) {
            return NONE;
        }
        return (u32(page.level - light.first) << SHADOW_COLUMN_BITS | u32(at.y)) << SHADOW_COLUMN_BITS | u32(at.x);
    }
    let level = page.face * SHADOW_BOUNDED_LEVELS + u32(page.level);
    return (level << SHADOW_COLUMN_BITS | u32(page.at.y)) << SHADOW_COLUMN_BITS | u32(page.at.x);
}

// Takes note of a column of a light, of which receivers are between two heights.
fn note(number: u32, column: u32, low: f32, high: f32) {
    let lights = shadow_table[0].x;
    let room = (arrayLength(&columns) - COLUMN_HEAD) / (COLUMN_WORDS * lights);
    if column != NONE {
        var at = hash(column, number, 0u) & (room - 1u);
        var tries = 0u;
        loop {
            if tries == COLUMN_TRIES {
                break;
            }
            let entry = COLUMN_HEAD + (number * room + at) * COLUMN_WORDS;
            var found = atomicLoad(&columns[entry]);
            if found == 0u {
                let exchange = atomicCompareExchangeWeak(&columns[entry], 0u, column + 1u);
                found = select(exchange.old_value, column + 1u, exchange.exchanged);
            }
            if found == column + 1u {
                let least = ~in_order(low);
                if atomicLoad(&columns[entry + 1u]) < least {
                    atomicMax(&columns[entry + 1u], least);
                }
                let most = in_order(high);
                if atomicLoad(&columns[entry + 2u]) < most {
                    atomicMax(&columns[entry + 2u], most);
                }
                return;
            }
            // An exchange may fail for no reason: then this entry is looked at again.
            at = (at + select(0u, 1u, found != 0u)) & (room - 1u);
            tries++;
        }
    }
    atomicAdd(&columns[0], 1u);
}

// The columns that a receiver may look up, `LightView::mark`.
fn mark(number: u32, position: vec3<f32>, error: f32) {
    let light = shadow_light(number);
    if light.kind == SHADOW_NONE {
        return;
    }
    let seen = shadow_pixel(light, position);
    let at = shadow_along_axes(light, position);
    let level = shadow_level(light, at, seen.y);
    if !level.there {
        return;
    }
    let soft = shadow_soft(light);
    let own = error + shadow_rounding(seen.x, seen.y);
    let reach = SHADOW_MARGIN * (own + level.texel * (light.threshold + SHADOW_TEXEL_REACH));
    let wide = reach + select(0.0, f32(SHADOW_SOFT_TEXELS) * level.texel, soft);
    let low = at.z - reach;
    let high = at.z + select(reach, reach / SHADOW_LEAST_COSINE, soft);
    // No page lies between two points of a grid that are less than a page apart.
    let side = f32(SHADOW_PAGE_SIDE) * level.texel;
    let count = i32(ceil(min(2.0 * wide / side, SHADOW_MOST_ACROSS))) + 1;
    let deep = select(count, 0, shadow_parallel(light));
    var last = NONE;
    for (var z = 0; z <= deep; z++) {
        for (var y = 0; y <= count; y++) {
            for (var x = 0; x <= count; x++) {
                let step = 2.0 * vec3<f32>(vec3<i32>(x, y, z)) / f32(count) - 1.0;
                let place = shadow_place(light, at + wide * step, level.level);
                if place.there {
                    let column = column_bits(light, place.page);
                    // Neighbours mostly are one.
                    if column == NONE || column != last {
                        note(number, column, low, high);
                        last = column;
                    }
                }
            }
        }
    }
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixel = workgroup_number(workgroup) * WIDTH + lane;
    if pixel >= view.width * view.height {
        return;
    }
    let low = words[2u * pixel];
    let number = (~low >> TRIANGLE_BITS) - 1u;
    // A number beyond the list is none of this frame's.
    if low == 0u || number >= arrayLength(&visible) {
        return;
    }
    let instance = visible[number].instance;
    let cluster = visible[number].cluster;
    let error = receiver_error(instance, record_start(page_start(instance, cluster), cluster));
    let position = unprojected(vec2<f32>(pixel_of(pixel)) + 0.5, distance_of(words[2u * pixel + 1u]));
    for (var light = 0u; light < shadow_table[0].x; light++) {
        mark(light, position, error);
    }
}
