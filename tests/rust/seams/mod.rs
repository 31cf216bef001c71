//! A trial of each seam that the next capabilities go through: a view with a size, threshold and kind of its own beside
//! others; a geometry of one level; in `pages`, sources and sinks of pages.

mod pages;

use std::sync::Arc;

use nanite_rs::build::{Silent, build, check};
use nanite_rs::config::{BuildOptions, Levels, OUTPUTS, Output, RenderOptions};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::{Dag, UNINTERRUPTED};
use nanite_rs::render::{Backend, Renderer, ViewDesc, ViewKind};
use nanite_rs::scene::{Material, Scene};
#[cfg(feature = "gpu")]
use nanite_rs::stages::{STAGES, Stage};

use crate::render_frames::{CAMERA, IDENTITY, at, crowd, dag, lit, shoot};
use crate::shapes::{Mesh, bumpy_sphere};

/// The backends that there are.
fn backends(test: &str) -> Vec<&'static str> {
    #[cfg(feature = "gpu")]
    let on_device = crate::gpu_parity::device(test).map(|_| "gpu");
    #[cfg(not(feature = "gpu"))]
    let on_device = {
        let _ = test;
        None
    };
    ["cpu"].into_iter().chain(on_device).collect()
}

/// A picture, a map of depths and a coarse one in a submission: each is what its view gives alone.
#[test]
fn views_of_several_kinds_share_a_submission() {
    let scene = crowd();
    for backend in backends("views_of_several_kinds_share_a_submission") {
        let of_call =
            RenderOptions { pixel_error: 0.5, device_outputs: Some(true), ..RenderOptions::default() };
        let ids = [Output::InstanceId].into_iter().collect();
        let views = [
            ViewDesc::new(1, CAMERA, at(0.0, 0.0, 6.0)),
            ViewDesc {
                size: Some((96, 96)),
                kind: Some(ViewKind::DepthOnly),
                ..ViewDesc::new(2, CAMERA, at(1.0, 2.0, 7.0))
            },
            ViewDesc {
                pixel_error: Some(6.0),
                outputs: Some(ids),
                ..ViewDesc::new(3, CAMERA, at(0.0, 0.0, 6.0))
            },
            // Depth that nobody asked for now.
            ViewDesc {
                size: Some((70, 50)),
                kind: Some(ViewKind::DepthOnly),
                outputs: Some([].into_iter().collect()),
                ..ViewDesc::new(4, CAMERA, at(1.0, 2.0, 7.0))
            },
        ];
        let mut together = Renderer::new(160, 90, backend).unwrap();
        // The second time each starts from what the first one showed.
        for _ in 0..2 {
            let frames = together.render_views(&scene, &views, &of_call, UNINTERRUPTED).unwrap();
            for (view, frame) in views.iter().zip(&frames) {
                let size = view.size.unwrap_or((160, 90));
                let depth_only = view.kind == Some(ViewKind::DepthOnly);
                let options = RenderOptions {
                    pixel_error: view.pixel_error.unwrap_or(0.5),
                    ..RenderOptions::default()
                };
                let alone = shoot(&scene, &view.camera, &view.pose, size, &options);
                assert_eq!((frame.width(), frame.height()), size);
                assert_eq!(frame.stats.covered_pixels, alone.stats.covered_pixels);
                assert_eq!(frame.words().is_err(), depth_only);
                let on_device = together.backend() == Backend::Gpu && view.id == 4;
                assert!(!on_device || frame.is_on_device());
                assert!(frame.depth().unwrap() == alone.depth().unwrap());
                if !depth_only {
                    assert!(frame.instance_ids().unwrap() == alone.instance_ids().unwrap());
                    assert!(frame.cluster_ids().unwrap() == alone.cluster_ids().unwrap());
                }
            }
            // The coarse one takes fewer triangles.
            assert!(2 * frames[2].stats.triangles < frames[0].stats.triangles);
        }
        let deep = ViewDesc { outputs: Some(OUTPUTS.into_iter().collect()), ..views[1] };
        let refused =
            together.render_views(&scene, &[deep], &of_call, UNINTERRUPTED).unwrap_err().to_string();
        assert!(refused.contains("with depth_only there is \"depth\" alone"), "{refused}");
    }
}

fn one_level((vertices, faces): &Mesh) -> Arc<Dag> {
    let options = BuildOptions { levels: Levels::One, face_ids: true, ..BuildOptions::default() };
    Arc::new(build(&SourceMesh::new(Positions::F32(vertices), faces), &options, &Silent).unwrap())
}

/// Without levels of detail the source is drawn, at whatever distance, beside geometries that have them.
#[test]
fn a_geometry_of_one_level_is_drawn_like_any_other() {
    let mesh = bumpy_sphere(60);
    let (flat, levels) = (one_level(&mesh), dag(&mesh));
    assert!(check(&flat, UNINTERRUPTED).is_ok());
    assert!(flat.id.number() != levels.id.number() && flat.clone().id.number() == flat.id.number());
    assert_eq!(flat.report.levels.len(), 1);
    assert_eq!(flat.report.triangles, flat.source_faces);
    let scene = |left: &Arc<Dag>| {
        let mut scene = lit();
        for (mesh, x) in [(left, -1.2), (&levels, 1.2)] {
            scene.add(Arc::clone(mesh), &at(x, 0.0, 0.0), Material::default()).unwrap();
        }
        scene
    };
    let full = RenderOptions { pixel_error: 0.0, ..RenderOptions::default() };
    let expected = shoot(&scene(&levels), &CAMERA, &at(0.0, 0.0, 5.0), (200, 120), &full);
    for backend in backends("a_geometry_of_one_level_is_drawn_like_any_other") {
        let mut renderer = Renderer::new(200, 120, backend).unwrap();
        let mut draw = |scene: &Scene, pose, options: &RenderOptions| {
            renderer.render(scene, &CAMERA, &pose, options).unwrap()
        };
        let flat_scene = scene(&flat);
        let frame = draw(&flat_scene, at(0.0, 0.0, 5.0), &full);
        // The same triangles, in clusters of their own: the same faces at the same pixels.
        assert!(frame.face_ids().unwrap() == expected.face_ids().unwrap());
        assert!(frame.instance_ids().unwrap() == expected.instance_ids().unwrap());
        // At a distance at which the other is coarse.
        let far = RenderOptions { pixel_error: 2.0, occlusion: false, ..full.clone() };
        let frame = draw(&flat_scene, at(0.0, 0.0, 12.0), &far);
        let coarse = shoot(&scene(&levels), &CAMERA, &at(0.0, 0.0, 12.0), (200, 120), &far);
        let (fine, coarse) = (frame.stats.triangles, coarse.stats.triangles);
        assert!(fine > 3 * coarse, "{fine}, {coarse}");
        // One of them alone, at a pose that is the identity.
        let mut alone = Scene::new();
        alone.add(Arc::clone(&flat), &IDENTITY, Material::default()).unwrap();
        assert!(draw(&alone, at(0.0, 0.0, 4.0), &full).stats.covered_pixels > 0);
    }
}

/// Whatever the stage from which on the CPU draws, the image is the same: as long as the device does all before it as the
/// CPU would.
#[cfg(feature = "gpu")]
#[test]
fn any_stage_can_be_the_first_on_the_cpu() {
    let Some(_) = crate::gpu_parity::device("any_stage_can_be_the_first_on_the_cpu") else { return };
    let (scene, pose) = (crowd(), at(0.0, 0.0, 6.0));
    let mut renderer = Renderer::new(160, 90, "gpu").unwrap();
    for options in [RenderOptions::default(), RenderOptions::depth_only()] {
        let options = RenderOptions { pixel_error: 0.7, device_outputs: Some(true), ..options };
        let expected = shoot(&scene, &CAMERA, &pose, (160, 90), &options);
        for from in STAGES {
            let cpu_from = RenderOptions { cpu_from: Some(from), ..options.clone() };
            let frame = renderer.render(&scene, &CAMERA, &pose, &cpu_from).unwrap();
            assert!(frame.depth().unwrap() == expected.depth().unwrap(), "{from:?}");
            assert_eq!(frame.stats.covered_pixels, expected.stats.covered_pixels, "{from:?}");
            if !options.depth_only {
                assert!(frame.instance_ids().unwrap() == expected.instance_ids().unwrap(), "{from:?}");
                assert!(frame.triangle_ids().unwrap() == expected.triangle_ids().unwrap(), "{from:?}");
                crate::gpu_parity::tolerances::same_color(
                    &frame.color().unwrap(),
                    &expected.color().unwrap(),
                    "color",
                );
            }
            // The device ran those before it, and no other but what the CPU then did.
            let ran = frame.stats.stages.iter().filter(|stats| stats.stage < Stage::Shade);
            let last = ran.map(|stats| stats.stage).max();
            assert!(from == Stage::InstanceCull || last.is_none_or(|last| last < from), "{from:?}: {last:?}");
        }
    }
}
