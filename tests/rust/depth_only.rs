//! Frames of depth alone: every bit of depth, and every count, is that of an ordinary frame.

use nanite_rs::Error;
use nanite_rs::config::{OUTPUTS, Output, Outputs, RenderOptions};
use nanite_rs::render::{Frame, FrameStats, ImageView, Renderer, Stage};
use nanite_rs::scene::{Material, Scene};

use crate::render_frames::{AnyView, CAMERA, IDENTITY, Pose, any_views, at, crowd, dag, lit, shoot};
use crate::shapes::{bumpy_sphere, grid};

/// The same frame, of depth alone.
fn alone(options: &RenderOptions) -> RenderOptions {
    let RenderOptions { depth_only, outputs, .. } = RenderOptions::depth_only();
    RenderOptions { depth_only, outputs, ..options.clone() }
}

fn bits(frame: &Frame) -> Vec<u32> {
    frame.depth().unwrap().into_iter().map(f32::to_bits).collect()
}

/// Depth, the visible list and every count but those of arrays.
fn same(depth: &Frame, whole: &Frame) {
    assert!(bits(depth) == bits(whole), "other depth");
    assert!(depth.visible() == whole.visible(), "other clusters");
    let (ours, theirs) = (&depth.stats, &whole.stats);
    let totals = |s: &FrameStats| {
        let drawn = [s.drawn_small, s.drawn_large, s.occluded_instances, s.occluded_clusters];
        (s.source_triangles, s.clusters, s.triangles, drawn, s.covered_pixels, s.raster)
    };
    assert_eq!(totals(ours), totals(theirs));
    let stages = |frame: &Frame| {
        let drawing = frame.stats.stages.iter().filter(|s| s.stage < Stage::Shade);
        drawing.map(|s| (s.stage, s.pass, s.received, s.passed)).collect::<Vec<_>>()
    };
    assert_eq!(stages(depth), stages(whole));
}

/// Nothing but depth comes of a frame of depth alone; errors name the argument and what there is not.
fn has_depth_alone(frame: &Frame) {
    let lacks = |found: Option<Error>, what: &str| match found {
        Some(Error::Argument { argument: "depth_only", message }) => {
            assert!(message.contains(what), "{message}")
        }
        other => panic!("{what}: {other:?}"),
    };
    for output in OUTPUTS.into_iter().filter(|output| *output != Output::Depth) {
        lacks(frame.array(output).err(), output.name());
        lacks(frame.make(output).err(), output.name());
    }
    lacks(frame.words().err(), "visibility buffer");
    lacks(frame.face_ids().err(), "face_id");
    lacks(frame.image(ImageView::parse("shaded").unwrap(), None).err(), "color");
    lacks(frame.image(ImageView::Overdraw, None).err(), "overdraw");
}

#[test]
fn on_the_cpu_depth_is_that_of_other_frames() {
    let mut covered = 0;
    for AnyView { scene, camera, pose, picture, options } in any_views(60) {
        for occlusion in [true, false] {
            let options = RenderOptions { occlusion, ..options.clone() };
            let whole = shoot(&scene, &camera, &pose, picture, &options);
            let depth = shoot(&scene, &camera, &pose, picture, &alone(&options));
            same(&depth, &whole);
            covered += depth.stats.covered_pixels;
        }
    }
    assert!(covered > 80_000, "{covered}");
    // Deep enough for pyramids, and more than once by one renderer, whose memory is used again.
    let scene = crowd();
    let mut renderer = Renderer::new(639, 361, "cpu").unwrap();
    let mut hidden = 0;
    for pose in [at(0.0, 0.0, 6.0), at(0.3, 0.2, 1.8), at(-1.0, 0.0, 12.0)] {
        let alone = shoot(&scene, &CAMERA, &pose, (639, 361), &RenderOptions::default());
        let depth = renderer.render(&scene, &CAMERA, &pose, &RenderOptions::depth_only()).unwrap();
        same(&depth, &alone);
        hidden += depth.stats.occluded_instances + depth.stats.occluded_clusters;
        // What a frame shows is drawn first in the next, so that clusters and counts may be others, but no depth.
        let whole = renderer.render(&scene, &CAMERA, &pose, &RenderOptions::default()).unwrap();
        let after = renderer.render(&scene, &CAMERA, &pose, &RenderOptions::depth_only()).unwrap();
        assert!(bits(&whole) == bits(&alone) && bits(&after) == bits(&alone), "other depth");
        // A frame of depth alone says nothing of clusters, so that the next one is as the first.
        same(&renderer.render(&scene, &CAMERA, &pose, &RenderOptions::depth_only()).unwrap(), &alone);
    }
    assert!(hidden > 0);
}

/// A wall before the eye: its depth is its distance, whatever the perspective.
fn wall(distance: f64) -> (Scene, Pose) {
    let sheet = dag(&grid(40, |_, _| 0.0));
    let mut scene = Scene::new();
    let (size, middle) = (4.0 * distance, 2.0 * distance);
    let pose =
        [[size, 0.0, 0.0, -middle], [0.0, size, 0.0, -middle], [0.0, 0.0, 1.0, -distance], IDENTITY[3]];
    scene.add(sheet, &pose, Material { double_sided: true, ..Material::default() }).unwrap();
    (scene, IDENTITY)
}

fn a_wall_is_as_far_as_it_stands(backend: &str) {
    for distance in [0.25, 3.0, 1000.0] {
        let (scene, pose) = wall(distance);
        let mut renderer = Renderer::new(64, 48, backend).unwrap();
        let mut frame = renderer.render(&scene, &CAMERA, &pose, &RenderOptions::depth_only()).unwrap();
        for found in frame.depth().unwrap() {
            assert!((f64::from(found) / distance - 1.0).abs() < 1.0e-6, "{found} is not {distance}");
        }
        assert_eq!(frame.stats.covered_pixels, 64 * 48);
        // Taking it leaves it there.
        let taken: Vec<f32> = frame.take(Output::Depth).unwrap().into();
        assert!(taken == frame.depth().unwrap() && taken.len() == 64 * 48);
    }
}

#[test]
fn on_the_cpu_a_wall_is_as_far_as_it_stands() {
    a_wall_is_as_far_as_it_stands("cpu");
}

#[test]
fn nothing_but_depth_is_asked_for_or_given() {
    let mut scene = lit();
    scene.add(dag(&bumpy_sphere(12)), &IDENTITY, Material::default()).unwrap();
    let pose = at(0.0, 0.0, 4.0);
    let mut renderer = Renderer::new(32, 24, "cpu").unwrap();
    let mut draw = |outputs: Outputs| {
        renderer.render(&scene, &CAMERA, &pose, &RenderOptions { outputs, ..RenderOptions::depth_only() })
    };
    for output in OUTPUTS.into_iter().filter(|output| *output != Output::Depth) {
        match draw([Output::Depth, output].into_iter().collect()) {
            Err(Error::Argument { argument: "outputs", message }) => {
                assert!(message.contains("depth_only") && message.contains(output.name()), "{message}");
            }
            other => panic!("{output:?}: {other:?}"),
        }
    }
    // It is there whether it was asked for or not.
    let asked = draw([Output::Depth].into_iter().collect()).unwrap();
    let unasked = draw(Outputs::default()).unwrap();
    assert!(asked.stats.covered_pixels > 0 && bits(&asked) == bits(&unasked));
    has_depth_alone(&asked);
    has_depth_alone(&unasked);
    // Nor is an empty scene anything but far.
    let mut renderer = Renderer::new(4, 3, "cpu").unwrap();
    for _ in 0..2 {
        let nothing = renderer.render(&Scene::new(), &CAMERA, &pose, &RenderOptions::depth_only()).unwrap();
        assert_eq!((bits(&nothing), nothing.stats.covered_pixels), (vec![0; 12], 0));
    }
}

#[cfg(feature = "gpu")]
mod on_a_device {
    use nanite_rs::config::Raster;
    use nanite_rs::model::UNINTERRUPTED;
    use nanite_rs::render::ViewDesc;
    use nanite_rs::scene::Camera;

    use super::*;
    use crate::gpu_parity::{PARALLEL, device, on_device, room, scaled};
    use crate::gpu_raster::rasterizer;
    use crate::render_frames::{city, turned};

    /// Ways to draw ordinary frames, of which depth is made.
    fn ways(raster: Raster, tau: f32) -> impl Iterator<Item = RenderOptions> {
        let all = [(true, true), (true, false), (false, true), (false, false)];
        all.into_iter().map(move |(int64_atomics, occlusion)| RenderOptions {
            pixel_error: tau,
            raster,
            int64_atomics,
            occlusion,
            outputs: RenderOptions::depth_only().outputs,
            // On the device with occlusion, by the CPU without.
            device_outputs: Some(occlusion),
            ..RenderOptions::default()
        })
    }

    #[test]
    fn depth_is_that_of_other_frames() {
        let Some(_) = device("depth_is_that_of_other_frames") else { return };
        let (crowd, room) = (crowd(), room());
        let views: [(&Scene, &Camera, Pose, f32); 5] = [
            (&crowd, &CAMERA, at(0.0, 0.0, 6.0), 1.0),
            (&crowd, &CAMERA, at(0.3, 0.2, 1.8), 0.0),
            (&crowd, &PARALLEL, at(0.1, 0.2, 4.0), 0.5),
            (&room, &CAMERA, at(0.1, 0.0, 0.2), 0.5),
            (&room, &PARALLEL, at(0.65, -0.9, 3.9), 0.5),
        ];
        let size = (211, 127);
        let [mut whole, mut depth] = [(); 2].map(|()| Renderer::new(size.0, size.1, "gpu").unwrap());
        for (scene, camera, pose, tau) in views {
            for options in ways(Raster::Compute, tau) {
                let expected = bits(&shoot(scene, camera, &pose, size, &options));
                // The second frame of each finds what the first one hid.
                for _ in 0..2 {
                    let whole = whole.render(scene, camera, &pose, &options).unwrap();
                    let depth = depth.render(scene, camera, &pose, &alone(&options)).unwrap();
                    same(&depth, &whole);
                    assert!(bits(&depth) == expected, "not the CPU's: {options:?}");
                    assert!(depth.stats.covered_pixels > 0);
                }
            }
        }
        let AnyView { scene, camera, pose, picture, options } = any_views(1).next().unwrap();
        has_depth_alone(&on_device(&scene, &camera, &pose, picture, &alone(&options)));
    }

    #[test]
    fn a_wall_comes_and_goes() {
        let Some(_) = device("a_wall_comes_and_goes") else { return };
        a_wall_is_as_far_as_it_stands("gpu");
        // With nothing to draw, and with something before that.
        let (scene, pose) = wall(2.0);
        let mut renderer = Renderer::new(5, 3, "gpu").unwrap();
        for device_outputs in [Some(true), Some(false)] {
            let options = RenderOptions { device_outputs, ..RenderOptions::depth_only() };
            for _ in 0..2 {
                assert_eq!(
                    renderer.render(&scene, &CAMERA, &pose, &options).unwrap().stats.covered_pixels,
                    15
                );
                let nothing = renderer.render(&Scene::new(), &CAMERA, &pose, &options).unwrap();
                assert_eq!((bits(&nothing), nothing.stats.covered_pixels), (vec![0; 15], 0));
            }
        }
    }

    #[test]
    fn its_own_rasterizer_draws_the_same() {
        let Some(_) = rasterizer("its_own_rasterizer_draws_the_same") else { return };
        let (crowd, room) = (crowd(), room());
        let [mut whole, mut depth] = [(); 2].map(|()| Renderer::new(317, 203, "gpu").unwrap());
        for (scene, pose) in
            [(&crowd, at(0.0, 0.0, 6.0)), (&crowd, at(0.3, 0.2, 1.8)), (&room, at(20.0, 1.3, -7.0))]
        {
            for raster in [Raster::Hybrid, Raster::Hardware] {
                for options in ways(raster, 0.5) {
                    let whole = whole.render(scene, &CAMERA, &pose, &options).unwrap();
                    same(&depth.render(scene, &CAMERA, &pose, &alone(&options)).unwrap(), &whole);
                }
            }
        }
    }

    #[test]
    fn frames_of_both_kinds_follow_each_other() {
        let Some(_) = device("frames_of_both_kinds_follow_each_other") else { return };
        let mut scene = city(24);
        let ball = scene.add(dag(&bumpy_sphere(60)), &at(1.5, 2.0, 0.0), Material::default()).unwrap();
        let mut path: Vec<Pose> = (0..6).map(|k| at(1.5, 1.7, 6.0 - 0.7 * f64::from(k))).collect();
        path.extend((1..4).map(|k| turned(at(1.5, 1.7, 2.5), 0.35 * f64::from(k))));
        path.extend([at(40.5, 1.7, -20.0), at(40.5, 1.6, -20.1), at(30.0, 40.0, 50.0)]);
        let (size, mut hidden) = ((317, 203), 0);
        for device_outputs in [true, false] {
            let options = RenderOptions {
                pixel_error: 0.0,
                raster: Raster::Compute,
                device_outputs: Some(device_outputs),
                ..RenderOptions::default()
            };
            let whole = RenderOptions { occlusion: false, ..options.clone() };
            // One draws both kinds by turns, the other ordinary frames alone: earlier frames hid the same from both.
            let [mut mixed, mut plain] = [(); 2].map(|()| Renderer::new(size.0, size.1, "gpu").unwrap());
            for (k, pose) in path.iter().enumerate() {
                let to = [0.0, 0.3, 0.6, -9.0, 1.2, 90.0, 90.0][k % 7];
                scene.set_pose(ball, &scaled(at(1.5, 1.5, to), 1.2)).unwrap();
                let expected = plain.render(&scene, &CAMERA, pose, &options).unwrap();
                let only = k % 3 == 1;
                let ours = if only { alone(&options) } else { options.clone() };
                let frame = mixed.render(&scene, &CAMERA, pose, &ours).unwrap();
                same(&frame, &expected);
                assert!(bits(&frame) == bits(&shoot(&scene, &CAMERA, pose, size, &whole)), "frame {k}");
                if !only {
                    assert!(frame.words().unwrap() == expected.words().unwrap(), "frame {k}");
                    assert!(frame.color().unwrap() == expected.color().unwrap(), "frame {k}");
                }
                hidden += frame.stats.occluded_instances + frame.stats.occluded_clusters;
            }
        }
        assert!(hidden > 1000, "{hidden}");
    }

    #[test]
    fn several_views_of_depth_alone_are_as_alone() {
        let Some(_) = device("several_views_of_depth_alone_are_as_alone") else { return };
        let scene = crowd();
        let size = (200, 120);
        for device_outputs in [true, false] {
            let options = RenderOptions {
                raster: Raster::Compute,
                device_outputs: Some(device_outputs),
                ..RenderOptions::depth_only()
            };
            let mut on_gpu = Renderer::new(size.0, size.1, "gpu").unwrap();
            let mut on_cpu = Renderer::new(size.0, size.1, "cpu").unwrap();
            for (step, count) in [(0.0, 3), (0.1, 3), (0.2, 4), (0.3, 1)] {
                let all = [
                    (CAMERA, at(step, 0.0, 6.0)),
                    (PARALLEL, at(0.1, step, 4.0)),
                    // Away from everything.
                    (CAMERA, turned(at(0.0, 0.0, 6.0), 3.0)),
                    (CAMERA, at(0.0, 1.0, 9.0 + 10.0 * step)),
                ];
                let views = &all[..count];
                let frames =
                    on_gpu.render_views(&scene, &ViewDesc::numbered(views), &options, UNINTERRUPTED).unwrap();
                let theirs =
                    on_cpu.render_views(&scene, &ViewDesc::numbered(views), &options, UNINTERRUPTED).unwrap();
                assert_eq!((frames.len(), theirs.len()), (count, count));
                for ((frame, their), (camera, pose)) in frames.iter().zip(&theirs).zip(views) {
                    let whole = shoot(&scene, camera, pose, size, &RenderOptions::default());
                    assert!(bits(frame) == bits(&whole) && bits(their) == bits(&whole));
                    let covered = [frame, their].map(|frame| frame.stats.covered_pixels);
                    assert_eq!(covered, [whole.stats.covered_pixels; 2]);
                }
            }
        }
    }
}
