//! Occlusion culling in two passes changes no pixel.

use std::sync::Arc;

use nanite_rs::config::RenderOptions;
use nanite_rs::render::{Frame, Renderer, Stage};
use nanite_rs::scene::Material;

use super::{counts, device, differences, funnel, options, scaled};
use crate::render_frames::{CAMERA, Pose, at, city, dag, shoot, turned};
use crate::shapes::{bumpy_sphere, torus};

#[test]
fn what_is_hidden_changes_no_pixel() {
    let Some(_) = device("what_is_hidden_changes_no_pixel") else { return };
    let mut scene = city(24);
    let ball = scene.add(dag(&bumpy_sphere(60)), &at(1.5, 2.0, 0.0), Material::default()).unwrap();
    // Along a street, a turn, a jump to another one, and the roofs.
    let mut path: Vec<Pose> = (0..6).map(|k| at(1.5, 1.7, 6.0 - 0.7 * f64::from(k))).collect();
    path.extend((1..5).map(|k| turned(at(1.5, 1.7, 2.5), 0.35 * f64::from(k))));
    path.extend([at(40.5, 1.7, -20.0), at(40.5, 1.6, -20.1), at(30.0, 40.0, 50.0), at(1.5, 1.7, 6.0)]);
    let (size, wide) = ((317, 203), RenderOptions { occlusion: true, ..options(0.0) });
    let narrow = RenderOptions { int64_atomics: false, ..wide.clone() };
    let whole = RenderOptions { occlusion: false, ..wide.clone() };
    let mut renderers = [(); 3].map(|()| Renderer::new(size.0, size.1, "gpu").unwrap());
    let (mut resumed, mut hidden, mut lists) = (0, 0, Vec::new());
    for (k, pose) in path.iter().enumerate() {
        // The ball fills the street, rolls on, and jumps.
        let to = [0.0, 0.3, 0.6, -9.0, 1.2, 90.0, 90.0][k % 7];
        scene.set_pose(ball, &scaled(at(1.5, 1.5, to), 1.2)).unwrap();
        let [expected, ours, narrow] = [&whole, &wide, &narrow].map(|options| {
            let renderer =
                &mut renderers[usize::from(options.occlusion) + usize::from(!options.int64_atomics)];
            renderer.render(&scene, &CAMERA, pose, options).unwrap()
        });
        assert_eq!(differences(&ours, &expected), (0, 0), "frame {k}");
        assert!(
            ours.color().unwrap() == expected.color().unwrap()
                && ours.words().unwrap() == narrow.words().unwrap(),
            "frame {k}"
        );
        assert_eq!(counts(&ours), counts(&narrow));
        assert!(ours.visible().iter().all(|v| expected.visible().contains(v)));
        assert_eq!(ours.stats.source_triangles, expected.stats.source_triangles);
        let clusters = |pass| funnel(&ours, Stage::ClusterCull, pass).1;
        assert_eq!(clusters(1) + clusters(2), ours.stats.clusters);
        resumed += clusters(2);
        lists.push(from_a_list(&ours));
        hidden += ours.stats.occluded_instances + ours.stats.occluded_clusters;
    }
    assert!(resumed > 100 && hidden > 1000, "{resumed} {hidden}");
    // In the street each starts from what the one before drew; after a turn by 20 degrees or a jump there is little of it.
    let listed = [1, 2, 3, 4, 5, 11];
    assert!((0..).zip(&lists).all(|(k, list)| *list == listed.contains(&k)), "{lists:?}");
}

/// Whether a frame started from what the one before drew: its first pass did not walk.
fn from_a_list(frame: &Frame) -> bool {
    funnel(frame, Stage::NodeCull, 1).0 == 0
}

/// Instances come, go, hide, move far and get other looks between frames of a camera that moves on: what the frame before
/// drew is never drawn where it is no longer, and lists are used where slots hold the same meshes as before.
#[test]
fn what_the_frame_before_drew_survives_edits() {
    let Some(_) = device("what_the_frame_before_drew_survives_edits") else { return };
    let (size, mut scene) = ((240, 150), city(12));
    let (ball, ring) = (dag(&bumpy_sphere(60)), dag(&torus(60, 24)));
    let shapes = [&ball, &ring];
    let place = |k: usize| scaled(at(1.5 + (k % 3) as f64, 1.0 + 0.3 * (k % 4) as f64, -(k as f64)), 1.0);
    let mut handles: Vec<_> = (0..6)
        .map(|k| scene.add(Arc::clone(shapes[k % 2]), &place(k), Material::default()).unwrap())
        .collect();
    let culled = RenderOptions { occlusion: true, ..options(0.5) };
    let mut renderer = Renderer::new(size.0, size.1, "gpu").unwrap();
    let (mut lists, mut hidden) = ([0; 2], 0);
    for k in 0..24 {
        let handle = handles[k % 6];
        let edit = k % 8;
        match edit {
            0 => scene.set_pose(handle, &scaled(at(60.0, 1.0, -9.0), 1.0)).unwrap(),
            1 => scene.set_visible(handle, false).unwrap(),
            3 => drop(scene.remove(handle).unwrap()),
            4 => {
                // In the slot of the one before lies the other mesh.
                let mesh = Arc::clone(shapes[k / 8 % 2]);
                handles[(k - 1) % 6] = scene.add(mesh, &place(k), Material::default()).unwrap();
            }
            6 => {
                scene.set_visible(handles[(k - 5) % 6], true).unwrap();
                scene.set_pose(handles[(k - 6) % 6], &place(k)).unwrap();
            }
            _ => scene.set_material(handle, Material { double_sided: true, ..Material::default() }).unwrap(),
        }
        let pose = at(1.5, 1.7, 7.0 - 0.1 * k as f64);
        let frame = renderer.render(&scene, &CAMERA, &pose, &culled).unwrap();
        let whole = shoot(&scene, &CAMERA, &pose, size, &options(0.5));
        assert_eq!(differences(&frame, &whole), (0, 0), "frame {k}");
        // The second frame may lack room, and those in which slots got other meshes have no list.
        if k > 1 {
            assert_eq!(from_a_list(&frame), !(3..5).contains(&edit), "frame {k}");
        }
        lists[usize::from(from_a_list(&frame))] += 1;
        hidden += frame.stats.occluded_instances + frame.stats.occluded_clusters;
    }
    assert!(lists[1] >= 16 && hidden > 100, "{lists:?} {hidden}");
}

#[test]
fn from_the_street_a_city_costs_what_is_seen() {
    let Some(_) = device("from_the_street_a_city_costs_what_is_seen") else { return };
    let scene = city(120);
    let size = (1280, 720);
    let mut renderers = [(); 2].map(|()| Renderer::new(size.0, size.1, "gpu").unwrap());
    let (mut before, mut after, mut first, mut cut) = (0, 0, 0, 0);
    for k in 0..8 {
        let pose = turned(at(178.5, 1.7, -178.5), std::f64::consts::FRAC_PI_4 * f64::from(k) + 0.2);
        let whole = renderers[0].render(&scene, &CAMERA, &pose, &options(1.0)).unwrap();
        let culled = RenderOptions { occlusion: true, ..options(1.0) };
        let mut render = || renderers[1].render(&scene, &CAMERA, &pose, &culled).unwrap();
        let frames = [render(), render()];
        assert!(frames.iter().all(|frame| differences(frame, &whole) == (0, 0)));
        // Nothing moved: nothing is put off in vain.
        assert_eq!(funnel(&frames[1], Stage::ClusterCull, 2).1, 0);
        before += whole.stats.clusters;
        // Of a renderer, the first frame and those after a cut start from what is near.
        cut += frames[0].stats.clusters;
        after += frames[1].stats.clusters;
        let mut new = Renderer::new(size.0, size.1, "gpu").unwrap();
        let frame = new.render(&scene, &CAMERA, &pose, &RenderOptions::default()).unwrap();
        assert_eq!(differences(&frame, &whole), (0, 0));
        first += frame.stats.clusters;
    }
    println!("{after} of {before} clusters, {first} in first frames, {cut} after cuts");
    assert!(20 * after <= before, "{after} of {before} clusters");
    assert!(8 * first <= before && 8 * cut <= before, "{first} and {cut} of {before} clusters");
}
