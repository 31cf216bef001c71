//! Levels that go on over seams, with images that somebody bakes for them.

use std::collections::BTreeMap;

use nanite_rs::Error;
use nanite_rs::build::rebake::{Atlas, Rebaking, Surface, grow};
use nanite_rs::build::{Silent, build, check};
use nanite_rs::config::BuildOptions;
use nanite_rs::format::to_bytes;
use nanite_rs::lod::{attribute_error_with, extract, select};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::rule::Threshold;
use nanite_rs::model::{Dag, UNINTERRUPTED};

use crate::shapes::{Mesh, bumpy_sphere, unindexed};

const BAKED: i32 = 7;

/// A capture whose every triangle is a chart of its own.
fn capture() -> (Mesh, Vec<[f32; 2]>) {
    let mesh = unindexed(&bumpy_sphere(24));
    let at = |v: usize| (v.wrapping_mul(2_654_435_761) >> 8) as f32 / (1u64 << 56) as f32;
    let uvs = (0..mesh.0.len()).map(|v| [at(v), at(v + 1_000_003)]).collect();
    (mesh, uvs)
}

fn source<'a>(mesh: &'a Mesh, uvs: &'a [[f32; 2]]) -> SourceMesh<'a> {
    let mut source = SourceMesh::new(Positions::F32(&mesh.0), &mesh.1);
    source.uvs = vec![uvs];
    source
}

fn rebaking() -> Rebaking {
    Rebaking { classes: [(0, BAKED)].into_iter().collect(), numbers: BAKED..BAKED + 1 }
}

/// Every triangle by itself again, with a texel of this size.
fn atlas(surface: &Surface, texel: f64) -> Atlas {
    let corners = surface.faces.len() as u32 * 3;
    Atlas {
        origins: surface.faces.iter().flatten().copied().collect(),
        uvs: (0..corners).map(|v| [v as f32 / corners as f32, f32::from(surface.level)]).collect(),
        faces: (0..surface.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
        material: surface.material,
        texel,
    }
}

fn rebaked(threads: usize, texel: f64) -> (Vec<Surface>, Dag) {
    let (mesh, uvs) = capture();
    let options = BuildOptions { threads, ..BuildOptions::default() };
    let grown = grow(&source(&mesh, &uvs), &options, rebaking(), &Silent).unwrap();
    let surfaces = grown.surfaces();
    let atlases: Vec<Atlas> = surfaces.iter().map(|surface| atlas(surface, texel)).collect();
    (surfaces, grown.finish(&atlases).unwrap())
}

fn coarsest(dag: &Dag) -> usize {
    let clusters = select(dag, &Threshold::Uniform(f32::MAX));
    clusters.iter().map(|at| usize::from(dag.record(*at).triangle_count)).sum()
}

#[test]
fn seams_stop_levels_no_more() {
    let (mesh, uvs) = capture();
    let plain = build(&source(&mesh, &uvs), &BuildOptions::default(), &Silent).unwrap();
    let (surfaces, dag) = rebaked(0, 0.0);
    check(&dag, UNINTERRUPTED).unwrap();
    assert!(coarsest(&dag) <= 128 && coarsest(&dag) <= coarsest(&plain), "{}", coarsest(&dag));
    for surface in &surfaces {
        // Closed, without handles: seams are gone.
        assert_eq!(surface.positions.len(), surface.faces.len() / 2 + 2);
        assert_eq!((surface.errors.len(), surface.material), (surface.faces.len(), BAKED));
    }
    assert!(surfaces.is_sorted_by(|a, b| a.level < b.level && a.faces.len() > b.faces.len()));
    assert!(surfaces[0].faces.len() * 4 < mesh.1.len());
}

#[test]
fn cuts_have_the_coordinates_that_were_baked_and_no_crack() {
    let (_, dag) = rebaked(0, 0.0);
    let mut seen = [false; 2];
    for step in 0..12 {
        let clusters = select(&dag, &Threshold::Uniform(1.0e-4 * f32::powi(2.0, step)));
        let arrays = extract(&dag, &clusters);
        let mut edges: BTreeMap<[[u32; 3]; 2], i32> = BTreeMap::new();
        for face in &arrays.faces {
            let at = face.map(|v| arrays.positions[v as usize].map(|x| (x + 0.0).to_bits()));
            for k in 0..3 {
                let (a, b) = (at[k], at[(k + 1) % 3]);
                *edges.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1 } else { -1 };
            }
        }
        assert!(edges.values().all(|sum| *sum == 0), "a crack at step {step}");
        let ends = arrays.first_face.windows(2);
        for (at, faces) in clusters.iter().zip(ends) {
            let record = dag.record(*at);
            seen[usize::from(record.material == BAKED)] = true;
            for face in &arrays.faces[faces[0] as usize..faces[1] as usize] {
                let v = face.map(|v| arrays.uvs[0][v as usize][1]);
                let own = v.map(|v| v == f32::from(record.level));
                assert_eq!(own, [record.material == BAKED && record.level > 0; 3], "{v:?}");
            }
        }
    }
    assert_eq!(seen, [true; 2]);
}

#[test]
fn texels_are_part_of_errors() {
    let texel = 0.05;
    let (_, fine) = rebaked(0, 0.0);
    let (surfaces, dag) = rebaked(0, texel);
    check(&dag, UNINTERRUPTED).unwrap();
    let clusters = select(&dag, &Threshold::Uniform((texel / dag.frame.scale) as f32 * 0.99));
    assert!(clusters.iter().all(|at| dag.record(*at).material != BAKED));
    let coarse = select(&dag, &Threshold::Uniform(f32::MAX));
    assert!(attribute_error_with(&dag, &coarse, 0.0) >= texel);
    assert!(attribute_error_with(&fine, &select(&fine, &Threshold::Uniform(f32::MAX)), 0.0) < texel);
    let stated: Vec<_> =
        dag.report.rebaked.iter().map(|part| (part.level, part.triangles, part.texel)).collect();
    let given: Vec<_> = surfaces.iter().map(|s| (s.level, s.faces.len() as u64, texel)).collect();
    assert_eq!(stated, given);
}

#[test]
fn nothing_depends_on_threads() {
    let bytes = |threads| to_bytes(&rebaked(threads, 0.01).1).unwrap();
    assert!(bytes(1) == bytes(3));
}

#[test]
fn what_has_no_seams_is_built_as_ever() {
    let mesh = bumpy_sphere(16);
    let uvs: Vec<[f32; 2]> = mesh.0.iter().map(|p| [p[0], p[1]]).collect();
    let options = BuildOptions::default();
    let grown = grow(&source(&mesh, &uvs), &options, rebaking(), &Silent).unwrap();
    assert!(grown.surfaces().is_empty());
    let plain = build(&source(&mesh, &uvs), &options, &Silent).unwrap();
    let bytes = |dag: &Dag| to_bytes(dag).unwrap();
    assert!(bytes(&grown.finish(&[]).unwrap()) == bytes(&plain));
}

#[test]
fn atlases_that_do_not_fit_are_errors() {
    let (mesh, uvs) = capture();
    let options = BuildOptions::default();
    let attempt = |spoil: fn(&mut Vec<Atlas>)| {
        let grown = grow(&source(&mesh, &uvs), &options, rebaking(), &Silent).unwrap();
        let mut atlases: Vec<Atlas> = grown.surfaces().iter().map(|surface| atlas(surface, 0.0)).collect();
        spoil(&mut atlases);
        matches!(grown.finish(&atlases), Err(Error::Argument { argument: "atlases", .. }))
    };
    assert!(attempt(|all| all.truncate(1)));
    assert!(attempt(|all| all[0].faces.truncate(5)));
    assert!(attempt(|all| all[0].faces[3][1] = u32::MAX));
    assert!(attempt(|all| all[0].origins[0] += 1));
    assert!(attempt(|all| all[1].uvs[0][0] = f32::NAN));
    assert!(attempt(|all| all[1].uvs.truncate(1)));
    assert!(attempt(|all| all[1].texel = f64::INFINITY));
    assert!(!attempt(|_| ()));
}
