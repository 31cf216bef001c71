//! Frames of one view: every list, count and bit of the picture.

use std::sync::Arc;

use nanite_rs::config::RenderOptions;
use nanite_rs::render::Renderer;
use nanite_rs::scene::Material;

use super::{PARALLEL, compared, counts, device, differences, equal, on_device, options, room, scaled};
use crate::render_frames::{AnyView, CAMERA, IDENTITY, any_views, at, crowd, dag, lit, turned};
use crate::shapes::{bumpy_sphere, grid, torus};

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
