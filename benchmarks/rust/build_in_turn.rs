//! Build throughput against meshoptimizer's `clod_build`, in turn: on a machine whose speed drifts, contestants that
//! differ by little can only be compared within each round. `cargo bench --bench build_in_turn`; with words behind
//! `--`, those only that have them in their names, and with a number n on a mesh of 8·n² triangles.

#[path = "../../tests/rust/shapes.rs"]
#[allow(dead_code)]
mod shapes;

use std::time::Instant;

use meshopt::{ClodMesh, VertexDataAdapter, clod_build, clod_default_config, typed_to_bytes};
use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, ErrorMeasure, Quality};
use nanite_rs::mesh::{Positions, SourceMesh};

const ROUNDS: usize = 5;
/// 1.0 M triangles.
const SIZE: usize = 354;

fn main() {
    let (sizes, asked): (Vec<String>, Vec<String>) = std::env::args()
        .skip(1)
        .filter(|word| !word.starts_with('-'))
        .partition(|word| word.parse::<usize>().is_ok());
    let size = sizes.first().and_then(|n| n.parse().ok()).unwrap_or(SIZE);
    let (positions, faces) = shapes::bumpy_sphere(size);
    let adapter = VertexDataAdapter::new(typed_to_bytes(&positions), 12, 0).unwrap();
    let indices: Vec<u32> = faces.iter().flatten().copied().collect();
    // On a sphere about the origin positions will do for normals.
    let plain = ClodMesh::new(&indices, &adapter);
    let shaded = ClodMesh {
        vertex_attributes: positions.as_flattened(),
        vertex_attributes_stride: 12,
        attribute_weights: &[0.5; 3],
        ..ClodMesh::new(&indices, &adapter)
    };
    let ours = |quality, error, threads| {
        let options = BuildOptions { quality, error, threads, ..BuildOptions::default() };
        build(&SourceMesh::new(Positions::F32(&positions), &faces), &options, &Silent).unwrap();
    };
    let theirs = |mesh: &ClodMesh<'_>| {
        clod_build(clod_default_config(128), mesh, |_, _| 0);
    };
    let contestants: [(&str, &dyn Fn()); 7] = [
        ("fast, quadric, 1 thread", &|| ours(Quality::Fast, ErrorMeasure::Quadric, 1)),
        ("fast, quadric, 2 threads", &|| ours(Quality::Fast, ErrorMeasure::Quadric, 2)),
        ("fast, bound, 1 thread", &|| ours(Quality::Fast, ErrorMeasure::Bound, 1)),
        ("fast, bound, 2 threads", &|| ours(Quality::Fast, ErrorMeasure::Bound, 2)),
        ("best, bound, 2 threads", &|| ours(Quality::Best, ErrorMeasure::Bound, 2)),
        ("clod_build, positions only", &|| theirs(&plain)),
        ("clod_build, with normals", &|| theirs(&shaded)),
    ];
    let asked_for = |(name, _): &&(&str, &dyn Fn())| asked.iter().all(|word| name.contains(word));
    let contestants: Vec<_> = contestants.iter().filter(asked_for).collect();
    let mut seconds = vec![Vec::new(); contestants.len()];
    for _ in 0..ROUNDS {
        for ((_, call), seconds) in contestants.iter().zip(&mut seconds) {
            let start = Instant::now();
            call();
            seconds.push(start.elapsed().as_secs_f64());
        }
    }
    println!("{} triangles, {ROUNDS} rounds in turn", faces.len());
    for ((name, _), mut seconds) in contestants.iter().zip(seconds) {
        seconds.sort_by(f64::total_cmp);
        println!("{name:28} least {:.2} s, median {:.2} s", seconds[0], seconds[ROUNDS / 2]);
    }
}
