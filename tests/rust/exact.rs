//! `shaders/shared/exact.wgsl` on the device: products, quotients and roots are the CPU's, bit for bit.

use nanite_rs::gpu::Context;
use nanite_rs::math::double_single::SPLITTER;

use crate::gpu_parity::device;
use crate::own_kernel::{self, shared};

/// What is made of a pair of numbers: a b + c with c the rounded product turned round, a ÷ b, √|a|.
const MADE: usize = 3;

const SOURCE: &str = concat!(
    "struct View { zero: u32 }
    @group(0) @binding(0) var<storage, read> view: View;
    @group(0) @binding(1) var<storage, read> pairs: array<vec2<f32>>;
    @group(0) @binding(2) var<storage, read_write> made: array<f32>;
    ",
    shared!("exact"),
    "
    @compute @workgroup_size(64)
    fn main(@builtin(global_invocation_id) at: vec3<u32>, @builtin(num_workgroups) all: vec3<u32>) {
        let number = at.y * all.x * 64u + at.x;
        if number >= arrayLength(&pairs) {
            return;
        }
        let pair = pairs[number];
        made[3u * number] = times(pair.x, pair.y) - bitcast<f32>(bitcast<u32>(pair.x * pair.y) & 0xfffff000u);
        made[3u * number + 1u] = quotient(pair.x, pair.y);
        made[3u * number + 2u] = root(abs(pair.x));
    }"
);

/// What the device makes of pairs.
fn run(context: &Context, pairs: &[[f32; 2]], constants: &[(&str, f64)]) -> Vec<[f32; MADE]> {
    let source = format!("const SPLITTER: f32 = {SPLITTER:?}f;\n{SOURCE}");
    let inputs = [&[0; 4][..], bytemuck::cast_slice(pairs)];
    own_kernel::run(context, source, constants, &inputs, pairs.len(), pairs.len())
}

fn expected([a, b]: [f32; 2]) -> [f32; MADE] {
    let product = a * b;
    [product - f32::from_bits(product.to_bits() & 0xffff_f000), a / b, a.abs().sqrt()]
}

fn check(context: &Context, pairs: &[[f32; 2]]) {
    // As the product takes it; in software the other way, too.
    let itself = [("ROUNDS_TO_NEAREST", 1.0)];
    let ways: &[&[(&str, f64)]] = if context.software() { &[&[], &itself] } else { &[&[]] };
    for way in ways {
        // In parts that a device takes as one array.
        for part in pairs.chunks(1 << 20) {
            for (pair, ours) in part.iter().zip(run(context, part, way)) {
                let theirs = expected(*pair);
                // What is no number is none of either; devices may take other bits for it.
                let same = |(a, b): (&f32, &f32)| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan();
                assert!(ours.iter().zip(&theirs).all(same), "{pair:?}: {ours:?} {theirs:?}");
            }
        }
    }
}

#[test]
fn products_quotients_and_roots_are_those_of_the_cpu() {
    let Some(context) = device("products_quotients_and_roots_are_those_of_the_cpu") else { return };
    // Every eleventh mantissa, where quotients and roots come nearest to halves of units; all of them in `make soak`.
    let step = if std::env::var_os("NANITE_SOAK").is_some() { 1 } else { 11 };
    let one = 1.0f32.to_bits();
    let reciprocals: Vec<_> =
        (one..one + (1 << 23)).step_by(step).map(|b| [1.0, f32::from_bits(b)]).collect();
    check(&context, &reciprocals);
    // Two octaves: one of odd and one of even exponents.
    let roots: Vec<_> = (one..one + (2 << 23)).step_by(step).map(|a| [f32::from_bits(a), 3.0]).collect();
    check(&context, &roots);
    let mut seed = 1u64;
    let mut next = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as u32
    };
    // Of all signs and mantissas, 2^-20 to 2^20; every fourth mantissa with few bits, as whole numbers have them.
    let mut number = || {
        let bits = next();
        let mantissa = if bits & 3 == 0 { next() & 0x007f_f000 } else { next() & 0x007f_ffff };
        f32::from_bits((bits & 0x8000_0000) | ((107 + (bits >> 2) % 41) << 23) | mantissa)
    };
    let any: Vec<_> = (0..1 << 20).map(|_| [number(), number()]).collect();
    check(&context, &any);
    // What has no remainder.
    let edges =
        [[0.0, 3.0], [-0.0, 3.0], [4.0, 2.0], [f32::INFINITY, 2.0], [1.0, f32::INFINITY], [1.0, -4.0]];
    check(&context, &edges);
}
