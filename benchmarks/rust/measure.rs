//! Distances: building a tree and asking it, and the bound of a simplified patch, per triangle of both surfaces.

#[path = "../../tests/rust/shapes.rs"]
#[allow(dead_code)]
mod shapes;

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use meshopt::{SimplifyOptions, VertexDataAdapter, simplify, typed_to_bytes};
use nanite_rs::measure::closest::Triangle;
use nanite_rs::measure::{BoundOptions, Bvh, Surface, hausdorff_upper};

/// Runs `work` so many times: the processor time of this thread where the system tells, which others at work on the
/// machine disturb less, or else the time that passed.
fn processor_time<T>(times: u64, mut work: impl FnMut() -> T) -> Duration {
    let spent = || {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        Some(Duration::from_nanos(text.split(' ').next()?.parse().ok()?))
    };
    let (start, before) = (Instant::now(), spent());
    (0..times).for_each(|_| {
        black_box(work());
    });
    match (before, spent()) {
        (Some(before), Some(after)) => after - before,
        _ => start.elapsed(),
    }
}

/// A patch of a bumpy sphere of about so many triangles, as a group of clusters is: a ball around a point.
fn patch(triangles: usize) -> (Vec<[f32; 3]>, Vec<u32>) {
    let (positions, mut faces) = shapes::bumpy_sphere(354);
    let far = |f: &[u32; 3]| {
        let center = [0, 1, 2].map(|k| f.iter().map(|v| positions[*v as usize][k]).sum::<f32>() / 3.0);
        let d: [f32; 3] = std::array::from_fn(|k| center[k] - [0.6, 0.6, 0.5][k]);
        d.iter().map(|x| x * x).sum::<f32>()
    };
    faces.sort_by_cached_key(|f| far(f).to_bits()); // not negative: ordered like their bits
    faces.truncate(triangles);
    faces.sort_unstable();
    (positions, faces.into_flattened())
}

/// meshoptimizer's result and its estimate of the distance.
fn simplified(positions: &[[f32; 3]], indices: &[u32], keep: f32) -> (Vec<u32>, f32) {
    let adapter = VertexDataAdapter::new(typed_to_bytes(positions), 12, 0).unwrap();
    let target = (indices.len() as f32 * keep) as usize / 3 * 3;
    let options = SimplifyOptions::LockBorder | SimplifyOptions::ErrorAbsolute;
    let mut error = 0.0;
    let result = simplify(indices, &adapter, target, f32::MAX, options, Some(&mut error));
    (result, error)
}

fn bounds(c: &mut Criterion) {
    for (triangles, keep) in [(2_000, 0.5), (4_000, 0.25), (8_000, 0.125)] {
        let (positions, fine) = patch(triangles);
        let (coarse, estimate) = simplified(&positions, &fine, keep);
        let a = Surface { positions: &positions, indices: &coarse };
        let b = Surface { positions: &positions, indices: &fine };
        let both = (coarse.len() + fine.len()) / 3;
        let mut group = c.benchmark_group(format!("bound/{}+{triangles}", coarse.len() / 3));
        group.sample_size(20).throughput(Throughput::Elements(both as u64));
        for (name, slack, floor) in
            [("slack 25 %", 0.25, 0.0), ("slack 25 %, floored", 0.25, estimate), ("slack 10 %", 0.1, 0.0)]
        {
            let options = BoundOptions { slack, floor: f64::from(floor), ..BoundOptions::default() };
            let bound = hausdorff_upper(a, b, &[], &options);
            println!(
                "{name}: {:.3e} ≤ {:.3e}, complete: {}, estimate {estimate:.3e}",
                bound.lower, bound.upper, bound.complete
            );
            group.bench_function(name, |bench| {
                bench.iter_custom(|times| processor_time(times, || hausdorff_upper(a, b, &[], &options)))
            });
        }
        group.finish();
    }
}

fn tree(c: &mut Criterion) {
    let (positions, faces) = shapes::bumpy_sphere(112);
    let triangles: Vec<Triangle> =
        faces.iter().map(|f| f.map(|v| positions[v as usize].map(f64::from))).collect();
    let mut group = c.benchmark_group(format!("tree/{}", faces.len()));
    group.sample_size(20).throughput(Throughput::Elements(faces.len() as u64));
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    group.bench_function("build", |b| {
        b.iter_custom(|times| one.install(|| processor_time(times, || Bvh::new(&triangles))))
    });
    let tree = Bvh::new(&triangles);
    let points: Vec<[f64; 3]> = triangles.iter().map(|t| t[0].map(|x| x * 1.01)).collect();
    group.bench_function("nearest, 1 % off the surface, no hint", |b| {
        b.iter_custom(|times| {
            processor_time(times, || {
                points
                    .iter()
                    .map(|p| tree.nearest(*p, f64::INFINITY, 0.0, usize::MAX).unwrap().distance)
                    .sum::<f64>()
            })
        });
    });
    group.finish();
}

criterion_group!(benches, bounds, tree);
criterion_main!(benches);
