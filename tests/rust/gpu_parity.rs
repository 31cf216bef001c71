//! The GPU backend against its CPU twin: the same lists, the same counts, the same picture. A test runs on the device,
//! or says that there is none; it never falls back.

use std::io::Write;
use std::process::Command;
use std::sync::Arc;

use nanite_rs::Error;
use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, OUTPUTS, Output, Raster, RenderOptions};
use nanite_rs::gpu::Context;
use nanite_rs::gpu_types::{self, Array};
use nanite_rs::mesh::{Colors, Positions, SourceMesh};
use nanite_rs::model::{ColorFormat, Dag, UNINTERRUPTED};
use nanite_rs::render::{Backend, Frame, Renderer, Stage, ViewDesc};
use nanite_rs::scene::{Camera, Light, LightKind, Material, Projection, Scene};

use crate::gpu_raster::{self, Hardware};
use crate::render_frames::{
    AnyView, CAMERA, IDENTITY, Pose, any_views, at, city, crowd, dag, lit, shoot, turned,
};
use crate::shapes::{Mesh, bumpy_sphere, grid, torus};

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

/// How many pixels of two frames show something else, and of how many only the depth differs.
fn differences(a: &Frame, b: &Frame) -> (usize, usize) {
    let (ids_a, ids_b, depth_a, depth_b) =
        (identities(a), identities(b), a.depth().unwrap(), b.depth().unwrap());
    let other = (0..ids_a.len()).filter(|&i| ids_a[i] != ids_b[i]).count();
    let depth = (0..ids_a.len()).filter(|&i| ids_a[i] == ids_b[i] && depth_a[i] != depth_b[i]).count();
    (other, depth)
}

/// A frame of the device in compute, equal to the CPU's: the same clusters and counts, and every bit of the picture.
fn equal(scene: &Scene, camera: &Camera, pose: &Pose, size: (u32, u32), tau: f32) -> Frame {
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
    let hardware = gpu_raster::other_forms(scene, camera, pose, &options(tau), &gpu);
    (gpu, hardware)
}

#[test]
fn every_array_is_made_on_the_device() {
    let Some(_) = device("every_array_is_made_on_the_device") else { return };
    let colored = |(positions, faces): Mesh, format: ColorFormat| {
        let color = |p: &[f32; 3]| [p[0].abs().min(1.0), 0.5, p[1].abs().min(1.0), 1.0];
        let fine: Vec<[f32; 4]> = positions.iter().map(color).collect();
        let shorts: Vec<[u16; 4]> = fine.iter().map(|c| c.map(|x| (65_535.0 * x) as u16)).collect();
        let bytes: Vec<[u8; 4]> = fine.iter().map(|c| c.map(|x| (255.0 * x) as u8)).collect();
        let mut source = SourceMesh::new(Positions::F32(&positions), &faces);
        source.colors = match format {
            ColorFormat::None => None,
            ColorFormat::Unorm8 => Some(Colors::U8(&bytes)),
            ColorFormat::Unorm16 => Some(Colors::U16(&shorts)),
            ColorFormat::Float32 => Some(Colors::F32(&fine)),
        };
        Arc::new(build(&source, &BuildOptions::default(), &Silent).unwrap())
    };
    let mut many = crowd();
    for (k, format) in
        [ColorFormat::Unorm8, ColorFormat::Unorm16, ColorFormat::Float32].into_iter().enumerate()
    {
        let place = at(2.0 * k as f64 - 1.0, 0.5, 3.0);
        many.add(colored(bumpy_sphere(30), format), &place, Material::default()).unwrap();
    }
    let metal = Material {
        base_color: [0.9, 0.6, 0.2],
        metallic: 0.8,
        roughness: 0.2,
        emissive: [0.1, 0.0, 0.05],
        ..Material::default()
    };
    many.add(dag(&torus(60, 24)), &scaled(turned(at(1.5, 0.0, 3.0), 0.7), 0.4), metal).unwrap();
    let point = |range, place: Pose| Light {
        kind: LightKind::Point { range },
        color: [1.0, 0.7, 0.4],
        intensity: 20.0,
        pose: glam::DAffine3::from_translation(glam::DVec3::new(place[0][3], place[1][3], place[2][3])),
        visible: true,
    };
    many.add_light(point(None, at(0.0, 3.0, 4.0))).unwrap();
    many.add_light(point(Some(6.0), at(-3.0, 0.0, 4.0))).unwrap();
    let spot = LightKind::Spot { range: Some(20.0), inner: 0.1, outer: 0.3 };
    many.add_light(Light { kind: spot, ..point(None, at(0.0, 0.5, 6.0)) }).unwrap();
    // Without any light.
    let mut unlit = Scene::new();
    unlit.add(dag(&bumpy_sphere(30)), &IDENTITY, Material::default()).unwrap();
    for (scene, camera, size) in [
        (&unlit, &CAMERA, (64, 48)),
        (&many, &CAMERA, (320, 200)),
        (&many, &PARALLEL, (201, 113)),
        (&lit(), &CAMERA, (5, 3)),
        (&many, &CAMERA, (1, 1)),
    ] {
        let options = RenderOptions {
            outputs: OUTPUTS.into_iter().collect(),
            device_outputs: Some(true),
            ..options(1.0)
        };
        let cpu = shoot(scene, camera, &at(0.0, 0.0, 6.0), size, &options);
        let gpu = on_device(scene, camera, &at(0.0, 0.0, 6.0), size, &options);
        let ran = |stage| gpu.stats.stages.iter().filter(|s| s.stage == stage).count();
        assert_eq!((ran(Stage::Shade), ran(Stage::Output)), (1, 1));
        same_arrays(&gpu, &cpu);
        // In two passes, overdraw apart.
        let hidden = RenderOptions { occlusion: true, ..options.clone() };
        let mut renderer = Renderer::new(size.0, size.1, "gpu").unwrap();
        for _ in 0..3 {
            let gpu = renderer.render(scene, camera, &at(0.0, 0.0, 6.0), &hidden).unwrap();
            for output in [Output::Depth, Output::InstanceId, Output::ClusterId, Output::TriangleId] {
                assert!(gpu.array(output).unwrap() == cpu.array(output).unwrap(), "{}", output.name());
            }
            // Of the same list, drawn again by the CPU.
            assert!(gpu.array(Output::Overdraw).unwrap() == gpu.make(Output::Overdraw).unwrap());
        }
    }
}

#[test]
fn what_stays_on_the_device_is_read_when_it_is_asked_for() {
    let Some(_) = device("what_stays_on_the_device_is_read_when_it_is_asked_for") else { return };
    let (scene, size) = (crowd(), (201, 113));
    let poses: Vec<Pose> = (0..6).map(|k| at(0.2 * f64::from(k), 0.1, 6.0)).collect();
    let colors = RenderOptions { device_outputs: Some(true), ..options(1.0) };
    let nothing = RenderOptions { outputs: [].into_iter().collect(), ..colors.clone() };
    for options in [colors, nothing] {
        let expected: Vec<Frame> =
            poses.iter().map(|pose| shoot(&scene, &CAMERA, pose, size, &options)).collect();
        let same = |frame: &Frame, expected: &Frame| {
            assert_eq!(frame.stats.covered_pixels, expected.stats.covered_pixels);
            assert!(frame.stats.covered_pixels > 1000);
            same_color(&frame.color().unwrap(), &expected.color().unwrap(), "color");
            assert!(frame.words().unwrap() == expected.words().unwrap());
            assert!(frame.face_ids().unwrap() == expected.face_ids().unwrap());
        };
        let mut renderer = Renderer::new(size.0, size.1, "gpu").unwrap();
        let mut render = |pose| renderer.render(&scene, &CAMERA, pose, &options).unwrap();
        // All of them are there while the next are drawn, and asked in another order, some after the renderer's end.
        let frames: Vec<Frame> = poses.iter().map(&mut render).collect();
        for place in [4, 1, 5] {
            same(&frames[place], &expected[place]);
        }
        // As in a loop, where one is there while the next is drawn.
        let mut last = render(&poses[0]);
        for (pose, expected) in poses.iter().zip(&expected) {
            last = render(pose);
            same(&last, expected);
        }
        drop(renderer);
        for place in [0, 2, 3] {
            same(&frames[place], &expected[place]);
        }
        same(&last, &expected[5]);
    }
}

/// Views of several sizes, whose order changes from call to call: each frame is the one of its view alone, and follows the
/// one that its view had before.
pub fn views_by_identity(backend: &str) {
    let scene = crowd();
    let options = RenderOptions { occlusion: true, raster: Raster::Compute, ..options(1.0) };
    let mut together = Renderer::new(200, 120, backend).unwrap();
    let lens = [
        ViewDesc::new(7, CAMERA, at(0.0, 0.0, 6.0)),
        ViewDesc { size: Some((64, 48)), ..ViewDesc::new(3, PARALLEL, at(0.1, 0.0, 4.0)) },
        ViewDesc { size: Some((333, 17)), ..ViewDesc::new(u64::MAX, CAMERA, at(0.0, 1.0, 9.0)) },
    ];
    let size = |view: &ViewDesc| view.size.unwrap_or((200, 120));
    let mut apart = lens.map(|view| Renderer::new(size(&view).0, size(&view).1, backend).unwrap());
    for order in [[0, 1, 2], [2, 0, 1], [1, 2, 0], [2, 1, 0]] {
        let views = order.map(|k| lens[k]);
        let frames = together.render_views(&scene, &views, &options, UNINTERRUPTED).unwrap();
        for ((frame, view), k) in frames.iter().zip(&views).zip(order) {
            assert_eq!((frame.width(), frame.height()), size(view));
            let alone = apart[k].render(&scene, &view.camera, &view.pose, &options).unwrap();
            assert!(frame.words().unwrap() == alone.words().unwrap());
            for pass in [1, 2] {
                let stages = [Stage::NodeCull, Stage::ClusterCull];
                let counts = |frame: &Frame| stages.map(|stage| funnel(frame, stage, pass));
                assert_eq!(counts(frame), counts(&alone), "view {} in pass {pass}", view.id);
            }
        }
    }
    let refused = |views: &[ViewDesc], what: &str| {
        let error =
            Renderer::new(200, 120, backend).unwrap().render_views(&scene, views, &options, UNINTERRUPTED);
        let message = error.unwrap_err().to_string();
        assert!(message.contains(what), "{message}");
    };
    refused(&[lens[0], lens[1], lens[0]], "views: two of them have the id 7");
    refused(&[ViewDesc { size: Some((0, 4)), ..lens[0] }], "width: must be between 1 and");
}

#[test]
fn views_of_any_size_share_a_submission() {
    let Some(_) = device("views_of_any_size_share_a_submission") else { return };
    views_by_identity("gpu");
}

#[test]
fn several_views_of_one_submission_are_as_alone() {
    let Some(_) = device("several_views_of_one_submission_are_as_alone") else { return };
    let scene = crowd();
    let size = (200, 120);
    let options = RenderOptions {
        occlusion: true,
        outputs: OUTPUTS.into_iter().collect(),
        device_outputs: Some(true),
        ..options(1.0)
    };
    let mut together = Renderer::new(size.0, size.1, "gpu").unwrap();
    let mut on_cpu = Renderer::new(size.0, size.1, "cpu").unwrap();
    assert!(together.render_views(&scene, &[], &options, UNINTERRUPTED).unwrap().is_empty());
    // Their number changes, and so do their eyes; one of them looks away from everything.
    for (step, count) in [(0.0, 3), (0.1, 3), (0.2, 5), (0.3, 1), (0.4, 4)] {
        let all = [
            (CAMERA, at(step, 0.0, 6.0)),
            (PARALLEL, at(0.1, step, 4.0)),
            (CAMERA, turned(at(0.0, 0.0, 6.0), 3.0)),
            (CAMERA, at(0.0, 1.0, 9.0 + 10.0 * step)),
            (PARALLEL, at(-1.0, 0.0, 5.0)),
        ];
        let views = &all[..count];
        let frames =
            together.render_views(&scene, &ViewDesc::numbered(views), &options, UNINTERRUPTED).unwrap();
        let theirs =
            on_cpu.render_views(&scene, &ViewDesc::numbered(views), &options, UNINTERRUPTED).unwrap();
        assert_eq!((frames.len(), theirs.len()), (count, count));
        for ((frame, their), (camera, pose)) in frames.iter().zip(&theirs).zip(views) {
            // Words number what was drawn, of which what is hidden depends on the frame before.
            let alone = shoot(&scene, camera, pose, size, &options);
            assert!(their.color().unwrap() == alone.color().unwrap());
            for output in [Output::Depth, Output::InstanceId, Output::ClusterId, Output::TriangleId] {
                let expected = alone.array(output).unwrap();
                assert!(frame.array(output).unwrap() == expected, "{}", output.name());
                assert!(their.array(output).unwrap() == expected, "{}", output.name());
            }
            assert_eq!(frame.stats.covered_pixels, alone.stats.covered_pixels);
            assert_eq!(frame.stats.source_triangles > 0, alone.stats.source_triangles > 0);
        }
        // Bit for bit what each of them draws by itself where nothing is left out.
        let whole = RenderOptions { occlusion: false, ..options.clone() };
        let frames =
            together.render_views(&scene, &ViewDesc::numbered(views), &whole, UNINTERRUPTED).unwrap();
        for (frame, (camera, pose)) in frames.iter().zip(views) {
            same_arrays(frame, &on_device(&scene, camera, pose, size, &whole));
            assert!(frame.words().unwrap() == shoot(&scene, camera, pose, size, &whole).words().unwrap());
        }
    }
    // The device's own rasterizer takes its turn for each of them.
    let views = [(CAMERA, at(0.0, 0.0, 6.0)), (PARALLEL, at(0.1, 0.2, 4.0))];
    let hybrid = RenderOptions { raster: Raster::Hybrid, ..options };
    if let Ok(frames) = together.render_views(&scene, &ViewDesc::numbered(&views), &hybrid, UNINTERRUPTED) {
        for (frame, (camera, pose)) in frames.iter().zip(&views) {
            let alone = shoot(&scene, camera, pose, size, &hybrid);
            let covered = |frame: &Frame| frame.words().unwrap().iter().map(|w| *w != 0).collect::<Vec<_>>();
            assert!(covered(frame) == covered(&alone));
        }
    }
}

/// Colours before they are encoded: within a thousandth and `floor`. Elsewhere than in software one number in ten thousand
/// may be off by a hundredth: roots and quotients of shading are a device's own, and bent normals magnify what is rounded.
pub fn same_light(gpu: &[f32], cpu: &[f32], floor: f32, what: &str) {
    assert_eq!(gpu.len(), cpu.len());
    let beyond = |part: f32| {
        let near = move |(a, b): (&f32, &f32)| (a - b).abs() <= part * a.max(*b) + floor;
        gpu.iter().zip(cpu).enumerate().filter(move |(_, pair)| !near(*pair))
    };
    let few = if software() { 0 } else { gpu.len() / 10_000 };
    let (some, many) = (beyond(1e-2).count(), beyond(1e-3).count());
    let such: Vec<_> = beyond(1e-3).take(6).collect();
    assert!(some == 0 && many <= few, "{what}: {some}, {many} of {}, such as {such:?}", gpu.len());
}

fn software() -> bool {
    Context::shared().unwrap().software()
}

/// Below this no light is told from another: a hundredth of the smallest step of a byte.
pub const DARK: f32 = 3e-6;

/// Colours, of which a few are rounded the other way, since a device may order the operations of shading as it likes:
/// never by more than one step.
pub fn same_color(gpu: &[u8], cpu: &[u8], what: &str) {
    assert_eq!(gpu.len(), cpu.len());
    let steps = gpu.iter().zip(cpu).map(|(a, b)| a.abs_diff(*b));
    let other = steps.clone().filter(|step| *step > 0).count();
    assert!(steps.max().unwrap() <= 1, "{what}");
    assert!(1000 * other <= gpu.len(), "{what}: {other} of {}", gpu.len());
}

/// Every array that can be made with a frame. Words are equal, colours all but.
fn same_arrays(gpu: &Frame, cpu: &Frame) {
    for output in OUTPUTS {
        match (gpu.array(output).unwrap(), cpu.array(output).unwrap()) {
            (Array::Bytes(ours), Array::Bytes(theirs)) => same_color(&ours, &theirs, output.name()),
            (Array::Floats(ours), Array::Floats(theirs)) if output == Output::Linear => {
                same_light(&ours, &theirs, DARK, output.name())
            }
            (Array::Floats(ours), Array::Floats(theirs)) if output == Output::Normal || output.surface() => {
                same_surface(&ours, &theirs, output.name())
            }
            (ours, theirs) => assert!(ours == theirs, "{}", output.name()),
        }
    }
}

/// Unit vectors, and what surfaces are: equal in software, and some units in the last place apart elsewhere, of slivers and
/// surfaces that are seen at a slant more than of others (an H200: 7.5e-6).
fn same_surface(gpu: &[f32], cpu: &[f32], what: &str) {
    let most = if software() { 0.0 } else { 2e-5 };
    let worst = gpu.iter().zip(cpu).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(gpu.len() == cpu.len() && worst <= most, "{what}: {worst:e}");
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

#[test]
fn frames_of_one_mesh_are_equal() {
    let Some(device) = device("frames_of_one_mesh_are_equal") else { return };
    let mut scene = lit();
    scene.add(dag(&bumpy_sphere(60)), &IDENTITY, Material::default()).unwrap();
    for (distance, tau) in [(3.0, 0.0), (3.0, 1.0), (8.0, 1.0), (40.0, 0.5)] {
        let frame = equal(&scene, &CAMERA, &at(0.0, 0.0, distance), (320, 200), tau);
        assert!(frame.stats.drawn_small > 0 && frame.stats.covered_pixels > 0);
        let times: Vec<f64> = frame.stats.stages.iter().map(|s| s.ms).filter(|ms| !ms.is_nan()).collect();
        assert!(times.iter().all(|ms| *ms >= 0.0) && times.iter().sum::<f64>() < frame.stats.total_ms);
        assert!(device.tick().is_none() || frame.stats.stages[3].ms > 0.0);
        equal(&scene, &PARALLEL, &at(0.1, 0.2, 4.0), (320, 200), tau);
    }
    for size in [(1, 1), (1, 7), (13, 1), (257, 3), (1023, 511)] {
        equal(&scene, &CAMERA, &at(0.0, 0.0, 3.0), size, 1.0);
    }
}

#[test]
fn large_triangles_are_equal() {
    let Some(_) = device("large_triangles_are_equal") else { return };
    let mut scene = lit();
    let sheet = dag(&grid(6, |x, y| 0.1 * (9.0 * x).sin() * (7.0 * y).cos()));
    let both_sides = Material { double_sided: true, ..Material::default() };
    for k in 0..4 {
        let k = f64::from(k);
        let pose = scaled(at(-4.0 - k, -3.0, -4.0 * k), 6.0 + 3.0 * k);
        scene.add(Arc::clone(&sheet), &pose, both_sides.clone()).unwrap();
    }
    let (frame, hardware) = compared(&scene, &CAMERA, &at(0.0, 0.0, 6.0), (640, 360), 0.0);
    assert!(frame.stats.drawn_large > 50, "{}", frame.stats.drawn_large);
    assert!(hardware.is_none_or(|[hybrid, _]| hybrid > 50), "{hardware:?}");
    equal(&scene, &PARALLEL, &at(0.0, 0.0, 4.0), (640, 360), 0.0);
}

#[test]
fn triangles_that_fill_the_picture_are_equal() {
    let Some(_) = device("triangles_that_fill_the_picture_are_equal") else { return };
    let sheet = dag(&grid(1, |_, _| 0.0));
    let both_sides = Material { double_sided: true, ..Material::default() };
    let mut scene = lit();
    // Upright behind; a floor from behind the eye, which is clipped; and one before them, tilted.
    scene.add(Arc::clone(&sheet), &scaled(at(-4.0, -4.0, -3.0), 8.0), both_sides.clone()).unwrap();
    let floor = [[40.0, 0.0, 0.0, -20.0], [0.0, 0.0, 1.0, -0.4], [0.0, -40.0, 0.0, 20.0], IDENTITY[3]];
    scene.add(Arc::clone(&sheet), &floor, both_sides.clone()).unwrap();
    scene.add(sheet, &turned(at(-0.5, -0.2, -1.0), 0.3), both_sides).unwrap();
    let size = (2048, 1536);
    let (frame, _) = compared(&scene, &CAMERA, &at(0.0, 0.0, 0.0), size, 0.0);
    assert_eq!(frame.stats.covered_pixels, u64::from(size.0 * size.1));
    assert!(frame.stats.drawn_large >= 5, "{}", frame.stats.drawn_large);
}

#[test]
fn a_crowd_is_equal() {
    let Some(_) = device("a_crowd_is_equal") else { return };
    let scene = crowd();
    for (pose, tau) in [(at(0.0, 0.0, 6.0), 1.0), (at(-1.0, 0.0, 12.0), 0.5), (at(-1.0, 0.0, 30.0), 0.0)] {
        let (_, hardware) = compared(&scene, &CAMERA, &pose, (639, 361), tau);
        assert!(hardware.is_none_or(|[_, all]| all > 10_000), "{hardware:?}");
    }
}

#[test]
fn pictures_of_any_size_are_equal() {
    let Some(_) = device("pictures_of_any_size_are_equal") else { return };
    let scene = crowd();
    let pose = at(0.3, 0.2, 1.8);
    for size in [(1, 1), (1, 97), (101, 1), (3, 2), (127, 129), (4099, 2161)] {
        let (whole, hardware) = compared(&scene, &CAMERA, &pose, size, 1.0);
        assert!(whole.stats.covered_pixels > 0, "{size:?}");
        assert!(hardware.is_none_or(|[_, all]| all > 0), "{size:?}");
        // Again with pyramids of that size: the first frame has none of an earlier one, the second has.
        let mut renderer = Renderer::new(size.0, size.1, "gpu").unwrap();
        let mut hidden = 0;
        for _ in 0..2 {
            let frame = renderer.render(&scene, &CAMERA, &pose, &RenderOptions::default()).unwrap();
            assert_eq!(differences(&frame, &whole), (0, 0), "{size:?}");
            hidden = frame.stats.occluded_instances + frame.stats.occluded_clusters;
        }
        assert!(hidden > 0 || size.0 < 1000, "nothing is hidden at {size:?}");
    }
}

#[test]
fn far_from_the_origin_frames_are_equal() {
    let Some(_) = device("far_from_the_origin_frames_are_equal") else { return };
    let ring = dag(&torus(60, 24));
    let places = [[3.0e6, -7.0e6, 1.0e7], [1.0e6, 0.0, 0.0], [0.0, -1.0e7, 1.0e6], [1.0e7, 1.0e7, -1.0e7]];
    for [x, y, z] in places {
        let mut scene = lit();
        scene.add(Arc::clone(&ring), &at(x, y, z), Material::default()).unwrap();
        // One close behind it, by a distance that f32 does not hold there.
        scene.add(Arc::clone(&ring), &at(x + 0.01, y + 0.3, z - 0.2), Material::default()).unwrap();
        // Before it, beside it, and so close that triangles are clipped.
        for eye in [at(x + 0.1, y, z + 4.0), at(x - 0.3, y + 0.1, z + 1.3), at(x + 1.0, y, z + 0.35)] {
            let frame = equal(&scene, &CAMERA, &eye, (320, 200), 0.7);
            assert!(frame.stats.covered_pixels > 5000, "{}", frame.stats.covered_pixels);
        }
    }
    // The same from the world's origin: as far as distances are sums of two f32, nothing shakes.
    let near = |offset: f64| {
        let mut scene = lit();
        scene.add(Arc::clone(&ring), &at(offset, -offset, offset), Material::default()).unwrap();
        let eye = at(offset + 0.25, 0.125 - offset, offset + 3.5);
        on_device(&scene, &CAMERA, &eye, (320, 200), &options(0.7))
    };
    let origin = near(0.0);
    for offset in [1.0e6, 1.0e7] {
        let frame = near(offset);
        assert!(
            frame.words().unwrap() == origin.words().unwrap()
                && frame.color().unwrap() == origin.color().unwrap(),
            "{offset}"
        );
    }
}

#[test]
fn thousands_of_instances_outgrow_every_list() {
    let Some(_) = device("thousands_of_instances_outgrow_every_list") else { return };
    let meshes = [dag(&bumpy_sphere(24)), dag(&torus(60, 24))];
    let mut scene = lit();
    for k in 0..6000 {
        let (x, y) = (k % 100, k / 100);
        let pose = at(f64::from(x) * 2.5 - 125.0, f64::from(y) * 2.5 - 75.0, f64::from(k % 7));
        let handle = scene.add(Arc::clone(&meshes[k as usize % 2]), &pose, Material::default()).unwrap();
        if k % 11 == 0 {
            scene.set_visible(handle, false).unwrap();
        }
    }
    let frame = equal(&scene, &CAMERA, &at(0.0, 0.0, 160.0), (400, 300), 0.03);
    assert!(frame.stats.clusters > 20_000, "{}", frame.stats.clusters);
}

#[test]
fn two_passes_of_32_bits_draw_the_same() {
    let Some(_) = device("two_passes_of_32_bits_draw_the_same") else { return };
    let scene = crowd();
    let pose = at(0.3, 0.2, 1.8);
    let mut options = options(0.5);
    let wide = on_device(&scene, &CAMERA, &pose, (639, 361), &options);
    options.int64_atomics = false;
    let narrow = on_device(&scene, &CAMERA, &pose, (639, 361), &options);
    assert!(narrow.words().unwrap() == wide.words().unwrap());
    assert_eq!(counts(&narrow), counts(&wide));
}

#[test]
fn a_renderer_follows_its_scene() {
    let Some(_) = device("a_renderer_follows_its_scene") else { return };
    let mut renderer = Renderer::new(160, 120, "gpu").unwrap();
    let pose = at(0.0, 0.0, 5.0);
    let mut scene = lit();
    let mut check = |scene: &Scene| {
        let gpu = renderer.render(scene, &CAMERA, &pose, &options(1.0)).unwrap();
        let cpu = shoot(scene, &CAMERA, &pose, (160, 120), &options(1.0));
        assert!(gpu.words().unwrap() == cpu.words().unwrap());
        assert!(gpu.color().unwrap() == cpu.color().unwrap());
        gpu.stats.covered_pixels
    };
    assert_eq!(check(&scene), 0);
    let ball = scene.add(dag(&bumpy_sphere(12)), &IDENTITY, Material::default()).unwrap();
    let alone = check(&scene);
    // A larger mesh needs more room than the first left.
    scene.add(dag(&torus(200, 80)), &at(1.0, 0.0, -0.5), Material::default()).unwrap();
    assert!(check(&scene) > alone && alone > 0);
    scene.set_pose(ball, &at(0.2, 0.1, 0.3)).unwrap();
    check(&scene);
    scene.remove(ball).unwrap();
    check(&scene);
}

#[test]
fn what_did_not_change_is_not_written_again() {
    let Some(_) = device("what_did_not_change_is_not_written_again") else { return };
    let record =
        (size_of::<gpu_types::InstanceTransform>() + size_of::<gpu_types::InstanceMaterial>()) as u64;
    let mut renderer = Renderer::new(160, 120, "gpu").unwrap();
    let mut scene = crowd();
    let mesh = dag(&torus(30, 12));
    let handles: Vec<_> = (0..100)
        .map(|k| {
            scene.add(Arc::clone(&mesh), &at(0.1 * f64::from(k), 0.0, -5.0), Material::default()).unwrap()
        })
        .collect();
    let mut distance = 6.0;
    let mut written = |scene: &Scene| {
        distance += 0.1;
        let pose = at(0.0, 0.0, distance);
        let gpu = renderer.render(scene, &CAMERA, &pose, &options(1.0)).unwrap();
        let cpu = shoot(scene, &CAMERA, &pose, (160, 120), &options(1.0));
        assert!(gpu.words().unwrap() == cpu.words().unwrap() && gpu.color().unwrap() == cpu.color().unwrap());
        gpu.stats.uploaded_bytes / record
    };
    let all = scene.instances().len() as u64;
    assert_eq!(written(&scene), all);
    // The camera alone.
    assert_eq!(written(&scene), 0);
    scene.set_pose(handles[3], &at(0.0, 1.0, -2.0)).unwrap();
    scene.set_visible(handles[4], false).unwrap();
    scene.set_material(handles[70], Material { double_sided: true, ..Material::default() }).unwrap();
    assert_eq!(written(&scene), 3);
    assert_eq!(written(&scene), 0);
    // What goes or comes shifts what lies behind it, and nothing else.
    scene.remove(handles[10]).unwrap();
    assert_eq!(written(&scene), 90);
    let ball = dag(&bumpy_sphere(9));
    scene.add(Arc::clone(&ball), &at(0.0, -1.0, -1.0), Material::default()).unwrap();
    assert!(written(&scene) <= 90);
    scene.add(ball, &at(0.0, 1.0, -1.0), Material::default()).unwrap();
    assert_eq!(written(&scene), 1);
    let all = all + 1;
    // A copy is another scene.
    let mut copy = scene.clone();
    copy.set_pose(handles[5], &at(0.5, 0.5, 0.0)).unwrap();
    assert_eq!(written(&copy), all);
    assert_eq!(written(&scene), all);
    assert_eq!(written(&Scene::new()), 0);
    assert_eq!(written(&scene), all);
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

#[test]
fn a_lost_device_is_an_error_and_another_one_serves() {
    let test = "a_lost_device_is_an_error_and_another_one_serves";
    let Some(context) = device(test) else { return };
    if !alone(&format!("gpu_parity::{test}")) {
        return;
    }
    let (scene, pose, size) = (crowd(), at(0.0, 0.0, 6.0), (64, 48));
    let mut renderer = Renderer::new(size.0, size.1, "gpu").unwrap();
    renderer.render(&scene, &CAMERA, &pose, &options(1.0)).unwrap();
    context.lose();
    for _ in 0..2 {
        let error = renderer.render(&scene, &CAMERA, &pose, &options(1.0)).unwrap_err();
        assert!(matches!(&error, Error::Backend { backend, .. } if backend == "gpu"), "{error:?}");
        assert!(error.to_string().contains("the device was lost"), "{error}");
    }
    equal(&scene, &CAMERA, &pose, size, 1.0);
}

#[test]
fn lack_of_memory_is_an_error_that_leaves_the_device_in_use() {
    let test = "lack_of_memory_is_an_error_that_leaves_the_device_in_use";
    let Some(context) = device(test) else { return };
    if !alone(&format!("gpu_parity::{test}")) {
        return;
    }
    let meshes = [dag(&bumpy_sphere(30)), dag(&torus(60, 30))];
    let fine = dag(&bumpy_sphere(120));
    let mut scene = lit();
    for k in 0..6000 {
        let (x, y, z) = (f64::from(k % 20), f64::from(k / 20 % 15), f64::from(k / 300));
        let pose = at(x * 2.5 - 25.0, y * 2.5 - 18.75, -2.5 * z);
        scene.add(Arc::clone(&meshes[k as usize % 2]), &pose, Material::default()).unwrap();
    }
    let [mut renderer, mut large] =
        [(160, 120), (1280, 1024)].map(|(width, height)| Renderer::new(width, height, "gpu").unwrap());
    let (near, far) = (at(0.0, 0.0, 6.0), at(0.0, 0.0, 40.0));
    let all = RenderOptions { occlusion: false, ..options(0.0) };
    let expected = shoot(&scene, &CAMERA, &near, (160, 120), &options(0.1));
    let lacks = |frame: Result<Frame, Error>, what: &str| {
        let error = frame.unwrap_err();
        assert!(matches!(&error, Error::Backend { backend, .. } if backend == "gpu"), "{error:?}");
        let text = error.to_string();
        assert!(text.contains(&format!("{} is out of memory: {what} take ", context.name())), "{text}");
        assert!(text.ends_with(" MiB"), "{text}");
    };
    // Enough for what is near, the meshes and the instances.
    renderer.render(&scene, &CAMERA, &near, &options(0.1)).unwrap();
    large.render(&lit(), &CAMERA, &near, &options(0.1)).unwrap();
    context.limit_memory(1 << 20);
    for _ in 0..2 {
        // Too many pixels; too many instances; too many visible clusters; too large a mesh.
        lacks(large.render(&scene, &CAMERA, &near, &options(0.1)), "the instances of the scene");
        let mut small = lit();
        small.add(Arc::clone(&meshes[0]), &IDENTITY, Material::default()).unwrap();
        lacks(large.render(&small, &CAMERA, &near, &options(0.1)), "the pixels of the picture");
        lacks(renderer.render(&scene, &CAMERA, &far, &all), "visible clusters");
        let added = scene.add(Arc::clone(&fine), &IDENTITY, Material::default()).unwrap();
        lacks(renderer.render(&scene, &CAMERA, &near, &options(0.1)), "the clusters of the meshes");
        scene.remove(added).unwrap();
        let frame = renderer.render(&scene, &CAMERA, &near, &options(0.1)).unwrap();
        assert!(frame.words().unwrap() == expected.words().unwrap());
    }
    assert!(Arc::ptr_eq(&Context::shared().unwrap(), &context));
}

#[test]
fn of_coincident_surfaces_the_first_shows() {
    let Some(_) = device("of_coincident_surfaces_the_first_shows") else { return };
    let ball = dag(&bumpy_sphere(40));
    let mut scene = lit();
    let first = scene.add(Arc::clone(&ball), &IDENTITY, Material::default()).unwrap();
    let second = scene.add(ball, &IDENTITY, Material::default()).unwrap();
    for _ in 0..3 {
        let ids =
            on_device(&scene, &CAMERA, &at(0.0, 0.0, 3.0), (320, 240), &options(0.0)).instance_ids().unwrap();
        assert!(ids.contains(&(first.0.index as i32)));
        assert!(ids.iter().all(|&i| i != second.0.index as i32));
    }
}

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

#[test]
fn clipped_triangles_are_equal() {
    let Some(_) = device("clipped_triangles_are_equal") else { return };
    let scene = crowd();
    let room = room();
    let views = [
        (&scene, at(0.3, 0.2, 1.8)),
        (&scene, at(0.0, 0.0, 0.9)),
        (&room, at(0.1, 0.0, 0.2)),
        (&room, at(20.0, 1.3, -7.0)),
        (&room, at(0.65, -0.9, 3.9)),
    ];
    let mut clipped = 0;
    for (scene, pose) in views {
        let (frame, hardware) = compared(scene, &CAMERA, &pose, (639, 361), 0.5);
        assert!(frame.stats.drawn_large > 20, "{}", frame.stats.drawn_large);
        clipped += frame.stats.drawn_large - hardware.map_or(0, |[hybrid, _]| hybrid);
    }
    // They are not for the device's rasterizer.
    assert!(clipped > 50, "{clipped}");
}

/// Received and passed of a stage in a pass.
fn funnel(frame: &Frame, stage: Stage, pass: u8) -> (u64, u64) {
    let found = frame.stats.stages.iter().find(|s| s.stage == stage && s.pass == pass);
    found.map_or((0, 0), |s| (s.received, s.passed))
}

#[test]
fn any_view_of_any_poses_is_equal() {
    let Some(_) = device("any_view_of_any_poses_is_equal") else { return };
    let (mut covered, mut drawn) = (0, [0; 2]);
    for AnyView { scene, camera, pose, picture, options } in any_views(80) {
        let (frame, hardware) = compared(&scene, &camera, &pose, picture, options.pixel_error);
        covered += frame.stats.covered_pixels;
        let more = hardware.unwrap_or([u64::from(u32::MAX); 2]);
        drawn.iter_mut().zip(more).for_each(|(n, more)| *n += more);
    }
    assert!(covered > 60_000 && drawn.iter().all(|&n| n > 1000), "{covered} {drawn:?}");
}

#[test]
fn more_than_an_array_holds_is_split() {
    let Some(device) = device("more_than_an_array_holds_is_split") else { return };
    let ball = dag(&bumpy_sphere(180));
    // As many copies as take one and a half arrays.
    let bytes = 4 * ball.pages.word_count();
    let copies = (3 << device.array_bits()) * 2 / bytes + 1;
    if copies > 40 {
        return skip(
            "more_than_an_array_holds_is_split",
            "an array of the device holds more than a test should take",
        );
    }
    let mut scene = lit();
    for k in 0..copies {
        let copy = Arc::new(Dag::clone(&ball));
        let pose = at(2.4 * (k % 4) as f64 - 3.6, 2.4 * (k / 4) as f64 - 3.6, 0.0);
        scene.add(copy, &pose, Material::default()).unwrap();
    }
    for (distance, tau) in [(14.0, 1.0), (2.5, 0.0)] {
        equal(&scene, &CAMERA, &at(0.3, 0.2, distance), (320, 200), tau);
    }
}

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
