// Cluster records and their streams, one word at a time: src/model/cluster.rs.
// Needs: places.wgsl, pages, pages_1, pages_2, pages_3.

// A word of the pages of all meshes.
fn page_word(at: u32) -> u32 {
    if PAGE_ARRAYS == 1u {
        return pages[at];
    }
    let word = place_in_array(at);
    switch page_array(at) {
        case 0u: { return pages[word]; }
        case 1u: { return pages_1[word]; }
        case 2u: { return pages_2[word]; }
        default: { return pages_3[word]; }
    }
}

fn real(at: u32) -> f32 {
    return bitcast<f32>(page_word(at));
}

fn reals(at: u32) -> vec3<f32> {
    return vec3<f32>(real(at), real(at + 1u), real(at + 2u));
}

// Numbers of vertices and triangles.
fn counts_of(record: u32) -> vec2<u32> {
    let counts = page_word(record + RECORD_COUNTS);
    return vec2<u32>(counts & 0xffu, counts >> 8u & 0xffu);
}

fn triangle_count(record: u32) -> u32 {
    return counts_of(record).y;
}

// Whether a cluster shows its back faces.
fn two_sided(instance: u32, record: u32) -> bool {
    return material_bit(instances[instance].double_sided, page_word(record + RECORD_MATERIAL));
}

// Where a cluster's streams begin, and how positions are packed: src/model/packing.rs.
struct Streams {
    positions: u32,
    triangles: u32,
    normals: u32,
    colors: u32,
    // Bits of a corner of a triangle.
    corner: u32,
    // Of x, y and z: the least number, and bits of what is added to it.
    anchor: vec3<u32>,
    widths: vec3<u32>,
    // Internal units per whole number; 0 where numbers are bits of f32 in the order of their values.
    step: f32,
}

fn packed_words(count: u32, bits: u32) -> u32 {
    return (count * bits + 31u) >> 5u;
}

fn streams_of(page: u32, record: u32) -> Streams {
    return streams_for(page, record, counts_of(record));
}

fn streams_for(page: u32, record: u32, counts: vec2<u32>) -> Streams {
    let data = page + page_word(record + RECORD_DATA);
    let vertices = counts.x;
    let bits = page_word(data + PACKING_WIDTHS);
    let widths = vec3<u32>(bits & 0xffu, bits >> 8u & 0xffu, bits >> 16u & 0xffu);
    let positions = data + PACKING_WORDS;
    let ids = positions + packed_words(vertices, widths.x + widths.y + widths.z);
    let triangles = ids + packed_words(vertices, bits >> 24u);
    let corner = select(WIDE_CORNER_BITS, CORNER_BITS, vertices <= 1u << CORNER_BITS);
    let normals = triangles + packed_words(counts.y, 3u * corner);
    let anchor = vec3<u32>(page_word(data), page_word(data + 1u), page_word(data + 2u));
    let step = real(data + PACKING_STEP);
    return Streams(positions, triangles, normals, normals + vertices, corner, anchor, widths, step);
}

// Up to 32 bits from a bit of a stream on.
fn packed_bits(start: u32, bit: u32, width: u32) -> u32 {
    let at = start + (bit >> 5u);
    let low = bit & 31u;
    var bits = page_word(at) >> low;
    if low + width > 32u {
        bits |= page_word(at + 1u) << (32u - low);
    }
    return extractBits(bits, 0u, width);
}

// The position of a vertex, internal units.
fn position_of(streams: Streams, vertex: u32) -> vec3<f32> {
    let w = streams.widths;
    let width = w.x + w.y + w.z;
    let bit = vertex * width;
    var code: vec3<u32>;
    if width <= 32u {
        let bits = packed_bits(streams.positions, bit, width);
        code = vec3<u32>(
            extractBits(bits, 0u, w.x),
            extractBits(bits, w.x, w.y),
            extractBits(bits, w.x + w.y, w.z),
        );
    } else {
        code = vec3<u32>(
            packed_bits(streams.positions, bit, w.x),
            packed_bits(streams.positions, bit + w.x, w.y),
            packed_bits(streams.positions, bit + w.x + w.y, w.z),
        );
    }
    let number = vec3<i32>(streams.anchor + code);
    if streams.step > 0.0 {
        return vec3<f32>(number) * streams.step;
    }
    return bitcast<vec3<f32>>(number ^ ((number >> vec3<u32>(31u)) & vec3<i32>(0x7fffffff)));
}

// The corners of a triangle.
fn triangle_corners(streams: Streams, triangle: u32) -> vec3<u32> {
    let w = streams.corner;
    let bits = packed_bits(streams.triangles, 3u * w * triangle, 3u * w);
    return vec3<u32>(extractBits(bits, 0u, w), extractBits(bits, w, w), extractBits(bits, 2u * w, w));
}
