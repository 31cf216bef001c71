//! Build throughput against meshoptimizer's `clod_build`, on one mesh in one run.

#[path = "../../tests/rust/shapes.rs"]
#[allow(dead_code)]
mod shapes;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use meshopt::{ClodMesh, VertexDataAdapter, clod_build, clod_default_config, typed_to_bytes};
use nanite_rs::build::{Silent, build};
use nanite_rs::config::BuildOptions;
use nanite_rs::mesh::{Positions, SourceMesh};

/// 8·n² triangles; 354 gives 1.0 M.
const SIZES: [usize; 2] = [112, 354];

fn bench(c: &mut Criterion) {
    for n in SIZES {
        let (positions, faces) = shapes::bumpy_sphere(n);
        let mut group = c.benchmark_group(format!("build/{}", faces.len()));
        group.sample_size(10).throughput(Throughput::Elements(faces.len() as u64));
        for threads in [1, 2] {
            let options = BuildOptions { threads, ..BuildOptions::default() };
            group.bench_function(format!("nanite_rs/{threads}"), |b| {
                b.iter(|| {
                    build(&SourceMesh::new(Positions::F32(&positions), &faces), &options, &Silent).unwrap()
                });
            });
        }
        let adapter = VertexDataAdapter::new(typed_to_bytes(&positions), 12, 0).unwrap();
        let indices: Vec<u32> = faces.iter().flatten().copied().collect();
        group.bench_function("clod_build/positions", |b| {
            b.iter(|| clod_build(clod_default_config(128), &ClodMesh::new(&indices, &adapter), |_, _| 0));
        });
        // With what nanite_rs carries by default: normals in the metric, not protected.
        let normals: Vec<[f32; 3]> = positions.clone();
        let attributes: &[f32] = normals.as_flattened();
        group.bench_function("clod_build/normals", |b| {
            b.iter(|| {
                let mesh = ClodMesh {
                    vertex_attributes: attributes,
                    vertex_attributes_stride: 12,
                    attribute_weights: &[0.5; 3],
                    ..ClodMesh::new(&indices, &adapter)
                };
                clod_build(clod_default_config(128), &mesh, |_, _| 0);
            });
        });
        group.finish();
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
