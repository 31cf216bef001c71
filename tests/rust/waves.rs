//! Meshes that follow waves: nothing is ever outside its bounds.

use nanite_rs::build::waves::{WaveDesc, at, waves};
use nanite_rs::build::{Silent, build};
use nanite_rs::config::BuildOptions;
use nanite_rs::mesh::{Positions, SourceChannel, SourceMesh};
use nanite_rs::model::rule::ROOT_ERROR;
use nanite_rs::model::{ChannelInfo, ChannelType, Dag, UNINTERRUPTED, Wave};

use crate::shapes;

const FRAMES: u32 = 1_000;

fn swaying() -> (std::sync::Arc<nanite_rs::model::Waves>, Dag) {
    let (positions, faces) = shapes::torus(60, 40);
    let words =
        |of: &dyn Fn(&[f32; 3]) -> f32| -> Vec<u32> { positions.iter().map(|p| of(p).to_bits()).collect() };
    let (weights, phases) = (words(&|p| 1.0 + p[0]), words(&|p| if p[1] > 0.0 { 0.3 } else { 2.0 * p[2] }));
    let info = |name: &str| ChannelInfo { name: name.to_owned(), dtype: ChannelType::Float32, columns: None };
    let mut source = SourceMesh::new(Positions::F32(&positions), &faces);
    source.channels = vec![
        SourceChannel { info: info("weight"), words: &weights },
        SourceChannel { info: info("phase"), words: &phases },
    ];
    let dag = build(&source, &BuildOptions::default(), &Silent).unwrap();
    let wave = |amplitude, frequency, vector| Wave { amplitude, frequency, vector };
    let (weight, phase) = (Some("weight".to_owned()), Some("phase".to_owned()));
    let all = [
        WaveDesc { wave: wave([0.4, 0.1, -0.2], 0.31, [0.0; 3]), weight: weight.clone(), phase },
        WaveDesc { wave: wave([0.0, 0.0, 0.5], 1.7, [0.4, -0.3, 0.1]), weight: None, phase: None },
        WaveDesc { wave: wave([-0.1, 0.3, 0.0], 0.05, [0.0, 1.0, 0.0]), weight, phase: None },
    ];
    waves(&dag, &all, UNINTERRUPTED).unwrap()
}

fn inside(p: [f32; 3], center: [f32; 3], extent: [f32; 3]) -> bool {
    (0..3).all(|k| (f64::from(p[k]) - f64::from(center[k])).abs() <= f64::from(extent[k]) * (1.0 + 1.0e-7))
}

#[test]
fn no_cluster_is_ever_outside_its_bounds() {
    let (waves, moved) = swaying();
    assert!(moved.cluster_count() > 30);
    let mut farthest = 0f64;
    let rest: Vec<Vec<[f32; 3]>> =
        moved.pages.addresses().map(|c| moved.pages.geometry(c).positions.iter().collect()).collect();
    for frame in 0..FRAMES {
        let now = at(&waves, &moved, f64::from(frame) / 60.0);
        let pose = now.pose.as_ref().unwrap();
        for (address, rest) in now.pages.addresses().zip(&rest) {
            let (sphere, extent) = pose.cluster_bounds(&now.pages, address);
            let group = now.group_of(address);
            for (p, rest) in now.geometry(address).positions.iter().zip(rest) {
                assert!(inside(p, sphere.center, extent), "{address:?} at frame {frame}");
                assert!(inside(p, group.center, group.extent), "group of {address:?} at frame {frame}");
                let away = (0..3).map(|k| f64::from(p[k] - sphere.center[k]).powi(2)).sum::<f64>().sqrt();
                assert!(away <= f64::from(sphere.radius));
                let gone = |k: usize| {
                    f64::from(p[k]) * now.frame.scale - f64::from(rest[k]) * waves.ratio * now.frame.scale
                };
                farthest = farthest.max((0..3).map(|k| gone(k).powi(2)).sum::<f64>().sqrt());
            }
        }
        // Source clusters lie in the mesh's box.
        for address in now.pages.addresses().filter(|c| now.record(*c).level == 0) {
            for p in now.geometry(address).positions.iter() {
                assert!((0..3).all(|k| now.bounds.min[k] <= p[k] && p[k] <= now.bounds.max[k]));
            }
        }
    }
    assert!(farthest <= waves.largest, "{farthest} of {}", waves.largest);
    assert!(farthest > 0.5 * waves.largest, "{farthest} of {}", waves.largest);
}

#[test]
fn errors_increase_and_spheres_nest() {
    let (_, moved) = swaying();
    for address in moved.pages.addresses() {
        let record = moved.record(address);
        let (sphere, error) = moved.own_error(record);
        let group = moved.group_of(address);
        assert!(error < group.error || group.error == ROOT_ERROR);
        assert!(group.lod_sphere.contains(&sphere) || record.level == 0);
    }
    for node in &moved.nodes {
        let (first, count) = (node.first as usize, usize::from(node.count));
        let boxes: Vec<([f32; 3], [f32; 3])> = if node.is_leaf == 1 {
            moved.groups[first..first + count].iter().map(|group| (group.center, group.extent)).collect()
        } else {
            moved.nodes[first..first + count].iter().map(|node| (node.center, node.extent)).collect()
        };
        for (center, extent) in boxes {
            for k in 0..3 {
                let slack = 1.0e-6;
                assert!(center[k] - extent[k] >= node.center[k] - node.extent[k] - slack);
                assert!(center[k] + extent[k] <= node.center[k] + node.extent[k] + slack);
            }
        }
    }
}
