// Double-single numbers, each the unevaluated sum of two f32: src/math/double_single.rs, operation for operation.
// Needs: exact.wgsl.

struct DoubleSingle {
    high: f32,
    low: f32,
}

fn pair_sum(a: f32, b: f32) -> DoubleSingle {
    let high = rounded(a + b);
    let rest = rounded(high - a);
    return DoubleSingle(high, rounded(a - rounded(high - rest)) + rounded(b - rest));
}

fn pair_product(a: f32, b: f32) -> DoubleSingle {
    let high = times(a, b);
    return DoubleSingle(high, lost(a, b, high));
}

fn pair_plus(a: DoubleSingle, b: DoubleSingle) -> DoubleSingle {
    let s = pair_sum(a.high, b.high);
    return pair_sum(s.high, s.low + (a.low + b.low));
}

fn pair_minus(a: DoubleSingle, b: DoubleSingle) -> DoubleSingle {
    return pair_plus(a, DoubleSingle(-b.high, -b.low));
}

fn pair_times(a: DoubleSingle, factor: f32) -> DoubleSingle {
    let p = pair_product(a.high, factor);
    return pair_sum(p.high, p.low + times(a.low, factor));
}

fn pair_over(a: DoubleSingle, b: DoubleSingle) -> f32 {
    let first = quotient(a.high, b.high);
    let rest = pair_minus(a, pair_times(b, first));
    return first + quotient(rest.high, b.high);
}
