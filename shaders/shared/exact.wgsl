// Arithmetic as IEEE 754 rounds it, and so as the CPU does, on every device. Vulkan lets a device fuse products with sums, and
// lets quotients and roots be off by units in the last place (on an H100, 30 % of quotients and 17 % of roots are). All
// arithmetic that decides which pixel shows which triangle goes through these functions.
// Needs: view.

// Whether the device rounds quotients and roots to the nearest by itself.
override ROUNDS_TO_NEAREST: bool = false;

// The number as it was rounded. Compilers may take (a + b) - a for b, or fuse operations, but not through this.
fn rounded(v: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(v) ^ view.zero);
}

fn times(a: f32, b: f32) -> f32 {
    return rounded(a * b);
}

fn times3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(a * b) ^ vec3<u32>(view.zero));
}

fn scaled(v: vec4<f32>, factor: f32) -> vec4<f32> {
    return bitcast<vec4<f32>>(bitcast<vec4<u32>>(v * factor) ^ vec4<u32>(view.zero));
}

// a.x b.x + a.y b.y + a.z b.z, from left to right.
fn inner(a: vec3<f32>, b: vec3<f32>) -> f32 {
    let p = times3(a, b);
    return p.x + p.y + p.z;
}

// The first 12 bits of a number.
fn upper_half(a: f32) -> f32 {
    let c = times(SPLITTER, a);
    return rounded(c - rounded(c - a));
}

// What a product loses when it is rounded to `high`: Dekker's, from halves whose products are exact.
fn lost(a: f32, b: f32, high: f32) -> f32 {
    let ah = upper_half(a);
    let al = rounded(a - ah);
    let bh = upper_half(b);
    let bl = rounded(b - bh);
    let rest = rounded(rounded(times(ah, bh) - high) + times(ah, bl)) + times(al, bh);
    return rounded(rest) + times(al, bl);
}

// a - q b, exactly, where q is within units in the last place of a / b.
fn remainder(a: f32, q: f32, b: f32) -> f32 {
    let product = times(q, b);
    return rounded(rounded(a - product) - rounded(lost(q, b, product)));
}

// The distance from a number to the next larger in size.
fn unit_of(v: f32) -> f32 {
    return times(bitcast<f32>(bitcast<u32>(v) & 0x7f800000u), 1.1920928955078125e-7);
}

// a / b. The remainder of what the device takes for it leads to within a hair more than half a unit, and that of this says
// on which side of half a unit the quotient lies (it never lies on it). Quotients whose remainders are no numbers, or too
// small for one, stay as the device has them.
fn quotient(a: f32, b: f32) -> f32 {
    let near = rounded(a / b);
    if ROUNDS_TO_NEAREST {
        return near;
    }
    let nearer = rounded(near + rounded(remainder(a, near, b) / b));
    let rest = remainder(a, nearer, b);
    let unit = unit_of(nearer);
    let step = abs(times(unit, b));
    if !(step > 0.0 && abs(rest) <= step) {
        return near;
    }
    if 2.0 * abs(rest) > step {
        return nearer + select(-unit, unit, (rest > 0.0) == (b > 0.0));
    }
    return nearer;
}

// The square root of a, by the same way: between it and a neighbour lies a half, whose square is q² ± q u + u²/4, and
// remainders are multiples of u².
fn root(a: f32) -> f32 {
    let near = rounded(sqrt(a));
    if ROUNDS_TO_NEAREST {
        return near;
    }
    let nearer = rounded(near + rounded(remainder(a, near, near) / (2.0 * near)));
    let rest = remainder(a, nearer, nearer);
    let up = unit_of(nearer);
    // Below a power of two numbers lie twice as close.
    let down = select(up, 0.5 * up, (bitcast<u32>(nearer) & 0x7fffffu) == 0u);
    let step = times(up, nearer);
    if !(step > 0.0 && abs(rest) <= 2.0 * step) {
        return near;
    }
    if rest > step {
        return nearer + up;
    }
    return select(nearer, nearer - down, rest <= -times(down, nearer));
}
