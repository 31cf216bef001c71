//! What must hold for every built mesh and every cut.

#![allow(clippy::disallowed_types)] // the order of these tables reaches no assertion

use std::collections::HashMap;

use glam::DVec3;
use nanite_rs::build::{Silent, build, check};
use nanite_rs::config::{BuildOptions, Quality};
use nanite_rs::lod::{FaceBudget, cut_error, extract, select};
use nanite_rs::math::LodView;
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::rule::Threshold;
use nanite_rs::model::{ClusterAddress, Dag, Group, UNINTERRUPTED};

use crate::shapes::{self, Mesh};

pub fn build_mesh(mesh: &Mesh) -> Dag {
    build_with(mesh, &BuildOptions::default())
}

fn build_with(mesh: &Mesh, options: &BuildOptions) -> Dag {
    let dag = build(&SourceMesh::new(Positions::F32(&mesh.0), &mesh.1), options, &Silent).unwrap();
    check(&dag, UNINTERRUPTED).unwrap();
    dag
}

/// Net uses of each edge by position: empty exactly for closed surfaces.
fn open_edges(dag: &Dag, clusters: &[ClusterAddress]) -> usize {
    let cut = extract(dag, clusters);
    let mut net: HashMap<([u32; 3], [u32; 3]), i32> = HashMap::new();
    for f in &cut.faces {
        let p = f.map(|v| cut.positions[v as usize].map(f32::to_bits));
        for k in 0..3 {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            if a < b {
                *net.entry((a, b)).or_default() += 1;
            } else {
                *net.entry((b, a)).or_default() -= 1;
            }
        }
    }
    net.values().filter(|n| **n != 0).count()
}

/// Signed volume, which overlaps and holes would change.
fn volume(dag: &Dag, clusters: &[ClusterAddress]) -> f64 {
    let cut = extract(dag, clusters);
    let det = |f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| cut.positions[v as usize].map(f64::from));
        a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    cut.faces.iter().map(det).sum::<f64>() / 6.0
}

fn area(dag: &Dag, clusters: &[ClusterAddress]) -> f64 {
    let cut = extract(dag, clusters);
    let corner = |v: u32| DVec3::from_array(cut.positions[v as usize].map(f64::from));
    let twice = |f: &[u32; 3]| {
        let [a, b, c] = f.map(corner);
        (b - a).cross(c - a).length()
    };
    cut.faces.iter().map(twice).sum::<f64>() / 2.0
}

/// A small deterministic generator of numbers in 0..1.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mut x = self.0;
        x = (x ^ x >> 33).wrapping_mul(0xff51_afd7_ed55_8ccd);
        ((x ^ x >> 33) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn random_view(random: &mut Random) -> Threshold {
    let distance = 10f64.powf(random.next() * 5.0 - 1.0);
    let angle = random.next() * std::f64::consts::TAU;
    let z = random.next() * 2.0 - 1.0;
    let r = (1.0 - z * z).sqrt();
    let eye = DVec3::new(r * angle.cos(), r * angle.sin(), z) * distance;
    // Looks towards the mesh, and mostly past it.
    let past = DVec3::new(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5) * distance;
    let back = (eye - past).normalize();
    let right = DVec3::new(0.3, 0.8, 0.52).cross(back).normalize();
    let row = |axis: DVec3| [axis.x, axis.y, axis.z, -axis.dot(eye)].map(|x| x as f32);
    let view = LodView {
        object_to_eye: [row(right), row(back.cross(right)), row(back)],
        scale: 1.0,
        rounding: 0.0,
        focal: 1000.0,
        widest: 1.0 + 8.0 * random.next().powi(3) as f32,
        near: 0.01,
    };
    Threshold::View(view, 10f64.powf(random.next() * 4.0 - 2.0) as f32)
}

#[test]
fn every_cut_of_a_closed_mesh_is_closed() {
    // The coarsest cuts keep 0.961 and 0.851 of the volume.
    for (mesh, least) in [(shapes::bumpy_sphere(48), 0.955), (shapes::torus(160, 60), 0.83)] {
        let dag = build_mesh(&mesh);
        let full = select(&dag, &Threshold::Uniform(0.0));
        let (source, area) = (volume(&dag, &full), area(&dag, &full));
        let largest = dag.groups.iter().filter(|g| g.error.is_finite()).map(|g| g.error).fold(0.0, f32::max);
        let mut random = Random(7);
        for i in 0..300 {
            let threshold = if i % 2 == 0 {
                Threshold::Uniform(largest * 1.1 * random.next().powi(4) as f32)
            } else {
                random_view(&mut random)
            };
            let clusters = select(&dag, &threshold);
            assert!(!clusters.is_empty());
            assert_eq!(open_edges(&dag, &clusters), 0, "{threshold:?}");
            let ratio = volume(&dag, &clusters) / source;
            assert!((least..1.002).contains(&ratio), "{threshold:?}: volume ratio {ratio}");
            // A surface that is off by the error to one side alone would change the volume by this. Cuts are off to
            // both sides, and by less than the error in most places: up to 0.06 of it is measured.
            let one_sided = area * cut_error(&dag, &clusters) / dag.frame.scale;
            let changed = (ratio - 1.0).abs() * source;
            assert!(changed <= 0.08 * one_sided, "{threshold:?}: {} of one side", changed / one_sided);
        }
    }
}

/// The rule, cluster by cluster, without the hierarchy.
#[test]
fn walking_the_hierarchy_finds_what_the_rule_says() {
    let dag = build_mesh(&shapes::bumpy_sphere(64));
    let mut random = Random(3);
    for number in 0..200 {
        let uniform = 10f64.powf(random.next() * 6.0 - 6.0) as f32;
        let threshold = if number % 4 == 0 { Threshold::Uniform(uniform) } else { random_view(&mut random) };
        let by_rule: Vec<ClusterAddress> = dag
            .pages
            .addresses()
            .filter(|at| {
                let (record, group) = (dag.record(*at), dag.group_of(*at));
                threshold.exceeded_by(&group.lod_sphere, group.error)
                    && !threshold.exceeded_by(&record.lod_sphere, record.error)
            })
            .collect();
        assert_eq!(select(&dag, &threshold), by_rule);
    }
}

/// From every source cluster up, along any path of the DAG, exactly one cluster is drawn.
#[test]
fn exactly_one_cluster_over_every_piece() {
    let dag = build_mesh(&shapes::bumpy_sphere(64));
    let mut outputs = vec![Vec::new(); dag.groups.len()];
    for at in dag.pages.addresses() {
        if let Some(list) = outputs.get_mut(dag.record(at).refined as usize) {
            list.push(at);
        }
    }
    let mut random = Random(11);
    for _ in 0..1000 {
        let threshold = random_view(&mut random);
        let mut drawn = vec![false; dag.cluster_count()];
        select(&dag, &threshold).iter().for_each(|at| drawn[dag.pages.dense_index(*at)] = true);
        // above[c]: number of drawn clusters on every path above and including c; all paths must agree on 1.
        for start in dag.pages.addresses().filter(|at| dag.record(*at).level == 0) {
            let (mut at, mut count) = (start, 0);
            loop {
                count += u32::from(drawn[dag.pages.dense_index(at)]);
                let above = &outputs[dag.record(at).group as usize];
                if above.is_empty() {
                    break;
                }
                at = above[(random.next() * above.len() as f64) as usize];
            }
            assert_eq!(count, 1, "{threshold:?} from {start:?}");
        }
    }
}

#[test]
fn full_detail_is_the_source() {
    let bumps = shapes::grid(60, |x, y| (9.0 * x).sin() * (7.0 * y).cos() * 0.1);
    for mesh in [shapes::grid(60, |_, _| 0.0), bumps, shapes::bumpy_sphere(30)] {
        let dag = build_mesh(&mesh);
        let cut = extract(&dag, &select(&dag, &Threshold::Uniform(0.0)));
        let key = |p: [[f64; 3]; 3]| {
            let turn = (0..3).min_by(|a, b| p[*a].partial_cmp(&p[*b]).unwrap()).unwrap();
            [0, 1, 2].map(|k| p[(turn + k) % 3].map(|x| (x + 0.0).to_bits()))
        };
        let mut expected: Vec<_> =
            mesh.1.iter().map(|f| key(f.map(|v| mesh.0[v as usize].map(f64::from)))).collect();
        let mut found: Vec<_> = cut
            .faces
            .iter()
            .map(|f| key(f.map(|v| dag.frame.to_object(cut.positions[v as usize]))))
            .collect();
        expected.sort_unstable();
        found.sort_unstable();
        assert!(expected == found);
    }
}

#[test]
fn threads_do_not_change_the_bytes() {
    let mesh = shapes::bumpy_sphere(80);
    for quality in [Quality::Fast, Quality::Best] {
        let with = |threads| build_with(&mesh, &BuildOptions { threads, quality, ..BuildOptions::default() });
        let one = with(1);
        assert_eq!(one, with(2));
        assert_eq!(one, with(8));
    }
}

#[test]
fn scaling_by_a_power_of_two_changes_nothing_but_the_scale() {
    let (positions, faces) = shapes::bumpy_sphere(40);
    let scaled = positions.iter().map(|p| p.map(|x| x * 1024.0)).collect();
    let (a, b) = (build_mesh(&(positions, faces.clone())), build_mesh(&(scaled, faces)));
    assert_eq!(a.pages, b.pages);
    assert_eq!(a.frame.scale * 1024.0, b.frame.scale);
}

#[test]
fn budgets_are_met_from_below() {
    let dag = build_mesh(&shapes::bumpy_sphere(64));
    let budget = FaceBudget::new(&dag);
    for target in [32_768, 20_000, 5_000, 700] {
        let cut = extract(&dag, &budget.select(&dag, target));
        assert!(cut.faces.len() as u64 <= target, "{} > {target}", cut.faces.len());
        assert!(cut.faces.len() as u64 * 3 > target, "{} is far below {target}", cut.faces.len());
    }
}

#[test]
fn soups_islands_and_flat_shading_reach_a_small_root() {
    let sphere = shapes::bumpy_sphere(40);
    let soup = shapes::unindexed(&sphere);
    let dag = build_mesh(&soup);
    assert_eq!(dag.report.welded_vertices as usize, soup.0.len() - sphere.0.len());

    let normals = shapes::flat_normals(&soup);
    let flat = SourceMesh { normals: Some(&normals), ..SourceMesh::new(Positions::F32(&soup.0), &soup.1) };
    let dag = build(&flat, &BuildOptions::default(), &Silent).unwrap();
    check(&dag, UNINTERRUPTED).unwrap();
    let root: u32 = dag.groups.iter().filter(|g| g.error.is_infinite()).map(|g| g.count).sum();
    assert!(root <= 4, "{root} clusters stay roots: {:?}", dag.report);
}

/// What groups say of their triangles is what their clusters have.
#[test]
fn budgets_follow_from_groups_alone() {
    for mesh in [shapes::bumpy_sphere(40), shapes::unindexed(&shapes::cube(6))] {
        let dag = build_mesh(&mesh);
        let stated = FaceBudget::new(&dag);
        let mut silent = dag.clone();
        silent.groups = dag.groups.iter().map(|group| Group { triangles: 0, made: 0, ..*group }).collect();
        assert!(FaceBudget::is_stated(&dag) && !FaceBudget::is_stated(&silent));
        assert_eq!(FaceBudget::new(&silent), stated);
        check(&silent, UNINTERRUPTED).unwrap();
        for wrong in [|group: &mut Group| group.triangles += 1, |group: &mut Group| group.made += 1] {
            let mut groups = dag.groups.to_vec();
            groups.iter_mut().rfind(|group| group.error.is_finite()).map(wrong).unwrap();
            silent.groups = groups.into();
            let error = check(&silent, UNINTERRUPTED).unwrap_err().to_string();
            assert!(error.contains("triangles"), "{error}");
        }
    }
}
