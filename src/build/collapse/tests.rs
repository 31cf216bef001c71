//! What holds for every mesh, and what holds for those that a simplifier is judged by.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::*;

/// A mesh of positions and triangles, one vertex for each row, with normals up; points are told by position.
fn mesh(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> LocalMesh {
    let first = |p: &[f32; 3]| positions.iter().position(|q| q == p).unwrap_or(0) as u32;
    LocalMesh {
        ids: (0..positions.len() as u32).collect(),
        positions: positions.to_vec(),
        attributes: positions.iter().flat_map(|_| [0.0, 0.0, 1.0]).collect(),
        position_ids: positions.iter().map(first).collect(),
        locked: vec![false; positions.len()],
        indices: faces.as_flattened().to_vec(),
        ..LocalMesh::default()
    }
}

const WEIGHTS: [f32; 3] = [0.02; 3];

fn run_by(mesh: &LocalMesh, target: usize, policy: Policy) -> (LocalMesh, f32) {
    let limit = Limit::triangles(target);
    let made = collapse(mesh, &mesh.locked, mesh.attributes.clone(), &WEIGHTS, limit, &policy);
    (made.mesh, made.error)
}

/// Keeps the topology.
fn run(mesh: &LocalMesh, target: usize) -> (LocalMesh, f32) {
    run_by(mesh, target, Policy { cuts: false, ..Policy::default() })
}

/// Takes sheets apart, cuts rings, leaves out parts.
fn run_with_cuts(mesh: &LocalMesh, target: usize) -> (LocalMesh, f32) {
    run_by(mesh, target, Policy::default())
}

/// A square of n × n cells without those that `hole` names.
fn grid(n: u32, height: impl Fn(f32, f32) -> f32, hole: impl Fn(u32, u32) -> bool) -> LocalMesh {
    let side = n + 1;
    let at = |i: u32| i as f32 / n as f32;
    let positions: Vec<[f32; 3]> =
        (0..side * side).map(|k| (at(k % side), at(k / side))).map(|(x, y)| [x, y, height(x, y)]).collect();
    let cells = (0..n * n).map(|k| (k % n, k / n)).filter(|(i, j)| !hole(*i, *j));
    let faces: Vec<[u32; 3]> = cells
        .flat_map(|(i, j)| {
            let a = j * side + i;
            [[a, a + 1, a + side], [a + 1, a + side + 1, a + side]]
        })
        .collect();
    mesh(&positions, &faces)
}

/// A closed surface: a cube of n × n cells a side, blown up to a sphere if asked for.
fn cube(n: u32, round: bool) -> LocalMesh {
    let mut positions: Vec<[f32; 3]> = Vec::new();
    let mut faces = Vec::new();
    let mut numbers = BTreeMap::new();
    for side in 0..6 {
        let (axis, end) = (side / 2, side % 2);
        for (i, j) in (0..n * n).map(|k| (k % n, k / n)) {
            let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(di, dj)| {
                let mut p = [0u32; 3];
                p[axis] = end as u32 * n;
                p[(axis + 1) % 3] = i + di;
                p[(axis + 2) % 3] = j + dj;
                *numbers.entry(p).or_insert_with(|| {
                    let q = p.map(|x| 2.0 * x as f32 / n as f32 - 1.0);
                    let size = if round { q.iter().map(|x| x * x).sum::<f32>().sqrt() } else { 1.0 };
                    positions.push(q.map(|x| x / size));
                    positions.len() as u32 - 1
                })
            });
            let [a, b, c, d] = corners;
            faces.extend(if end == 1 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
        }
    }
    mesh(&positions, &faces)
}

/// What is counted of a surface by position.
#[derive(Debug, PartialEq)]
struct Counts {
    euler: i64,
    /// Number of edges with each number of faces but two; zero where there is none.
    borders: bool,
    most_faces: usize,
    duplicates: usize,
}

fn counts(mesh: &LocalMesh) -> Counts {
    let mut names = BTreeMap::new();
    let points: Vec<usize> = mesh
        .positions
        .iter()
        .map(|p| {
            let next = names.len();
            *names.entry(p.map(|x| (x + 0.0).to_bits())).or_insert(next)
        })
        .collect();
    let mut edges: BTreeMap<[usize; 2], usize> = BTreeMap::new();
    let mut vertices = BTreeSet::new();
    let mut faces = BTreeSet::new();
    let mut duplicates = 0;
    for t in mesh.indices.chunks_exact(3) {
        let mut t = [0, 1, 2].map(|k| points[t[k] as usize]);
        t.sort_unstable();
        assert!(t[0] < t[1] && t[1] < t[2], "two corners of a triangle in one place");
        duplicates += usize::from(!faces.insert(t));
        vertices.extend(t);
        for e in [[t[0], t[1]], [t[1], t[2]], [t[0], t[2]]] {
            *edges.entry(e).or_insert(0) += 1;
        }
    }
    Counts {
        euler: vertices.len() as i64 - edges.len() as i64 + (mesh.indices.len() / 3) as i64,
        borders: edges.values().any(|n| *n == 1),
        most_faces: edges.values().copied().max().unwrap_or(0),
        duplicates,
    }
}

fn area(mesh: &LocalMesh) -> f64 {
    let corners = |t: &[u32]| [0, 1, 2].map(|k| mesh.positions[t[k] as usize]);
    mesh.indices
        .chunks_exact(3)
        .map(|t| 0.5 * DVec3::from_array(crate::math::triangle::area_normal(corners(t))).length())
        .sum()
}

#[test]
fn closed_surfaces_stay_closed_down_to_the_last_triangle() {
    for cost in [Cost::Memoryless, Cost::GarlandHeckbert, Cost::LindstromTurk] {
        let sphere = cube(12, true);
        let before = counts(&sphere);
        for target in [800, 100, 0] {
            let policy = Policy { cost, cuts: false, ..Policy::default() };
            let (out, error) = run_by(&sphere, target, policy);
            assert_eq!(counts(&out), before);
            assert!(out.indices.len() / 3 <= target.max(20), "{}", out.indices.len() / 3);
            assert!(error > 0.0 && error < 1.0);
        }
    }
}

#[test]
fn a_cube_keeps_its_corners() {
    let (out, error) = run(&cube(8, false), 12);
    assert_eq!(out.indices.len(), 36);
    assert!((area(&out) - 24.0).abs() < 1e-5 && error < 1e-6);
    let used: BTreeSet<[i32; 3]> =
        out.indices.iter().map(|v| out.positions[*v as usize].map(|x| (x * 1e5).round() as i32)).collect();
    assert_eq!(used.len(), 8);
    assert!(used.iter().flatten().all(|x| x.abs() == 100_000));
}

#[test]
fn flat_grids_keep_their_outline_and_holes() {
    let flat = grid(12, |_, _| 0.0, |i, j| (4..8).contains(&i) && (3..6).contains(&j));
    let (out, error) = run(&flat, 8);
    assert!(out.indices.len() / 3 <= 12, "{}", out.indices.len() / 3);
    assert_eq!(counts(&out).euler, 0);
    assert!((area(&out) - area(&flat)).abs() < 1e-5 && error < 1e-6);
}

#[test]
fn locked_points_stay() {
    let mut hill = grid(16, |x, y| 0.3 * (6.0 * x).sin() * (5.0 * y).cos(), |_, _| false);
    for v in 0..hill.positions.len() {
        hill.locked[v] = v % 17 == 0 || v % 17 == 16 || v % 5 == 0;
    }
    let (out, _) = run(&hill, 0);
    assert!(out.indices.len() < hill.indices.len() / 2);
    let used: BTreeSet<u32> = out.indices.iter().copied().collect();
    for v in (0..hill.positions.len()).filter(|v| hill.locked[*v]) {
        assert!(used.contains(&(v as u32)));
        assert_eq!(out.positions[v], hill.positions[v]);
        assert_eq!(out.attributes[3 * v..3 * v + 3], hill.attributes[3 * v..3 * v + 3]);
    }
}

#[test]
fn seams_stay_where_they_are() {
    // Two halves of a wave with normals of their own, meeting at x = 0.5.
    let wave = grid(16, |_, y| 0.1 * (7.0 * y).sin(), |_, _| false);
    let mut seam = wave.clone();
    let mut twin = BTreeMap::new();
    for t in seam.indices.chunks_exact_mut(3) {
        let right = t.iter().any(|v| wave.positions[*v as usize][0] > 0.5);
        for v in t.iter_mut().filter(|v| right && wave.positions[**v as usize][0] == 0.5) {
            let next = (wave.ids.len() + twin.len()) as u32;
            *v = *twin.entry(*v).or_insert(next);
        }
    }
    let mut twins: Vec<(u32, u32)> = twin.into_iter().map(|(v, w)| (w, v)).collect();
    twins.sort_unstable();
    for (w, v) in twins {
        seam.ids.push(w);
        seam.positions.push(wave.positions[v as usize]);
        seam.position_ids.push(v);
        seam.locked.push(false);
    }
    seam.attributes = vec![0.0; 3 * seam.ids.len()];
    for t in seam.indices.chunks_exact(3) {
        let right = t.iter().any(|v| seam.positions[*v as usize][0] > 0.5);
        t.iter().for_each(|v| seam.attributes[3 * *v as usize + usize::from(right)] = 1.0);
    }
    let (out, _) = run(&seam, 120);
    assert!(out.indices.len() / 3 <= 120);
    assert_eq!(counts(&out).euler, 1);
    let mut on_seam = 0;
    for t in out.indices.chunks_exact(3) {
        let corners = [0, 1, 2].map(|k| out.positions[t[k] as usize]);
        let right = corners.iter().map(|p| p[0]).sum::<f32>() > 1.5;
        for (p, v) in corners.iter().zip(t) {
            on_seam += usize::from((p[0] - 0.5).abs() < 1e-3);
            assert!(
                if right { p[0] > 0.499 } else { p[0] < 0.501 },
                "a triangle across the seam: {corners:?}"
            );
            assert_eq!(out.attributes[3 * *v as usize + usize::from(right)], 1.0);
        }
    }
    assert!(on_seam >= 12);
}

#[test]
fn sheets_that_meet_keep_meeting() {
    // Four sheets at one line, and two fans at one point.
    let n = 6u32;
    let mut positions = Vec::new();
    let mut faces = Vec::new();
    for sheet in 0..4 {
        let (s, c) = (1.3 * sheet as f32).sin_cos();
        for (i, j) in (0..n * n).map(|k| ((k % n) as f32, (k / n) as f32)) {
            let base = positions.len() as u32;
            positions.extend([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(di, dj)| {
                let (r, z) = (i + di, j + dj);
                [r * c + 0.0, r * s + 0.0, z]
            }));
            faces.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        }
    }
    let fan = positions.len() as u32;
    positions.extend([[9.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 1.0, 0.0], [8.0, 0.0, 0.0], [8.0, 1.0, 0.0]]);
    faces.extend([[fan, fan + 1, fan + 2], [fan, fan + 3, fan + 4]]);
    let sheets = mesh(&positions, &faces);
    let before = counts(&sheets);
    assert_eq!(before.most_faces, 4);
    for target in [200, 60, 0] {
        let (out, _) = run(&sheets, target);
        assert_eq!(counts(&out), before, "{target}");
    }
}

/// A ring of n × m cells about a circle.
fn torus(n: u32, m: u32, place: [f32; 3], size: f32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let turn = |k: u32, of: u32| (std::f32::consts::TAU * k as f32 / of as f32).sin_cos();
    let at = |k: u32| {
        let ((s, c), (t, d)) = (turn(k / m, n), turn(k % m, m));
        let r = 1.0 + 0.3 * d;
        [place[0] + size * r * c, place[1] + size * r * s, place[2] + size * 0.3 * t]
    };
    let cell = |k: u32| {
        let (i, j) = (k / m, k % m);
        let id = |i: u32, j: u32| (i % n) * m + j % m;
        let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    ((0..n * m).map(at).collect(), (0..n * m).flat_map(cell).collect())
}

/// Faces of each edge, by vertex: what was cut may lie in one place.
fn faces_of_edges(mesh: &LocalMesh) -> Vec<u32> {
    let mut edges: BTreeMap<[u32; 2], u32> = BTreeMap::new();
    for t in mesh.indices.chunks_exact(3) {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            *edges.entry([a.min(b), a.max(b)]).or_insert(0) += 1;
        }
    }
    edges.into_values().collect()
}

/// The same, by where vertices are.
fn faces_of_edges_by_place(mesh: &LocalMesh) -> Vec<u32> {
    let mut names = BTreeMap::new();
    let mut name = |v: &u32| {
        let next = names.len() as u32;
        *names.entry(mesh.positions[*v as usize].map(|x| (x + 0.0).to_bits())).or_insert(next)
    };
    let indices = mesh.indices.iter().map(&mut name).collect();
    faces_of_edges(&LocalMesh { indices, ..mesh.clone() })
}

#[test]
fn rings_that_were_cut_last_are_joined_again() {
    let (positions, faces) = torus(40, 20, [0.0; 3], 1.0);
    let ring = mesh(&positions, &faces);
    for target in 4..200 {
        let (out, _) = run_with_cuts(&ring, target);
        assert!(faces_of_edges_by_place(&out).iter().all(|faces| *faces == 2), "{target}");
    }
}

#[test]
fn handles_are_cut_where_nothing_else_is_left() {
    let (positions, faces) = torus(40, 20, [0.0; 3], 1.0);
    let ring = mesh(&positions, &faces);
    let (fine, _) = run_with_cuts(&ring, 400);
    assert_eq!(counts(&fine).euler, 0);
    let (out, _) = run_with_cuts(&ring, 4);
    assert_eq!((counts(&run(&ring, 4).0).euler, counts(&out).euler), (0, 2));
    assert!(out.indices.len() / 3 <= 8, "{}", out.indices.len() / 3);
    assert!(faces_of_edges(&out).iter().all(|faces| *faces == 2));
}

/// A tube of so many sides and rings, open at both ends, with normals outwards.
fn tube(sides: u32, rings: u32) -> LocalMesh {
    let angle = |i: u32| i as f32 / sides as f32 * std::f32::consts::TAU;
    let points = (0..sides * rings).map(|k| (angle(k % sides), k / sides));
    let positions: Vec<[f32; 3]> = points.map(|(t, z)| [t.cos(), t.sin(), z as f32]).collect();
    let cells = (0..sides * (rings - 1)).map(|k| (k % sides, k / sides));
    let faces: Vec<[u32; 3]> = cells
        .flat_map(|(i, j)| {
            let [a, b] = [i, (i + 1) % sides].map(|i| j * sides + i);
            [[a, b, b + sides], [a, b + sides, a + sides]]
        })
        .collect();
    let attributes = positions.iter().flat_map(|p| [p[0], p[1], 0.0]).collect();
    LocalMesh { attributes, ..mesh(&positions, &faces) }
}

#[test]
fn openings_close_where_nothing_else_is_left() {
    let source = tube(8, 5);
    let least = run(&source, 1).0.indices.len() / 3;
    assert_eq!(least, 6, "three sides between two openings");
    let (made, error) = run_with_cuts(&source, 4);
    assert!(made.indices.len() / 3 <= 4, "one of them is closed, at least");
    let borders = faces_of_edges(&made).iter().filter(|faces| **faces == 1).count();
    assert!(borders <= 3, "{borders}");
    assert!(error > 0.0);
    // Of a border to others nothing is closed.
    let locked = source.positions.iter().map(|p| p[2] == 0.0).collect();
    let held = LocalMesh { locked, ..source };
    let (made, _) = run_with_cuts(&held, 1);
    let borders = faces_of_edges(&made).iter().filter(|faces| **faces == 1).count();
    assert_eq!(borders, 8);
}

#[test]
fn small_parts_go_before_large_ones_coarsen() {
    let (mut positions, mut faces) = torus(40, 20, [0.0; 3], 1.0);
    for k in 0..10 {
        let base = positions.len() as u32;
        let (more, of) = torus(6, 4, [1.32, 0.004 * k as f32, 0.0], 1.0e-3);
        positions.extend(more);
        faces.extend(of.iter().map(|f| f.map(|v| v + base)));
    }
    let (out, _) = run_with_cuts(&mesh(&positions, &faces), 1000);
    let sizes = |mesh: &LocalMesh| mesh.indices.iter().filter(|v| **v >= 800).count();
    assert!(out.indices.len() / 3 > 900 && sizes(&out) == 0, "{}", sizes(&out));
    // Nothing is left out where nothing else is.
    let alone = mesh(&positions[..800], &faces[..1600]);
    assert!(!run_with_cuts(&alone, 0).0.indices.is_empty());
}

#[test]
fn sheets_that_touch_come_apart_and_stay_closed() {
    // Two cubes that share an edge, and a third that shares a corner.
    let block = cube(6, false);
    let (mut positions, mut faces) = (Vec::new(), Vec::new());
    for [x, y, z] in [[0.0, 0.0, 0.0], [2.0, 2.0, 0.0], [-2.0, -2.0, -2.0]] {
        let base = positions.len() as u32;
        positions.extend(block.positions.iter().map(|p| [p[0] + x, p[1] + y, p[2] + z]));
        faces.extend(block.indices.chunks_exact(3).map(|t| [t[0] + base, t[1] + base, t[2] + base]));
    }
    let blocks = mesh(&positions, &faces);
    assert_eq!(counts(&blocks).most_faces, 4);
    let (out, error) = run_with_cuts(&blocks, 36);
    assert!(out.indices.len() / 3 <= 40 && error < 1e-6, "{} {error}", out.indices.len() / 3);
    assert!(faces_of_edges(&out).iter().all(|faces| *faces == 2));
    assert!((area(&out) - 72.0).abs() < 1e-4);
}

#[test]
fn locked_points_are_not_joined_across() {
    let mut strip = grid(16, |x, y| 0.1 * (5.0 * x).sin() * y, |_, _| false);
    for v in 0..strip.positions.len() {
        strip.locked[v] = v / 17 == 4 || v / 17 == 12;
    }
    let locked = strip.locked.clone();
    let (out, _) = run_with_cuts(&strip, 0);
    let row = |v: u32| v / 17;
    for t in out.indices.chunks_exact(3) {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let both = (a as usize) < locked.len()
                && (b as usize) < locked.len()
                && locked[a as usize]
                && locked[b as usize];
            assert!(!both || row(a) == row(b) && a.abs_diff(b) == 1, "{a} {b}");
        }
    }
}

#[test]
fn what_a_collapse_may_cost_is_a_limit_in_any_unit() {
    let hill = grid(24, |x, y| 0.3 * (6.0 * x).sin() * (5.0 * y).cos(), |_, _| false);
    let full = collapse(
        &hill,
        &hill.locked,
        hill.attributes.clone(),
        &WEIGHTS,
        Limit::triangles(100),
        &Policy::default(),
    );
    assert!(!full.stopped && full.trace.windows(2).all(|w| w[0].0 <= w[1].0 && w[0].1 > w[1].1));
    let (cost, left) = full.trace[full.trace.len() / 2];
    let mut small = hill.clone();
    small.positions.iter_mut().flatten().for_each(|x| *x *= 0.25);
    for (mesh, unit) in [(&hill, 1.0), (&small, 0.25f64.powf(4.5))] {
        let limit = Limit { cost: 1.0001 * cost * unit, ..Limit::triangles(0) };
        let made = collapse(mesh, &mesh.locked, mesh.attributes.clone(), &WEIGHTS, limit, &Policy::default());
        assert!(made.stopped && made.cost <= limit.cost);
        assert!((made.mesh.indices.len() / 3).abs_diff(left as usize) < 20);
    }
}

#[test]
fn scale_does_not_matter() {
    let hill = grid(12, |x, y| 0.3 * (6.0 * x).sin() * (5.0 * y).cos(), |_, _| false);
    let expected = run(&hill, 60);
    for power in [100, -100, 20] {
        let scale = 2f32.powi(power);
        let mut scaled = hill.clone();
        scaled.positions.iter_mut().flatten().for_each(|x| *x *= scale);
        let (out, error) = run(&scaled, 60);
        assert_eq!(out.indices, expected.0.indices);
        assert_eq!(error, expected.1 * scale);
        let same = out.positions.iter().zip(&expected.0.positions).all(|(p, q)| *p == q.map(|x| x * scale));
        assert!(same);
    }
}

#[test]
fn no_point_comes_to_lie_on_another() {
    let places = [[0, 0], [2, -1], [0, -1], [1, 0], [1, -1], [1, -2], [2, 0]];
    let positions = places.map(|p: [i8; 2]| [1.0e-30 * f32::from(p[0]), 1.0e-30 * f32::from(p[1]), 0.0]);
    let mut overlapping = mesh(&positions, &[[0, 6, 4], [2, 3, 5], [6, 2, 5], [5, 6, 1], [1, 2, 0]]);
    overlapping.locked[2] = true;
    let (out, _) = run(&overlapping, 0);
    assert_eq!(counts(&out).euler, counts(&overlapping).euler);
}

#[test]
fn nothing_comes_of_nothing() {
    for faces in [vec![], vec![[0, 1, 2]], vec![[0, 1, 2], [2, 1, 0]], vec![[0, 0, 1]]] {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let (out, error) = run(&mesh(&positions, &faces), 0);
        let proper = faces.iter().filter(|f| f[0] != f[1]).count();
        assert_eq!((out.indices.len() / 3, error), (proper, 0.0));
    }
    let all_alike = mesh(&[[3.0, 3.0, 3.0]; 9], &[[0, 1, 2], [3, 4, 5], [6, 7, 8]]);
    assert_eq!(run(&all_alike, 0).0.indices.len(), 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Any triangles over a few places: soup, sheets that cross, needles, faces without area.
    #[test]
    fn anything_is_taken(
        places in prop::collection::vec(prop::array::uniform3(-2i8..3), 4..30),
        corners in prop::collection::vec(prop::array::uniform3(0usize..30), 1..80),
        locked in prop::collection::vec(prop::bool::weighted(0.2), 30),
        flat in prop::bool::ANY,
        scale in prop::sample::select(vec![1.0e-30f32, 1.0, 1.0e30]),
    ) {
        let positions: Vec<[f32; 3]> = places
            .iter()
            .map(|p| [f32::from(p[0]), f32::from(p[1]), if flat { 0.0 } else { f32::from(p[2]) }].map(|x| x * scale))
            .collect();
        let mut seen = BTreeSet::new();
        let proper = |f: &[u32; 3]| {
            let mut places = f.map(|v| positions[v as usize].map(f32::to_bits));
            places.sort_unstable();
            places[0] != places[1] && places[1] != places[2] && seen.insert(places)
        };
        let named = corners.iter().map(|f| f.map(|v| (v % positions.len()) as u32));
        let faces: Vec<[u32; 3]> = named.filter(proper).collect();
        let mut soup = mesh(&positions, &faces);
        soup.locked = (0..positions.len()).map(|v| locked[soup.position_ids[v] as usize]).collect();
        let before = counts(&soup);
        let (out, error) = run(&soup, 0);
        prop_assert!(error.is_finite() && error >= 0.0);
        prop_assert!(out.positions.iter().flatten().chain(&out.attributes).all(|x| x.is_finite()));
        let after = counts(&out);
        prop_assert_eq!(after.duplicates, 0);
        prop_assert!(after.euler == before.euler && after.most_faces <= before.most_faces.max(2));
        for v in (0..positions.len()).filter(|v| soup.locked[*v] && soup.indices.contains(&(*v as u32))) {
            prop_assert!(out.indices.iter().any(|w| out.positions[*w as usize] == positions[v]));
        }
        prop_assert_eq!(run(&soup, 0).0.indices, out.indices);
        // With cuts the topology may change, but no edge gets more faces and what is locked stays.
        let (out, error) = run_with_cuts(&soup, 0);
        prop_assert!(error.is_finite() && error >= 0.0);
        prop_assert!(out.positions.iter().flatten().chain(&out.attributes).all(|x| x.is_finite()));
        let most = |mesh: &LocalMesh| faces_of_edges(mesh).into_iter().max().unwrap_or(0);
        prop_assert!(most(&out) as usize <= before.most_faces.max(2));
        for v in (0..positions.len()).filter(|v| soup.locked[*v] && soup.indices.contains(&(*v as u32))) {
            prop_assert!(out.indices.iter().any(|w| out.positions[*w as usize] == positions[v]));
        }
        prop_assert_eq!(run_with_cuts(&soup, 0).0.indices, out.indices);
    }
}
