//! The GPU backend against its CPU twin: the same lists, the same counts, the same picture. A test runs on the device,
//! or says that there is none; it never falls back.

mod arrays;
mod edits;
mod frames;
mod memory;
mod occlusion;
pub mod tolerances;
pub mod views;

use std::io::Write;
use std::process::Command;
use std::sync::Arc;

use nanite_rs::config::{Raster, RenderOptions};
use nanite_rs::gpu::Context;
use nanite_rs::render::{Backend, Frame, Renderer, Stage};
use nanite_rs::scene::{Camera, Material, Projection, Scene};

use crate::gpu_raster::{Hardware, other_forms};
use crate::render_frames::{IDENTITY, Pose, dag, lit, shoot};
use crate::shapes::grid;

/// The device, or a note for the summary of `make test` that this test was skipped.
pub fn device(test: &str) -> Option<Arc<Context>> {
    match Context::shared() {
        Ok(context) => Some(context),
        Err(error) => {
            skip(test, &error.to_string());
            None
        }
    }
}

pub fn skip(test: &str, reason: &str) {
    println!("skipped {test}: {reason}");
    if let Some(path) = std::env::var_os("NANITE_SKIPS") {
        let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
        writeln!(file.unwrap(), "{test}\t{reason}").unwrap();
    }
}

/// What the CPU does bit for bit: without occlusion, and by the rasterizers that are its twins.
pub fn options(tau: f32) -> RenderOptions {
    RenderOptions { pixel_error: tau, occlusion: false, raster: Raster::Compute, ..RenderOptions::default() }
}

pub fn on_device(
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
pub fn identities(frame: &Frame) -> Vec<(i32, u32, i32)> {
    let (instances, clusters, triangles) =
        (frame.instance_ids().unwrap(), frame.cluster_ids().unwrap(), frame.triangle_ids().unwrap());
    instances.into_iter().zip(clusters).zip(triangles).map(|((i, c), t)| (i, c, t)).collect()
}

/// Received and passed of every stage up to the rasterizers.
pub fn counts(frame: &Frame) -> Vec<(Stage, u64, u64)> {
    let drawing = frame.stats.stages.iter().filter(|s| s.stage < Stage::Hzb);
    drawing.map(|s| (s.stage, s.received, s.passed)).collect()
}

/// Received and passed of a stage in a pass.
pub fn funnel(frame: &Frame, stage: Stage, pass: u8) -> (u64, u64) {
    let found = frame.stats.stages.iter().find(|s| s.stage == stage && s.pass == pass);
    found.map_or((0, 0), |s| (s.received, s.passed))
}

/// How many pixels of two frames show something else, and of how many only the depth differs.
pub fn differences(a: &Frame, b: &Frame) -> (usize, usize) {
    let (ids_a, ids_b, depth_a, depth_b) =
        (identities(a), identities(b), a.depth().unwrap(), b.depth().unwrap());
    let other = (0..ids_a.len()).filter(|&i| ids_a[i] != ids_b[i]).count();
    let depth = (0..ids_a.len()).filter(|&i| ids_a[i] == ids_b[i] && depth_a[i] != depth_b[i]).count();
    (other, depth)
}

/// A frame of the device in compute, equal to the CPU's: the same clusters and counts, and every bit of the picture.
pub fn equal(scene: &Scene, camera: &Camera, pose: &Pose, size: (u32, u32), tau: f32) -> Frame {
    compared(scene, camera, pose, size, tau).0
}

/// The same, with triangles that the device's own rasterizer drew of the view in other forms, which cover as much.
pub fn compared(
    scene: &Scene,
    camera: &Camera,
    pose: &Pose,
    size: (u32, u32),
    tau: f32,
) -> (Frame, Option<Hardware>) {
    let cpu = shoot(scene, camera, pose, size, &options(tau));
    let gpu = on_device(scene, camera, pose, size, &options(tau));
    assert_eq!(counts(&gpu), counts(&cpu));
    assert_eq!(gpu.stats.source_triangles, cpu.stats.source_triangles);
    assert!(gpu.visible() == cpu.visible(), "other clusters");
    assert_eq!(differences(&gpu, &cpu), (0, 0));
    assert!(gpu.words().unwrap() == cpu.words().unwrap());
    let hardware = other_forms(scene, camera, pose, &options(tau), &gpu);
    (gpu, hardware)
}

/// Set in a process that runs one test alone.
const ALONE: &str = "NANITE_TEST_ALONE";

/// Tests share the device, so one that harms it takes a process of its own. True there; elsewhere it has been run.
pub fn alone(test: &str) -> bool {
    if std::env::var_os(ALONE).is_some() {
        return true;
    }
    let arguments = ["--exact", test, "--nocapture"];
    let me = std::env::current_exe().unwrap();
    let done = Command::new(me).args(arguments).env(ALONE, "1").output().unwrap();
    let (out, err) = (String::from_utf8_lossy(&done.stdout), String::from_utf8_lossy(&done.stderr));
    assert!(done.status.success() && out.contains("1 passed"), "{out}\n{err}");
    false
}

pub fn scaled(pose: Pose, scale: f64) -> Pose {
    let mut out = pose;
    for row in &mut out {
        row[..3].iter_mut().for_each(|v| *v *= scale);
    }
    out
}

pub const PARALLEL: Camera = Camera {
    projection: Projection::Orthographic { xmag: Some(2.0), ymag: 1.2 },
    znear: 0.05,
    zfar: Some(9.0),
};

/// A floor and a ceiling of a kilometre around the eye, and a wall beside it.
pub fn room() -> Scene {
    let mut room = lit();
    let sheet = dag(&grid(4, |x, y| 0.02 * (9.0 * x).sin() * (7.0 * y).cos()));
    let both_sides = Material { double_sided: true, ..Material::default() };
    for height in [-1.0, 2.0] {
        let side = 1000.0;
        let flat = [[side, 0.0, 0.0, -400.0], [0.0, 0.0, 1.0, height], [0.0, -side, 0.0, 450.0], IDENTITY[3]];
        room.add(Arc::clone(&sheet), &flat, both_sides.clone()).unwrap();
    }
    let wall = [[0.0, 0.0, 1.0, 0.7], [0.0, 9.0, 0.0, -4.0], [-9.0, 0.0, 0.0, 4.0], IDENTITY[3]];
    room.add(sheet, &wall, both_sides).unwrap();
    room
}
