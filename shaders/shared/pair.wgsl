// Numbers as sums of two: src/math/pair.rs, operation for operation.

struct Pair {
    high: f32,
    low: f32,
}

// The number as it was rounded. Compilers may take (a + b) - a for b, or fuse operations, but not through this.
fn rounded(v: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(v) ^ view.zero);
}

fn pair_sum(a: f32, b: f32) -> Pair {
    let high = rounded(a + b);
    let rest = rounded(high - a);
    return Pair(high, rounded(a - rounded(high - rest)) + rounded(b - rest));
}

fn upper_half(a: f32) -> f32 {
    let c = rounded(4097.0 * a);
    return rounded(c - rounded(c - a));
}

fn pair_product(a: f32, b: f32) -> Pair {
    let high = rounded(a * b);
    let ah = upper_half(a);
    let al = a - ah;
    let bh = upper_half(b);
    let bl = b - bh;
    let rest = rounded(rounded(rounded(ah * bh) - high) + rounded(ah * bl)) + rounded(al * bh);
    return Pair(high, rounded(rest) + rounded(al * bl));
}

fn pair_plus(a: Pair, b: Pair) -> Pair {
    let s = pair_sum(a.high, b.high);
    return pair_sum(s.high, s.low + (a.low + b.low));
}

fn pair_minus(a: Pair, b: Pair) -> Pair {
    return pair_plus(a, Pair(-b.high, -b.low));
}

fn pair_times(a: Pair, factor: f32) -> Pair {
    let p = pair_product(a.high, factor);
    return pair_sum(p.high, p.low + a.low * factor);
}

fn pair_over(a: Pair, b: Pair) -> f32 {
    let quotient = a.high / b.high;
    let rest = pair_minus(a, pair_times(b, quotient));
    return quotient + rest.high / b.high;
}
