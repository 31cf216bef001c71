//! The forms of the rasterizers against each other: what the device's own draws, alone or beside compute, covers the same
//! pixels as compute does, and shows the same but for ties and rounding.

use std::process::Command;
use std::sync::Arc;

use nanite_rs::config::{Raster, RenderOptions};
use nanite_rs::gpu::Context;
use nanite_rs::render::{Frame, Renderer};
use nanite_rs::scene::{Camera, Material, Scene};

use crate::gpu_parity::{PARALLEL, counts, device, identities, on_device, options, room, scaled, skip};
use crate::render_frames::{
    AnyView, CAMERA, IDENTITY, Pose, any_views, at, city, crowd, dag, lit, shoot, turned,
};
use crate::shapes::{bumpy_sphere, cube, grid};

/// Pixels in so many may show something else.
const OTHERS: u64 = 2000;
/// Of those that show the same, by how much depths may differ, units in the last place. On lavapipe none does; drivers
/// may fuse other operations in fragment shaders than in compute.
const ULPS: u32 = 4;

/// The device, where its rasterizer can be used: that of lavapipe can, others may cover other pixels.
pub fn rasterizer(test: &str) -> Option<Arc<Context>> {
    let device = device(test)?;
    if let Some(obstacle) = device.raster_obstacle() {
        skip(test, obstacle);
        return None;
    }
    if !is_lavapipe(&device) {
        let automatic = RenderOptions { raster: Raster::Auto, ..options(1.0) };
        on_device(&crowd(), &CAMERA, &at(0.0, 0.0, 6.0), (64, 48), &automatic);
        let found = device.calibration().unwrap();
        if found.times.iter().all(|(form, _)| *form != Raster::Hardware) {
            skip(test, &found.reason);
            return None;
        }
    }
    Some(device)
}

fn is_lavapipe(device: &Context) -> bool {
    device.name().starts_with("llvmpipe")
}

/// Pixels that show something else, after everything else was found to agree.
pub fn agree(frame: &Frame, compute: &Frame, form: Raster) -> u64 {
    assert_eq!((frame.stats.raster, compute.stats.raster), (form, Raster::Compute));
    let (words, expected) = (frame.words().unwrap(), compute.words().unwrap());
    let pixels = || words.iter().zip(expected).enumerate();
    let holes = pixels().filter(|(_, (a, b))| (**a == 0) != (**b == 0)).count();
    assert_eq!(holes, 0, "{form:?}: pixels are covered otherwise");
    let (ids, expected_ids) = (identities(frame), identities(compute));
    let others = (0..ids.len()).filter(|&i| ids[i] != expected_ids[i]).count() as u64;
    let key = |word: u64| (word >> 32) as u32;
    let off =
        pixels().filter(|(i, _)| ids[*i] == expected_ids[*i]).map(|(_, (a, b))| key(*a).abs_diff(key(*b)));
    assert!(off.max().unwrap_or(0) <= ULPS, "{form:?}: other depths");
    assert!(others * OTHERS <= words.len() as u64, "{form:?}: {others} of {} pixels", words.len());
    others
}

const FORMS: [Raster; 2] = [Raster::Hybrid, Raster::Hardware];

/// Draws a view by every form, with and without 64-bit atomics; returns the frame in compute.
fn forms(scene: &Scene, camera: &Camera, pose: &Pose, size: (u32, u32), tau: f32) -> Frame {
    let compute = on_device(scene, camera, pose, size, &options(tau));
    for raster in FORMS {
        for wide_atomics in [true, false] {
            let options = RenderOptions { raster, wide_atomics, ..options(tau) };
            let frame = on_device(scene, camera, pose, size, &options);
            agree(&frame, &compute, raster);
            assert_eq!(counts(&frame), counts(&compute));
            assert!(frame.visible() == compute.visible());
        }
    }
    compute
}

#[test]
fn forms_agree_from_tiny_to_huge_triangles() {
    let Some(_) = rasterizer("forms_agree_from_tiny_to_huge_triangles") else { return };
    let (crowd, room) = (crowd(), room());
    let mut drawn = [0; 2];
    for (scene, camera, pose, tau) in [
        (&crowd, &CAMERA, at(0.0, 0.0, 6.0), 1.0),
        (&crowd, &CAMERA, at(-1.0, 0.0, 30.0), 0.0),
        // Through the near plane, and close by.
        (&crowd, &CAMERA, at(0.3, 0.2, 1.8), 0.5),
        (&crowd, &CAMERA, at(0.0, 0.0, 0.9), 0.0),
        (&crowd, &PARALLEL, at(0.0, 0.0, 4.0), 0.0),
        (&room, &CAMERA, at(0.1, 0.0, 0.2), 0.5),
        (&room, &CAMERA, at(20.0, 1.3, -7.0), 0.5),
        (&room, &PARALLEL, at(0.65, -0.9, 3.9), 0.5),
    ] {
        let frame = forms(scene, camera, &pose, (639, 361), tau);
        drawn[0] += frame.stats.drawn_small;
        drawn[1] += frame.stats.drawn_large;
    }
    assert!(drawn.iter().all(|&n| n > 4000), "{drawn:?}");
    for size in [(1, 1), (1, 7), (13, 1), (257, 3), (1023, 511)] {
        forms(&crowd, &CAMERA, &at(0.0, 0.0, 3.0), size, 1.0);
    }
}

#[test]
fn forms_agree_on_any_view_of_any_poses() {
    let Some(_) = rasterizer("forms_agree_on_any_view_of_any_poses") else { return };
    let (mut covered, mut others) = (0, 0);
    for AnyView { scene, camera, pose, picture, options } in any_views(48) {
        let of = |raster| RenderOptions { raster, occlusion: false, ..options.clone() };
        let compute = on_device(&scene, &camera, &pose, picture, &of(Raster::Compute));
        for raster in FORMS {
            others += agree(&on_device(&scene, &camera, &pose, picture, &of(raster)), &compute, raster);
        }
        covered += compute.stats.covered_pixels;
    }
    println!("{others} of {covered} pixels show something else");
    assert!(covered > 30_000, "{covered}");
}

#[test]
fn forms_agree_on_large_pictures() {
    let Some(_) = rasterizer("forms_agree_on_large_pictures") else { return };
    // Snapped corners far from the middle of the picture, and clusters that leave the viewport of the rasterizer.
    let mut scene = lit();
    let both_sides = Material { double_sided: true, ..Material::default() };
    scene
        .add(
            dag(&grid(24, |x, y| 0.02 * (5.0 * x).sin() * y)),
            &scaled(at(-2.0, -2.0, -1.0), 4.0),
            both_sides,
        )
        .unwrap();
    let mut drawn = [0; 2];
    for size in [(4095, 65), (33, 4096)] {
        for distance in [-0.8, 1.0] {
            let frame = forms(&scene, &CAMERA, &at(0.1, 0.2, distance), size, 0.0);
            assert!(frame.stats.covered_pixels > 1000);
            drawn[0] += frame.stats.drawn_small;
            drawn[1] += frame.stats.drawn_large;
        }
    }
    assert!(drawn.iter().all(|&n| n > 100), "{drawn:?}");
}

#[test]
fn closed_meshes_have_no_hole_where_forms_meet() {
    let Some(_) = rasterizer("closed_meshes_have_no_hole_where_forms_meet") else { return };
    // From inside, near a wall: clusters from those that cross the near plane to those of small triangles.
    let (ball, house) = (dag(&bumpy_sphere(90)), dag(&cube(60)));
    let look = Material { double_sided: true, ..Material::default() };
    let size = (640, 400);
    let mut drawn = [0; 2];
    for (mesh, pose, near) in [
        (&ball, at(0.9, 0.1, 0.2), 0.01),
        (&ball, at(0.0, 0.0, -0.6), 0.3),
        (&house, turned(at(0.95, 0.9, 0.9), 0.7), 0.02),
        (&house, turned(at(-0.97, 0.0, 0.3), 0.1), 0.02),
    ] {
        let mut scene = lit();
        scene.add(Arc::clone(mesh), &IDENTITY, look.clone()).unwrap();
        let camera = Camera { znear: near, ..CAMERA };
        for tau in [0.0, 1.0] {
            let expected = shoot(&scene, &camera, &pose, size, &options(tau));
            assert_eq!(expected.stats.covered_pixels, u64::from(size.0 * size.1));
            for raster in FORMS {
                let options = RenderOptions { raster, ..options(tau) };
                let frame = on_device(&scene, &camera, &pose, size, &options);
                assert_eq!(frame.stats.covered_pixels, expected.stats.covered_pixels, "{raster:?} {pose:?}");
                agree(&frame, &expected, raster);
            }
            drawn[0] += expected.stats.drawn_small;
            drawn[1] += expected.stats.drawn_large;
        }
    }
    assert!(drawn.iter().all(|&n| n > 1000), "all rasterizers take part: {drawn:?}");
}

#[test]
fn forms_agree_with_occlusion() {
    let Some(_) = rasterizer("forms_agree_with_occlusion") else { return };
    let scene = city(24);
    let size = (317, 203);
    let mut renderers = [(); 3].map(|()| Renderer::new(size.0, size.1, "gpu").unwrap());
    let mut hidden = 0;
    let mut path: Vec<Pose> = (0..4).map(|k| at(1.5, 1.7, 6.0 - 0.7 * f64::from(k))).collect();
    path.extend((1..4).map(|k| turned(at(1.5, 1.7, 2.5), 0.35 * f64::from(k))));
    path.extend([at(40.5, 1.7, -20.0), at(30.0, 40.0, 50.0)]);
    for (k, pose) in path.iter().enumerate() {
        let compute = renderers[0].render(&scene, &CAMERA, pose, &options(0.0)).unwrap();
        for (renderer, raster) in renderers[1..].iter_mut().zip(FORMS) {
            // Every other frame by 32-bit atomics.
            let options = RenderOptions { raster, occlusion: true, wide_atomics: k % 2 == 0, ..options(0.0) };
            let frame = renderer.render(&scene, &CAMERA, pose, &options).unwrap();
            agree(&frame, &compute, raster);
            hidden += frame.stats.occluded_instances + frame.stats.occluded_clusters;
        }
    }
    assert!(hidden > 1000, "{hidden}");
}

/// Set in the process that looks at a device nobody has drawn with.
const FRESH: &str = "NANITE_FRESH_DEVICE";

#[test]
fn the_form_is_measured_when_it_is_first_asked_for() {
    let test = "the_form_is_measured_when_it_is_first_asked_for";
    let Some(context) = device(test) else { return };
    if std::env::var_os(FRESH).is_none() {
        // Tests share the device, so this one takes a process of its own.
        let arguments = ["--exact", &format!("gpu_raster::{test}"), "--nocapture"];
        let me = std::env::current_exe().unwrap();
        let done = Command::new(me).args(arguments).env(FRESH, "1").output().unwrap();
        let (out, err) = (String::from_utf8_lossy(&done.stdout), String::from_utf8_lossy(&done.stderr));
        assert!(done.status.success() && out.contains("1 passed"), "{out}\n{err}");
        print!("{}", out.lines().filter(|line| line.contains(" ms")).collect::<String>());
        return;
    }
    let (scene, pose) = (crowd(), at(0.0, 0.0, 6.0));
    let mut renderer = Renderer::new(320, 200, "gpu").unwrap();
    let automatic = RenderOptions { raster: Raster::Auto, ..options(1.0) };
    let compute = renderer.render(&scene, &CAMERA, &pose, &options(1.0)).unwrap();
    let nothing = renderer.render(&Scene::new(), &CAMERA, &pose, &automatic).unwrap();
    assert_eq!(nothing.stats.raster, Raster::Compute);
    assert_eq!(renderer.calibration(), None);
    let start = std::time::Instant::now();
    let frame = renderer.render(&scene, &CAMERA, &pose, &automatic).unwrap();
    let found = renderer.calibration().unwrap().clone();
    println!("{} ms, {found:?}", start.elapsed().as_millis());
    assert_eq!(frame.stats.raster, found.raster);
    assert!(!found.reason.is_empty());
    assert!(found.times.iter().all(|(form, ms)| *form != Raster::Auto && *ms > 0.0));
    assert!(found.raster == Raster::Compute || found.times.iter().any(|(form, _)| *form == found.raster));
    if found.raster == Raster::Compute {
        assert!(frame.words().unwrap() == compute.words().unwrap());
    } else {
        agree(&frame, &compute, found.raster);
    }
    if is_lavapipe(&context) {
        // It covers what we cover, so that all three forms were allowed.
        assert_eq!(
            found.times.iter().map(|(form, _)| *form).collect::<Vec<_>>(),
            [Raster::Compute, Raster::Hybrid, Raster::Hardware]
        );
    }
    // Once for a device.
    let again = renderer.render(&scene, &CAMERA, &pose, &automatic).unwrap();
    assert!(again.words().unwrap() == frame.words().unwrap());
    assert_eq!(Renderer::new(8, 8, "gpu").unwrap().calibration(), Some(&found));
}

#[test]
fn the_cpu_has_one_form() {
    let scene = crowd();
    let draw = |raster: &str| {
        let options = RenderOptions { raster: raster.parse().unwrap(), ..options(1.0) };
        shoot(&scene, &CAMERA, &at(0.0, 0.0, 6.0), (160, 120), &options)
    };
    let compute = draw("compute");
    for raster in ["auto", "hybrid", "hardware"] {
        let frame = draw(raster);
        assert_eq!(frame.stats.raster.name(), "compute");
        assert!(frame.words().unwrap() == compute.words().unwrap());
    }
    let error = "fast".parse::<Raster>().unwrap_err().to_string();
    assert!(error.contains("\"auto\", \"compute\", \"hybrid\" or \"hardware\", not \"fast\""), "{error}");
}
