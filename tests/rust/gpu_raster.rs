//! The forms of the rasterizers against each other: what the device's own draws, alone or beside compute, covers the same
//! pixels as compute does, and shows the same but for ties and rounding.

use std::process::Command;
use std::sync::Arc;

use nanite_rs::config::{Raster, RenderOptions};
use nanite_rs::gpu::Context;
use nanite_rs::render::{Frame, Renderer};
use nanite_rs::scene::{Camera, Material, Scene};

use crate::gpu_parity::{compared, counts, device, identities, on_device, options, scaled, skip};
use crate::render_frames::{CAMERA, IDENTITY, Pose, at, city, crowd, dag, lit, shoot, turned};
use crate::shapes::{bumpy_sphere, cube, grid};

/// Pixels in so many may show something else.
const OTHERS: u64 = 2000;
/// Of those that show the same, by how much depths may differ, units in the last place. On lavapipe none does; drivers
/// may fuse other operations in fragment shaders than in compute.
const ULPS: u32 = 4;

/// Why forms cannot be compared on a device, if they cannot: that of lavapipe covers what we cover, others may not.
fn obstacle(device: &Context) -> Option<String> {
    if device.raster_obstacle().is_some() || is_lavapipe(device) {
        return device.raster_obstacle().map(str::to_owned);
    }
    let measured = RenderOptions { raster: Raster::Measured, ..options(1.0) };
    on_device(&crowd(), &CAMERA, &at(0.0, 0.0, 6.0), (64, 48), &measured);
    let found = device.calibration().unwrap();
    let taken = found.times.iter().any(|(form, _)| *form == Raster::Hardware);
    (!taken).then(|| found.reason.clone())
}

/// The device, where its rasterizer can be used.
pub fn rasterizer(test: &str) -> Option<Arc<Context>> {
    let device = device(test)?;
    match obstacle(&device) {
        Some(obstacle) => {
            skip(test, &obstacle);
            None
        }
        None => Some(device),
    }
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

pub const FORMS: [Raster; 2] = [Raster::Hybrid, Raster::Hardware];

/// Triangles that the device's own rasterizer drew of a view, in hybrid form and in hardware form.
pub type Hardware = [u64; 2];

/// Draws a view by the other forms, with and without 64-bit atomics, and compares with compute; none where the device's
/// rasterizer cannot be compared.
pub fn other_forms(
    scene: &Scene,
    camera: &Camera,
    pose: &Pose,
    options: &RenderOptions,
    compute: &Frame,
) -> Option<Hardware> {
    if obstacle(&Context::shared().unwrap()).is_some() {
        return None;
    }
    assert_eq!(compute.stats.drawn_hardware, 0);
    let size = (compute.width(), compute.height());
    let mut hardware = [0; 2];
    for (raster, drawn) in FORMS.into_iter().zip(&mut hardware) {
        for int64_atomics in [true, false] {
            let options = RenderOptions { raster, int64_atomics, ..options.clone() };
            let frame = on_device(scene, camera, pose, size, &options);
            agree(&frame, compute, raster);
            assert_eq!(counts(&frame), counts(compute));
            assert!(frame.visible() == compute.visible());
            *drawn = frame.stats.drawn_hardware;
        }
    }
    // Large triangles are its part in both forms but for those that have to be clipped; small ones in one form.
    assert!(hardware[0] <= compute.stats.drawn_large);
    assert_eq!(hardware[1], hardware[0] + compute.stats.drawn_small);
    Some(hardware)
}

#[test]
fn forms_agree_on_large_pictures() {
    let Some(_) = device("forms_agree_on_large_pictures") else { return };
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
    // Small ones and large ones; by the device's rasterizer in hybrid form and in hardware form.
    let mut drawn = [0; 4];
    for (size, distance) in [(4095, 65), (33, 4096)].into_iter().flat_map(|size| [(size, -0.8), (size, 1.0)])
    {
        let (frame, hardware) = compared(&scene, &CAMERA, &at(0.1, 0.2, distance), size, 0.0);
        assert!(frame.stats.covered_pixels > 1000);
        let [hybrid, all] = hardware.unwrap_or([u64::from(u32::MAX); 2]);
        let more = [frame.stats.drawn_small, frame.stats.drawn_large, hybrid, all];
        drawn.iter_mut().zip(more).for_each(|(n, more)| *n += more);
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
    let mut drawn = [0; 3];
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
                // By compute, small ones and large ones; by the device's rasterizer.
                let (small, large) = (frame.stats.drawn_small, frame.stats.drawn_large);
                let hardware = frame.stats.drawn_hardware;
                let in_compute = match raster {
                    Raster::Hybrid => [small, large - hardware],
                    _ => [0, small + large - hardware],
                };
                drawn
                    .iter_mut()
                    .zip([in_compute[0], in_compute[1], hardware])
                    .for_each(|(n, more)| *n += more);
            }
        }
    }
    assert!(drawn.iter().all(|&n| n > 100), "all rasterizers take part: {drawn:?}");
}

#[test]
fn forms_agree_with_occlusion() {
    let Some(_) = rasterizer("forms_agree_with_occlusion") else { return };
    let scene = city(24);
    let size = (317, 203);
    let mut renderers = [(); 3].map(|()| Renderer::new(size.0, size.1, "gpu").unwrap());
    let (mut hidden, mut hardware) = (0, [0; 2]);
    let mut path: Vec<Pose> = (0..4).map(|k| at(1.5, 1.7, 6.0 - 0.7 * f64::from(k))).collect();
    path.extend((1..4).map(|k| turned(at(1.5, 1.7, 2.5), 0.35 * f64::from(k))));
    path.extend([at(40.5, 1.7, -20.0), at(30.0, 40.0, 50.0)]);
    for (k, pose) in path.iter().enumerate() {
        let compute = renderers[0].render(&scene, &CAMERA, pose, &options(0.0)).unwrap();
        for ((renderer, raster), drawn) in renderers[1..].iter_mut().zip(FORMS).zip(&mut hardware) {
            // Every other frame by 32-bit atomics.
            let options =
                RenderOptions { raster, occlusion: true, int64_atomics: k % 2 == 0, ..options(0.0) };
            let frame = renderer.render(&scene, &CAMERA, pose, &options).unwrap();
            agree(&frame, &compute, raster);
            hidden += frame.stats.occluded_instances + frame.stats.occluded_clusters;
            *drawn += frame.stats.drawn_hardware;
        }
    }
    assert!(hidden > 1000 && hardware.iter().all(|&n| n > 1000), "{hidden} {hardware:?}");
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
    let measured = RenderOptions { raster: Raster::Measured, ..options(1.0) };
    let compute = renderer.render(&scene, &CAMERA, &pose, &options(1.0)).unwrap();
    let nothing = renderer.render(&Scene::new(), &CAMERA, &pose, &measured).unwrap();
    assert_eq!(nothing.stats.raster, Raster::Compute);
    assert_eq!(renderer.calibration(), None);
    let start = std::time::Instant::now();
    let frame = renderer.render(&scene, &CAMERA, &pose, &measured).unwrap();
    let found = renderer.calibration().unwrap().clone();
    println!("{} ms, {found:?}", start.elapsed().as_millis());
    assert_eq!(frame.stats.raster, found.raster);
    assert!(!found.reason.is_empty());
    assert!(found.times.iter().all(|(form, ms)| *form != Raster::Measured && *ms > 0.0));
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
    let again = renderer.render(&scene, &CAMERA, &pose, &measured).unwrap();
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
    assert!(error.contains("\"hardware\" or \"measured\", not \"fast\""), "{error}");
}
