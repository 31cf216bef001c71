//! Trees against brute force, and bounds against dense samples.

use meshopt::{SimplifyOptions, VertexDataAdapter, simplify, typed_to_bytes};
use nanite_rs::measure::closest::{Triangle, Vec3, squared_distance};
use nanite_rs::measure::{BoundOptions, Bvh, Surface, SurfaceBound, hausdorff_upper};
use proptest::prelude::*;

use crate::shapes;

/// A mesh's surface and its simplification to a part.
fn simplified(positions: &[[f32; 3]], indices: &[u32], keep: f32) -> Vec<u32> {
    let adapter = VertexDataAdapter::new(typed_to_bytes(positions), 12, 0).unwrap();
    let target = (indices.len() as f32 * keep) as usize / 3 * 3;
    simplify(indices, &adapter, target, f32::MAX, SimplifyOptions::None, None)
}

fn triangles(surface: Surface<'_>) -> Vec<Triangle> {
    let corner = |v: &u32| surface.positions[*v as usize].map(f64::from);
    surface.indices.chunks_exact(3).map(|t| [corner(&t[0]), corner(&t[1]), corner(&t[2])]).collect()
}

/// Points of a triangle on a grid, its corners included.
fn grid(t: Triangle, steps: usize) -> impl Iterator<Item = Vec3> {
    (0..=steps).flat_map(move |i| (0..=steps - i).map(move |j| (i, j))).map(move |(i, j)| {
        let (u, v) = (i as f64 / steps as f64, j as f64 / steps as f64);
        std::array::from_fn(|k| t[0][k] + u * (t[1][k] - t[0][k]) + v * (t[2][k] - t[0][k]))
    })
}

/// What `hausdorff_upper` bounds, at points of a grid on every triangle, from every triangle.
fn sampled(a: Surface<'_>, b: Surface<'_>, radii: &[f32], steps: usize) -> f64 {
    let radius = |i: usize| radii.get(i).copied().map_or(0.0, f64::from);
    let (a, b) = (triangles(a), triangles(b));
    let to_b = |p: Vec3| {
        let each = b.iter().enumerate().map(|(i, t)| squared_distance(p, *t).sqrt() + radius(i));
        each.fold(f64::INFINITY, f64::min)
    };
    let to_a = |p: Vec3| a.iter().map(|t| squared_distance(p, *t)).fold(f64::INFINITY, f64::min).sqrt();
    let from_a = a.iter().flat_map(|t| grid(*t, steps)).map(to_b).fold(0.0, f64::max);
    let from_b = b.iter().enumerate().flat_map(|(i, t)| grid(*t, steps).map(move |p| (i, p)));
    from_b.map(|(i, p)| to_a(p) + radius(i)).fold(from_a, f64::max)
}

fn holds(
    a: Surface<'_>,
    b: Surface<'_>,
    radii: &[f32],
    options: &BoundOptions,
    steps: usize,
) -> SurfaceBound {
    let bound = hausdorff_upper(a, b, radii, options);
    let seen = sampled(a, b, radii, steps);
    assert!(seen <= bound.upper, "{seen} > {bound:?}");
    let enough = options.floor.max(bound.lower * (1.0 + options.slack));
    assert!(!bound.complete || bound.upper <= enough * (1.0 + 1e-9) + 1e-11, "{bound:?} {enough}");
    bound
}

#[test]
fn simplified_surfaces_are_bounded() {
    for (n, keep) in [(6, 0.5), (8, 0.25), (8, 0.1)] {
        let (positions, faces) = shapes::bumpy_sphere(n);
        let fine = faces.as_flattened();
        let coarse = simplified(&positions, fine, keep);
        let a = Surface { positions: &positions, indices: &coarse };
        let b = Surface { positions: &positions, indices: fine };
        for slack in [0.25, 0.01] {
            let options = BoundOptions { slack, budget: 100_000, ..BoundOptions::default() };
            let bound = holds(a, b, &[], &options, 10);
            assert!(bound.complete);
            // The lower bound is a distance that occurs: a fine enough grid comes near it.
            let seen = sampled(a, b, &[], 24);
            assert!(bound.lower <= seen * 1.1, "{bound:?} {seen}");
            let radii: Vec<f32> = (0..faces.len()).map(|i| (i * 37 % 101) as f32 * 1e-4).collect();
            assert!(holds(a, b, &radii, &options, 10).complete);
            let floor = BoundOptions { floor: 0.2, ..options };
            assert!(holds(a, b, &[], &floor, 10).complete);
        }
    }
}

#[test]
fn the_same_surface_is_at_no_distance() {
    let (positions, faces) = shapes::torus(12, 9);
    let s = Surface { positions: &positions, indices: faces.as_flattened() };
    let bound = hausdorff_upper(s, s, &[], &BoundOptions { floor: 1e-9, ..BoundOptions::default() });
    assert!(bound.complete && bound.lower < 1e-12 && bound.upper < 1.1e-9, "{bound:?}");
    // A radius of one triangle is what the other direction cannot do without.
    let mut radii = vec![0.0; faces.len()];
    radii[7] = 0.5;
    let bound = hausdorff_upper(s, s, &radii, &BoundOptions::default());
    assert!(bound.lower >= 0.5 && bound.upper <= 0.5 * 1.25 + 1e-9, "{bound:?}");
}

#[test]
fn empty_surfaces_are_infinitely_far() {
    let (positions, faces) = shapes::grid(2, |_, _| 0.0);
    let full = Surface { positions: &positions, indices: faces.as_flattened() };
    let empty = Surface { positions: &positions, indices: &[] };
    let options = BoundOptions::default();
    assert_eq!(hausdorff_upper(full, empty, &[], &options).upper, f64::INFINITY);
    assert_eq!(hausdorff_upper(empty, full, &[], &options).upper, f64::INFINITY);
    assert_eq!(hausdorff_upper(empty, empty, &[], &options).upper, 0.0);
    assert!(Bvh::new(&[]).nearest([0.0; 3], f64::INFINITY, 0.0, 0).is_none());
}

#[test]
fn trees_do_not_depend_on_threads() {
    let (positions, faces) = shapes::bumpy_sphere(80);
    let all: Vec<Triangle> = faces.iter().map(|f| f.map(|v| positions[v as usize].map(f64::from))).collect();
    let made = [1, 2, 5].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        format!("{:?}", pool.install(|| Bvh::new(&all)))
    });
    assert!(made[0] == made[1] && made[1] == made[2]);
}

#[test]
fn many_equal_triangles_end() {
    let t = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let tree = Bvh::new(&vec![t; 50_000]);
    assert_eq!(tree.nearest([0.25, 0.25, 2.0], f64::INFINITY, 0.0, 0).unwrap().distance, 2.0);
    assert_eq!(tree.distance_below([0.25, 0.25, 2.0]), 2.0);
}

fn triangle() -> impl Strategy<Value = [[f32; 3]; 3]> {
    let corner = prop::array::uniform3(-1.0f32..1.0);
    (prop::array::uniform3(corner), 0..5, 0.001f32..1.0).prop_map(|(mut t, kind, size)| {
        let first = t[0];
        t[1..].iter_mut().for_each(|p| *p = std::array::from_fn(|k| first[k] + (p[k] - first[k]) * size));
        match kind {
            0 => t[2] = t[1],
            1 => t = [t[0]; 3],
            2 => t[2] = std::array::from_fn(|k| 0.3 * t[0][k] + 0.7 * t[1][k]),
            _ => {}
        }
        t
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn soups_are_bounded(
        a in prop::collection::vec(triangle(), 1..12),
        b in prop::collection::vec((triangle(), 0.0f32..0.5), 1..12),
        slack in 0.02..0.3f64,
    ) {
        let (b, radii): (Vec<_>, Vec<f32>) = b.into_iter().unzip();
        let indices = |n: usize| (0..3 * n as u32).collect::<Vec<_>>();
        let (of_a, of_b) = (indices(a.len()), indices(b.len()));
        let a = Surface { positions: a.as_flattened(), indices: &of_a };
        let b = Surface { positions: b.as_flattened(), indices: &of_b };
        let options = BoundOptions { slack, ..BoundOptions::default() };
        holds(a, b, &[], &options, 16);
        holds(a, b, &radii, &options, 16);
    }

    #[test]
    fn trees_find_what_brute_force_finds(
        soup in prop::collection::vec(triangle(), 1..60),
        points in prop::collection::vec(prop::array::uniform3(-3.0..3.0f64), 1..20),
        far in prop::sample::select(vec![1.0, 1e3, 1e8, 1e40]),
    ) {
        let all: Vec<Triangle> = soup.iter().map(|t| t.map(|p| p.map(f64::from))).collect();
        let tree = Bvh::new(&all);
        for p in points {
            let p = p.map(|x| x * far);
            let found = tree.nearest(p, f64::INFINITY, 0.0, usize::MAX).unwrap();
            let expected = all.iter().map(|t| squared_distance(p, *t)).fold(f64::INFINITY, f64::min).sqrt();
            prop_assert!((found.distance - expected).abs() <= 1e-12 * expected);
            prop_assert!(tree.nearest(p, found.distance * 0.999, 0.0, usize::MAX).is_none());
            prop_assert!(tree.distance_below(p) <= found.distance * (1.0 + 1e-12));
            let hinted = tree.nearest(p, f64::INFINITY, 0.0, found.place).unwrap();
            prop_assert_eq!(hinted.distance, found.distance);
        }
    }
}
