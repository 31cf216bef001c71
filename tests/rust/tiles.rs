//! Tiles: those of a level are one cut, and meet with the same vertices.

use nanite_rs::format::{open_input, to_bytes};
use nanite_rs::lod::{extract as cut_arrays, select};
use nanite_rs::math::Aabb;
use nanite_rs::model::rule::Threshold;
use nanite_rs::model::{Dag, UNINTERRUPTED};
use nanite_rs::tile::{Layout, Piece, Plan, extract, plan};

use rustc_hash::FxHashMap;

use crate::damage::rich_mesh;
use crate::render_frames::dag;
use crate::shapes::bumpy_sphere;

type P = [u32; 3];

fn bits(p: [f32; 3]) -> P {
    p.map(|x| (x + 0.0).to_bits())
}

/// The tiles that stand on a level.
fn front(plan: &Plan, level: u32) -> Vec<usize> {
    let replaced = |number: usize| {
        plan.tiles.iter().any(|tile| tile.parent == Some(number as u32) && tile.level <= level)
    };
    (0..plan.tiles.len()).filter(|n| plan.tiles[*n].level <= level && !replaced(*n)).collect()
}

/// How often each directed edge is there, by positions; triangles that are only a line there have none.
fn edges<'a>(pieces: impl Iterator<Item = &'a Piece>) -> FxHashMap<[P; 2], i32> {
    let mut out = FxHashMap::default();
    for piece in pieces {
        for face in &piece.arrays.faces {
            let at = face.map(|v| bits(piece.arrays.positions[v as usize]));
            for k in 0..3 {
                let edge = [at[k], at[(k + 1) % 3]];
                if edge[0] != edge[1] {
                    *out.entry(edge).or_insert(0) += 1;
                }
            }
        }
    }
    out
}

fn area(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> f64 {
    let of = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| positions[v as usize].map(f64::from));
        let (u, v): ([f64; 3], [f64; 3]) =
            (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
        let across = |k: usize| u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3];
        (0..3).map(|k| across(k).powi(2)).sum::<f64>().sqrt() / 2.0
    };
    faces.iter().map(of).sum()
}

/// All tiles hold what they say, and those of each level are the cut of its error.
fn verify(dag: &Dag, plan: &Plan, closed: bool) {
    let pieces: Vec<Piece> =
        (0..plan.tiles.len()).map(|n| extract(dag, plan, n, &|| true).unwrap()).collect();
    for (piece, tile) in pieces.iter().zip(&plan.tiles) {
        let inside = |p: &[f32; 3]| (0..3).all(|k| tile.bounds.min[k] <= p[k] && p[k] <= tile.bounds.max[k]);
        assert!(piece.arrays.positions.iter().all(inside));
        assert!(piece.weights.iter().all(|w| (w.iter().sum::<f32>() - 1.0).abs() < 1e-5));
        if let Some(parent) = tile.parent {
            let parent = &plan.tiles[parent as usize];
            assert!(parent.bounds.contains(&tile.bounds) && parent.level < tile.level);
            assert!(tile.error <= parent.error || tile.whole || parent.clusters.is_empty());
        }
    }
    for (level, error) in plan.levels.iter().enumerate() {
        let own: Vec<&Piece> = front(plan, level as u32).iter().map(|n| &pieces[*n]).collect();
        let found = edges(own.iter().copied());
        let open = found.iter().filter(|([a, b], count)| found.get(&[*b, *a]) != Some(count)).count();
        let whole = cut_arrays(dag, &select(dag, &Threshold::Uniform(*error)));
        if closed {
            assert_eq!(open, 0, "level {level}");
        } else {
            let alone = Piece { arrays: whole.clone(), ..Piece::default() };
            let known = edges(std::iter::once(&alone));
            let borders = known.iter().filter(|([a, b], count)| known.get(&[*b, *a]) != Some(count)).count();
            // Where a plane crosses the border of the source, it has an edge more.
            assert!(open >= borders, "level {level}: {open}, {borders}");
        }
        // What is a border of a tile is one of another.
        for piece in &own {
            for [a, b, face] in &piece.borders {
                assert!([a, b].iter().all(|v| piece.arrays.faces[*face as usize].contains(v)));
                let [a, b] = [a, b].map(|v| bits(piece.arrays.positions[*v as usize]));
                assert!(!closed || found.contains_key(&[b, a]), "level {level}");
            }
        }
        let sum: f64 = own.iter().map(|piece| area(&piece.arrays.positions, &piece.arrays.faces)).sum();
        let known = area(&whole.positions, &whole.faces);
        assert!((sum / known - 1.0).abs() < 1e-5, "level {level}: {sum}, {known}");
    }
}

/// A closed block of unit squares: all of its edges lie in planes that boxes are halved at.
fn block(side: u32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let mut numbers = FxHashMap::default();
    let (mut positions, mut faces) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        for (top, a, b) in (0..2).flat_map(|t| (0..side).flat_map(move |a| (0..side).map(move |b| (t, a, b))))
        {
            let mut at = |da: u32, db: u32| {
                let mut p = [0u32; 3];
                (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (top * side, a + da, b + db);
                *numbers.entry(p).or_insert_with(|| {
                    positions.push(p.map(|x| x as f32));
                    positions.len() as u32 - 1
                })
            };
            let corners = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
            let [p, q, r, s] =
                if top == 1 { corners } else { [corners[3], corners[2], corners[1], corners[0]] };
            faces.extend([[p, q, r], [p, r, s]]);
        }
    }
    (positions, faces)
}

#[test]
fn tiles_of_a_level_are_one_closed_surface() {
    let round = dag(&bumpy_sphere(60));
    for most in [300, 2_000, 1 << 20] {
        let found = plan(&round, &Layout::Triangles(most), &|| true).unwrap();
        assert_eq!(found.levels.last(), Some(&0.0));
        assert!(found.levels.is_sorted_by(|a, b| a > b));
        verify(&round, &found, true);
        let whole: usize = front(&found, found.levels.len() as u32).len();
        assert!(if most == 1 << 20 { whole == 1 } else { whole > 4 });
        // A part of the boxes is finished before the last level, or none is: either is fine; no tile is too large by much.
        let sizes = found.tiles.iter().map(|tile| tile.clusters.len());
        assert!(sizes.max().unwrap() <= most as usize / 16 + 16);
    }
}

#[test]
fn edges_in_the_planes_belong_to_one_tile() {
    let flat = dag(&block(32));
    for most in [200, 1_500] {
        let found = plan(&flat, &Layout::Triangles(most), &|| true).unwrap();
        assert!(found.tiles.len() > 4);
        verify(&flat, &found, true);
    }
}

#[test]
fn what_is_in_a_file_is_cut_alike_and_does_not_stay() {
    let rich = rich_mesh(12);
    let stored = open_input(Box::new(to_bytes(&rich).unwrap()), "stored").unwrap();
    let layout = Layout::Triangles(400);
    let [here, there] = [&rich, &stored].map(|dag| plan(dag, &layout, &|| true).unwrap());
    assert_eq!(here.tiles, there.tiles);
    for number in 0..here.tiles.len() {
        let [a, b] = [(&rich, &here), (&stored, &there)]
            .map(|(dag, plan)| extract(dag, plan, number, UNINTERRUPTED).unwrap());
        assert_eq!(a, b);
        assert!(!a.materials.is_empty() || a.arrays.faces.is_empty());
    }
    assert_eq!(stored.pages.words_held(), 0);
    verify(&rich, &here, false);
}

#[test]
fn grids_have_boxes_of_one_size() {
    let round = dag(&bumpy_sphere(30));
    let bounds = Aabb { min: [-1.5; 3], max: [1.75; 3] };
    let layout = Layout::Grid { bounds, levels: vec![(0.02, 0), (0.005, 1), (0.0, 2)] };
    let found = plan(&round, &layout, &|| true).unwrap();
    for tile in &found.tiles {
        let size: [f32; 3] = std::array::from_fn(|k| tile.bounds.max[k] - tile.bounds.min[k]);
        assert_eq!(size, [3.25 / (1 << tile.level) as f32; 3]);
    }
    verify(&round, &found, true);
}

#[test]
fn nothing_and_little_have_tiles() {
    let one = (vec![[0.0f32; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0u32, 1, 2]]);
    let one = dag(&one);
    let found = plan(&one, &Layout::Triangles(1), &|| true).unwrap();
    assert_eq!((found.levels.as_slice(), found.tiles.len()), ([0.0].as_slice(), 1));
    assert_eq!(extract(&one, &found, 0, &|| true).unwrap().arrays.faces.len(), 1);
    // A box with more triangles than it can be halved for stays whole: all of them share a point.
    let fan: Vec<[f32; 3]> =
        (0..2_000).map(|k| [(k as f32).cos(), (k as f32).sin(), k as f32 * 1e-4]).collect();
    let faces: Vec<[u32; 3]> = (1..1_999).map(|k| [0, k, k + 1]).collect();
    let mesh = dag(&(fan, faces));
    let found = plan(&mesh, &Layout::Triangles(50), &|| true).unwrap();
    verify(&mesh, &found, false);
}
