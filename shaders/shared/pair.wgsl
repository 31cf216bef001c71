// Numbers as sums of two: src/math/pair.rs, operation for operation. Needs exact.wgsl.

struct Pair {
    high: f32,
    low: f32,
}

fn pair_sum(a: f32, b: f32) -> Pair {
    let high = rounded(a + b);
    let rest = rounded(high - a);
    return Pair(high, rounded(a - rounded(high - rest)) + rounded(b - rest));
}

fn pair_product(a: f32, b: f32) -> Pair {
    let high = times(a, b);
    return Pair(high, lost(a, b, high));
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
    return pair_sum(p.high, p.low + times(a.low, factor));
}

fn pair_over(a: Pair, b: Pair) -> f32 {
    let first = quotient(a.high, b.high);
    let rest = pair_minus(a, pair_times(b, first));
    return first + quotient(rest.high, b.high);
}
