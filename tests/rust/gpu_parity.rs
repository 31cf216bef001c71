//! The GPU backend against its CPU twin: the same lists, the same counts, the same picture. A test runs on the device,
//! or says that there is none; it never falls back.

use std::io::Write;
use std::sync::Arc;

use nanite_rs::config::RenderOptions;
use nanite_rs::gpu::Context;
use nanite_rs::render::{Backend, Frame, Renderer, Stage};
use nanite_rs::scene::{Camera, Material, Projection, Scene};

use crate::render_frames::{CAMERA, IDENTITY, Pose, at, crowd, dag, lit, shoot};
use crate::shapes::{bumpy_sphere, grid, torus};

/// The device, or a note for the summary of `make test` that this test was skipped.
fn device(test: &str) -> Option<Arc<Context>> {
    match Context::shared() {
        Ok(context) => Some(context),
        Err(error) => {
            println!("skipped {test}: {error}");
            if let Some(path) = std::env::var_os("NANITE_SKIPS") {
                let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
                writeln!(file.unwrap(), "{test}\t{error}").unwrap();
            }
            None
        }
    }
}

fn options(tau: f32) -> RenderOptions {
    RenderOptions { pixel_error: tau, occlusion: false, ..RenderOptions::default() }
}

fn on_device(
    scene: &Scene,
    camera: &Camera,
    pose: &Pose,
    size: (u32, u32),
    options: &RenderOptions,
) -> Frame {
    let mut renderer = Renderer::new(size.0, size.1, "gpu").unwrap();
    let frame = renderer.render(scene, camera, pose, options).unwrap();
    assert_eq!(renderer.backend(), Backend::Gpu);
    frame
}

/// What a pixel shows: instance, cluster, triangle.
fn identities(frame: &Frame) -> Vec<(i32, u32, i32)> {
    let (instances, clusters, triangles) = (frame.instance_ids(), frame.cluster_ids(), frame.triangle_ids());
    instances.into_iter().zip(clusters).zip(triangles).map(|((i, c), t)| (i, c, t)).collect()
}

/// Received and passed of every stage up to the rasterizers.
fn counts(frame: &Frame) -> Vec<(Stage, u64, u64)> {
    let drawing = frame.stats.stages.iter().filter(|s| s.stage < Stage::Hzb);
    drawing.map(|s| (s.stage, s.received, s.passed)).collect()
}

/// Both frames, equal in all that has to be equal whatever the scene; in software in every bit.
fn compare(scene: &Scene, camera: &Camera, pose: &Pose, size: (u32, u32), tau: f32) -> Frame {
    let cpu = shoot(scene, camera, pose, size, &options(tau));
    let gpu = on_device(scene, camera, pose, size, &options(tau));
    assert_eq!(counts(&gpu), counts(&cpu));
    assert_eq!(gpu.stats.source_triangles, cpu.stats.source_triangles);
    assert_eq!(gpu.visible(), cpu.visible());
    let different = identities(&gpu).iter().zip(identities(&cpu)).filter(|(a, b)| *a != b).count();
    let depths = gpu.depth().iter().zip(cpu.depth()).filter(|(a, b)| **a != *b).count();
    println!("{different} identities and {depths} depths of {} pixels differ", gpu.words().len());
    assert_eq!((different, depths), (0, 0));
    gpu
}

#[test]
fn small_triangles_are_equal_bit_for_bit() {
    let Some(_) = device("small_triangles_are_equal_bit_for_bit") else { return };
    let mut scene = lit();
    scene.add(dag(&bumpy_sphere(60)), &IDENTITY, Material::default()).unwrap();
    for (distance, tau) in [(3.0, 0.0), (3.0, 1.0), (8.0, 1.0), (40.0, 0.5)] {
        let frame = compare(&scene, &CAMERA, &at(0.0, 0.0, distance), (320, 200), tau);
        assert!(frame.stats.drawn_small > 0 && frame.stats.covered_pixels > 0);
    }
}

#[test]
fn a_crowd_is_equal() {
    let Some(_) = device("a_crowd_is_equal") else { return };
    let scene = crowd();
    for (pose, tau) in [(at(0.0, 0.0, 6.0), 1.0), (at(0.3, 0.2, 1.8), 0.0), (at(-1.0, 0.0, 12.0), 0.5)] {
        compare(&scene, &CAMERA, &pose, (639, 361), tau);
    }
}
