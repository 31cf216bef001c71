// Signed 64-bit integers as (high, low), for devices with and without their own.

struct Wide {
    high: i32,
    low: u32,
}

fn wide(v: i32) -> Wide {
    return Wide(v >> 31u, bitcast<u32>(v));
}

fn wide_add(a: Wide, b: Wide) -> Wide {
    let low = a.low + b.low;
    return Wide(a.high + b.high + select(0, 1, low < a.low), low);
}

fn wide_negate(a: Wide) -> Wide {
    return wide_add(Wide(~a.high, ~a.low), Wide(0, 1u));
}

fn wide_product(a: i32, b: i32) -> Wide {
    let x = bitcast<u32>(a);
    let y = bitcast<u32>(b);
    let xl = x & 0xffffu;
    let xh = x >> 16u;
    let yl = y & 0xffffu;
    let yh = y >> 16u;
    let low = xl * yl;
    let middle = xh * yl + (low >> 16u);
    let rest = xl * yh + (middle & 0xffffu);
    let high = xh * yh + (middle >> 16u) + (rest >> 16u);
    // Of the unsigned product: two's complement numbers are 2^32 too large where negative.
    let excess = select(0u, y, a < 0) + select(0u, x, b < 0);
    return Wide(bitcast<i32>(high - excess), (rest << 16u) | (low & 0xffffu));
}

// Of the edge from a to b: positive for points on its right, and twice the area of the triangle with them.
fn edge_function(a: vec2<i32>, b: vec2<i32>, p: vec2<i32>) -> Wide {
    let d = b - a;
    let to = p - a;
    return wide_add(wide_product(d.x, to.y), wide_negate(wide_product(to.x, d.y)));
}

// Near the number.
fn wide_estimate(a: Wide) -> f32 {
    return f32(a.high) * 4294967296.0 + f32(a.low);
}

// The nearest f32 to a number that is not negative and below 2^62.
fn wide_nearest(a: Wide) -> f32 {
    if a.high == 0 {
        return f32(a.low);
    }
    // Its first 32 bits, the last of which stands for those behind it too: more bits than rounding looks at.
    let shift = firstLeadingBit(bitcast<u32>(a.high)) + 1u;
    let rest = a.low & ((1u << shift) - 1u);
    let first = (bitcast<u32>(a.high) << (32u - shift)) | (a.low >> shift) | select(0u, 1u, rest != 0u);
    return f32(first) * f32(1u << shift);
}
