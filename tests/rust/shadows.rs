//! Shadows: pages that are kept are those that would be drawn now, whatever was edited meanwhile; and shadows are where
//! geometry says.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use nanite_rs::config::{Output, RenderOptions, Samples, Shadows};
use nanite_rs::model::{Dag, UNINTERRUPTED};
use nanite_rs::render::{Frame, Renderer, ShadowStats, ViewDesc};
use nanite_rs::scene::{Camera, Light, LightKind, Material, Projection, Scene};

use crate::render_frames::{CAMERA, IDENTITY, Pose, at, crowd, dag, shoot, turned};
use crate::shapes::{bumpy_sphere, grid, torus};
use crate::streaming::stored;

const SIZE: (u32, u32) = (160, 120);

fn options() -> RenderOptions {
    RenderOptions { shadows: Shadows::Virtual, ..RenderOptions::default() }
}

/// The same by cascades.
fn cascaded() -> RenderOptions {
    RenderOptions { shadows: Shadows::Cascaded, ..options() }
}

fn light(kind: LightKind, pose: DAffine3) -> Light {
    Light { kind, intensity: 3.0, pose, ..Light::default() }
}

/// Shines from `from` towards the middle.
fn towards(kind: LightKind, from: DVec3) -> Light {
    let axis = from.normalize();
    let (x, y) = axis.any_orthonormal_pair();
    light(kind, DAffine3 { matrix3: glam::DMat3::from_cols(x, y, axis), translation: from })
}

/// Radii of lights: sharp ones, and some as large as lamps and suns are.
pub const RADII: [f64; 2] = [0.0, 0.03];

/// A light of each kind, of a radius.
fn lights(radius: f64) -> [Light; 3] {
    let spot = LightKind::Spot { range: None, inner: 0.1, outer: 0.6 };
    let point = LightKind::Point { range: None };
    [
        towards(LightKind::Directional, DVec3::new(1.0, 2.0, 1.5)),
        towards(spot, DVec3::new(-6.0, 7.0, 5.0)),
        light(point, DAffine3::from_translation(DVec3::new(0.3, 2.2, 2.0))),
    ]
    .map(|light| Light { radius, ..light })
}

/// A flat square from −1 to 1.
fn square(n: usize) -> Arc<Dag> {
    let (mut positions, faces) = grid(n, |_, _| 0.0);
    positions.iter_mut().for_each(|[x, y, _]| (*x, *y) = (2.0 * *x - 1.0, 2.0 * *y - 1.0));
    dag(&(positions, faces))
}

/// The crowd on a floor, in its own sharp light and three of a radius.
pub fn lit_crowd(radius: f64) -> Scene {
    let mut scene = crowd();
    let floor = square(8);
    // Seen from above: x across, z down.
    let rows = [[20.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -4.0], [0.0, -20.0, 0.0, -4.0], [0.0, 0.0, 0.0, 1.0]];
    scene.add(floor, &rows, Material { double_sided: true, ..Material::default() }).unwrap();
    for light in lights(radius) {
        scene.add_light(light).unwrap();
    }
    scene
}

fn shadow_stats(frame: &Frame) -> &ShadowStats {
    frame.stats.shadows.as_ref().unwrap()
}

/// A first frame.
fn picture(
    backend: &str,
    scene: &Scene,
    camera: &Camera,
    pose: &Pose,
    size: (u32, u32),
    options: &RenderOptions,
) -> Frame {
    let mut renderer = Renderer::new(size.0, size.1, backend).unwrap();
    renderer.render(scene, camera, pose, options).unwrap()
}

/// Everything that shadows decide, bit for bit.
fn same_shadows(a: &Frame, b: &Frame) {
    assert!(a.shadow().unwrap() == b.shadow().unwrap(), "shadows");
    assert!(a.color().unwrap() == b.color().unwrap(), "colours");
}

/// Some light reaches some pixels, and some not.
fn shows_both(frame: &Frame, lights: usize) {
    let shadow = frame.shadow().unwrap();
    for light in 0..lights {
        let lit = shadow.iter().skip(light).step_by(lights).filter(|lit| **lit == 1.0).count();
        let dark = shadow.len() / lights - lit;
        assert!(lit > 100 && dark > 100, "light {light}: {lit} lit, {dark} dark");
    }
}

#[test]
fn kept_pages_are_those_that_would_be_drawn_now() {
    RADII.iter().for_each(|radius| keeps_what_would_be_drawn_now("cpu", *radius));
}

fn keeps_what_would_be_drawn_now(backend: &str, radius: f64) {
    let mut scene = lit_crowd(radius);
    let options = options();
    let mut kept = Renderer::new(SIZE.0, SIZE.1, backend).unwrap();
    let poses: Vec<Pose> =
        (0..4).map(|k| turned(at(0.3 * f64::from(k), 1.0, 9.0), 0.03 * f64::from(k))).collect();
    let handles: Vec<_> = scene.instances().handles().map(nanite_rs::scene::InstanceHandle).collect();
    let ball = Arc::clone(&scene.instance(handles[0]).unwrap().mesh);
    let (mut wanted, mut drawn) = (0, 0);
    let mut check = |scene: &Scene, pose: &Pose| {
        let frame = kept.render(scene, &CAMERA, pose, &options).unwrap();
        let fresh = picture(backend, scene, &CAMERA, pose, SIZE, &options);
        assert_eq!(shadow_stats(&frame).wanted, shadow_stats(&fresh).wanted);
        assert_eq!(shadow_stats(&fresh).drawn, shadow_stats(&fresh).wanted);
        (wanted, drawn) = (wanted + shadow_stats(&frame).wanted, drawn + shadow_stats(&frame).drawn);
        same_shadows(&frame, &fresh);
        shadow_stats(&frame).clone()
    };
    for pose in poses.iter().chain(&poses) {
        check(&scene, pose);
    }
    // Nothing changed: nothing is drawn.
    assert_eq!(check(&scene, &poses[3]).drawn, 0);
    let first = scene.instance(handles[7]).unwrap().pose().translation;
    for (step, pose) in (0..).zip(poses.iter().cycle().take(12)) {
        match step % 6 {
            0 => scene
                .set_pose(handles[7], &at(first.x + 0.1 * f64::from(step), first.y + 0.3, first.z))
                .unwrap(),
            1 => scene.set_visible(handles[12], step > 6).unwrap(),
            2 => drop(scene.add(Arc::clone(&ball), &at(0.5, 0.0, 4.0), Material::default()).unwrap()),
            3 => scene.set_shadows(handles[20], step > 6, step <= 6).unwrap(),
            4 => {
                let newest = scene.instances().handles().max_by_key(|handle| handle.generation).unwrap();
                drop(scene.remove(nanite_rs::scene::InstanceHandle(newest)).unwrap());
            }
            // A colour is no shape.
            _ => {
                let red = Material { base_color: [1.0, 0.0, 0.0], ..Material::default() };
                scene.set_material(handles[3], red).unwrap();
            }
        }
        let stats = check(&scene, pose);
        assert!(stats.drawn < stats.wanted, "step {step} drew everything anew");
    }
    assert!(2 * drawn < wanted, "{drawn} of {wanted} pages were drawn");
}

#[test]
fn lights_that_move_come_and_go_have_new_pages() {
    RADII.iter().for_each(|radius| light_moves_comes_and_goes("cpu", *radius));
}

fn light_moves_comes_and_goes(backend: &str, radius: f64) {
    let mut scene = lit_crowd(radius);
    let options = options();
    let pose = at(0.0, 1.0, 9.0);
    let mut kept = Renderer::new(SIZE.0, SIZE.1, backend).unwrap();
    let mut check = |scene: &Scene| {
        let frame = kept.render(scene, &CAMERA, &pose, &options).unwrap();
        same_shadows(&frame, &picture(backend, scene, &CAMERA, &pose, SIZE, &options));
        let stats = shadow_stats(&frame);
        (stats.drawn, stats.wanted)
    };
    check(&scene);
    let handles: Vec<_> = scene.lights().handles().map(nanite_rs::scene::LightHandle).collect();
    for step in 1..4 {
        let turn = DAffine3::from_rotation_y(0.1 * f64::from(step));
        let light = scene.light(handles[1 + step as usize % 3]).unwrap();
        scene.set_light(handles[1 + step as usize % 3], Light { pose: turn * light.pose, ..*light }).unwrap();
        let (drawn, wanted) = check(&scene);
        assert!(0 < drawn && drawn < wanted, "{drawn} of {wanted}");
    }
    // Brightness is no place.
    let light = *scene.light(handles[2]).unwrap();
    scene.set_light(handles[2], Light { intensity: 9.0, ..light }).unwrap();
    assert_eq!(check(&scene).0, 0);
    scene.remove_light(handles[2]).unwrap();
    assert_eq!(check(&scene).0, 0);
    // In the slot of the one before.
    scene.add_light(towards(LightKind::Directional, DVec3::new(-1.0, 1.0, 0.5))).unwrap();
    let (drawn, wanted) = check(&scene);
    assert!(0 < drawn && drawn < wanted, "{drawn} of {wanted}");
}

#[test]
fn every_camera_and_number_of_samples_finds_its_pages() {
    for radius in RADII {
        finds_its_pages(radius, &options());
        finds_its_pages(radius, &cascaded());
    }
}

fn finds_its_pages(radius: f64, options: &RenderOptions) {
    // Whatever is looked up was marked, or a debug assertion fails; with all thresholds, and far from the origin.
    let far = DVec3::new(3.0e6, -2.0e5, 1.0e6);
    let parallel = Projection::Orthographic { xmag: None, ymag: 4.0 };
    let telephoto = Projection::Perspective { yfov: 0.03, aspect: None };
    let wide = Projection::Perspective { yfov: 2.2, aspect: None };
    for (projection, distance) in
        [(CAMERA.projection, 9.0), (parallel, 30.0), (telephoto, 300.0), (wide, 6.0)]
    {
        let camera = Camera { projection, znear: 0.05, zfar: None };
        let mut pictures = Vec::new();
        for origin in [DVec3::ZERO, far] {
            let mut scene = Scene::new();
            for (_, instance) in lit_crowd(radius).instances().iter() {
                let pose = DAffine3::from_translation(origin) * *instance.pose();
                let rows = nanite_rs::scene::pose::rows(&pose);
                scene.add(Arc::clone(&instance.mesh), &rows, instance.materials.clone()).unwrap();
            }
            for light in lights(radius) {
                let pose = DAffine3::from_translation(origin) * light.pose;
                scene.add_light(Light { pose, ..light }).unwrap();
            }
            let pose = at(origin.x, origin.y + 1.0, origin.z + distance);
            for pixel_error in [0.0, 0.3, 1.0, 5.0] {
                let options = RenderOptions { pixel_error, ..options.clone() };
                let frame = shoot(&scene, &camera, &pose, (97, 61), &options);
                shows_both(&frame, 3);
                if pixel_error == 1.0 {
                    pictures.push(frame.shadow().unwrap());
                }
            }
            // Receivers that may be pages away from where they are seen.
            let coarse = RenderOptions { pixel_error: 300.0, ..options.clone() };
            assert!(shoot(&scene, &camera, &pose, (97, 61), &coarse).shadow().is_ok());
            let options = RenderOptions { samples: Samples::Four, ..options.clone() };
            let smooth = shoot(&scene, &camera, &pose, (97, 61), &options);
            assert!(smooth.color().is_ok());
        }
        let differing = pictures[0].iter().zip(&pictures[1]).filter(|(a, b)| (**a - **b).abs() > 0.2).count();
        assert!(30 * differing < pictures[0].len(), "{differing} of {}", pictures[0].len());
    }
}

#[test]
fn without_room_shadows_are_coarser_and_stay_so() {
    RADII.iter().for_each(|radius| coarser_without_room("cpu", *radius));
}

fn coarser_without_room(backend: &str, radius: f64) {
    let scene = lit_crowd(radius);
    let pose = at(0.0, 1.0, 9.0);
    let whole = picture(backend, &scene, &CAMERA, &pose, SIZE, &options());
    let pages = shadow_stats(&whole).wanted;
    let room = pages / 2;
    let small = RenderOptions { shadow_memory: room << 16, ..options() };
    let mut renderer = Renderer::new(SIZE.0, SIZE.1, backend).unwrap();
    let frame = renderer.render(&scene, &CAMERA, &pose, &small).unwrap();
    let stats = shadow_stats(&frame);
    assert!(stats.coarser > 0 && stats.wanted <= room && stats.kept <= room, "{stats:?} of {pages}");
    shows_both(&frame, 4);
    let (fine, coarse) = (whole.shadow().unwrap(), frame.shadow().unwrap());
    let differing = fine.iter().zip(&coarse).filter(|(a, b)| (**a - **b).abs() > 0.2).count();
    assert!(0 < differing && 8 * differing < fine.len(), "{differing} of {}", fine.len());
    // The next frame draws nothing, and others make room for theirs.
    let again = renderer.render(&scene, &CAMERA, &pose, &small).unwrap();
    assert_eq!((shadow_stats(&again).drawn, shadow_stats(&again).evicted), (0, 0));
    same_shadows(&frame, &again);
    let evicted: u64 = (0..6)
        .map(|k| {
            let pose = turned(at(2.0 * f64::from(k), 1.0, 7.0), 0.2 * f64::from(k));
            let frame = renderer.render(&scene, &CAMERA, &pose, &small).unwrap();
            assert!(shadow_stats(&frame).kept <= room);
            same_shadows(&frame, &picture(backend, &scene, &CAMERA, &pose, SIZE, &small));
            shadow_stats(&frame).evicted
        })
        .sum();
    assert!(evicted > 0);
}

#[test]
fn views_of_a_call_share_pages() {
    views_share_pages("cpu");
}

fn views_share_pages(backend: &str) {
    let scene = lit_crowd(RADII[1]);
    let views = [at(0.0, 1.0, 9.0), at(0.03, 1.0, 9.0)];
    let alone = views.map(|pose| picture(backend, &scene, &CAMERA, &pose, SIZE, &options()));
    let descs: Vec<ViewDesc> = (0..).zip(views).map(|(id, pose)| ViewDesc::new(id, CAMERA, pose)).collect();
    let mut renderer = Renderer::new(SIZE.0, SIZE.1, backend).unwrap();
    let together = renderer.render_views(&scene, &descs, &options(), UNINTERRUPTED).unwrap();
    for (a, b) in together.iter().zip(&alone) {
        same_shadows(a, b);
    }
    let pages = |frames: &[Frame]| frames.iter().map(|frame| shadow_stats(frame).drawn).collect::<Vec<_>>();
    let (shared, own) = (pages(&together)[0], pages(&alone));
    assert!(5 * shared < 3 * (own[0] + own[1]), "{shared} instead of {own:?}");
}

#[test]
fn streamed_meshes_cast_the_shadows_of_whole_ones() {
    streamed_as_whole("cpu");
}

fn streamed_as_whole(backend: &str) {
    let meshes = [dag(&bumpy_sphere(70)), dag(&torus(90, 40))];
    let scene_of = |meshes: &[Arc<Dag>]| {
        let mut scene = Scene::new();
        for (k, mesh) in meshes.iter().enumerate() {
            scene
                .add(Arc::clone(mesh), &at(0.4 * k as f64, 1.6 * k as f64, 0.0), Material::default())
                .unwrap();
        }
        scene.add_light(towards(LightKind::Directional, DVec3::new(0.3, 2.0, 0.4))).unwrap();
        scene
    };
    let whole = scene_of(&meshes);
    let streamed = scene_of(&meshes.each_ref().map(|mesh| stored(mesh)));
    let mut renderer = Renderer::new(SIZE.0, SIZE.1, backend).unwrap();
    renderer.stream(Some(64 << 20));
    for distance in [20.0, 5.0, 4.0] {
        let pose = at(0.0, 0.5, distance);
        let frame = renderer.render(&streamed, &CAMERA, &pose, &options()).unwrap();
        same_shadows(&frame, &picture(backend, &whole, &CAMERA, &pose, SIZE, &options()));
    }
    // The same with what is there, until all is: what was drawn coarser is drawn again, and nothing else.
    let mut renderer = Renderer::new(SIZE.0, SIZE.1, backend).unwrap();
    renderer.stream(Some(64 << 20));
    let at_once = RenderOptions { wait: false, ..options() };
    let pose = at(0.0, 0.5, 4.0);
    let mut again = 0;
    for _ in 0..2_000 {
        let frame = renderer.render(&streamed, &CAMERA, &pose, &at_once).unwrap();
        let settled = frame.stats.stream.as_ref().unwrap().missing_pages == 0;
        again += shadow_stats(&frame).drawn;
        if settled && shadow_stats(&frame).drawn == 0 {
            same_shadows(&frame, &picture(backend, &whole, &CAMERA, &pose, SIZE, &options()));
            assert!(again > shadow_stats(&frame).wanted, "{again}");
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    panic!("what is streamed does not settle");
}

/// A light with a range: beyond it nothing is looked up.
#[test]
fn lights_that_end_want_pages_as_far_as_they_reach() {
    let mut scene = lit_crowd(0.0);
    let handles: Vec<_> = scene.lights().handles().map(nanite_rs::scene::LightHandle).collect();
    for handle in &handles[..3] {
        scene.remove_light(*handle).unwrap();
    }
    let pose = at(0.0, 1.0, 9.0);
    let all = shoot(&scene, &CAMERA, &pose, SIZE, &options());
    let light = *scene.light(handles[3]).unwrap();
    scene.set_light(handles[3], Light { kind: LightKind::Point { range: Some(2.5) }, ..light }).unwrap();
    let near = shoot(&scene, &CAMERA, &pose, SIZE, &options());
    assert!(shadow_stats(&near).wanted < shadow_stats(&all).wanted);
    // Where its light reaches, its shadows are those of before.
    let plain = shoot(&scene, &CAMERA, &pose, SIZE, &RenderOptions::default()).linear().unwrap();
    let lit = near.linear().unwrap();
    let (a, b) = (near.shadow().unwrap(), all.shadow().unwrap());
    for (pixel, (a, b)) in a.iter().zip(&b).enumerate() {
        let color = 3 * pixel..3 * pixel + 3;
        assert!(a == b || plain[color.clone()] == lit[color], "pixel {pixel}");
    }
}

/// A square of side 2 above a floor, in light at a slope: where its shadow lies is known.
#[test]
fn a_square_shades_what_is_behind_it_and_nothing_else() {
    let flat = square(4);
    let lying = |half: f64, height: f64| -> Pose {
        [[half, 0.0, 0.0, 0.0], [0.0, 0.0, half, height], [0.0, -half, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    };
    let mut scene = Scene::new();
    let floor = scene.add(Arc::clone(&flat), &lying(40.0, 0.0), Material::default()).unwrap();
    let square = scene.add(Arc::clone(&flat), &lying(1.0, 3.0), Material::default()).unwrap();
    // From the floor's middle the light is at (1, 1, 0): the shadow moves by −3 along x.
    let sun = scene.add_light(towards(LightKind::Directional, DVec3::new(1.0, 1.0, 0.0))).unwrap();
    // Straight down, two hundred pixels a unit.
    let down = [[1.0, 0.0, 0.0, -3.0], [0.0, 0.0, 1.0, 2.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let camera = Camera {
        projection: Projection::Orthographic { xmag: Some(1.5), ymag: 1.5 },
        znear: 0.01,
        zfar: None,
    };
    let side = 600;
    let mut renderer = Renderer::new(side, side, "cpu").unwrap();
    let mut dark = |scene: &Scene| {
        let shadow = renderer.render(scene, &camera, &down, &options()).unwrap().shadow().unwrap();
        let pixel = 3.0 / f64::from(side);
        let mut wrong = Vec::new();
        for (at, lit) in shadow.iter().enumerate() {
            let place = |k: usize| (k as f64 + 0.5) * pixel - 1.5;
            let farthest = place(at % side as usize).abs().max(place(at / side as usize).abs());
            // A texel along the slope, and what a receiver is moved by.
            if (farthest < 1.0) == (*lit == 1.0) && (farthest - 1.0).abs() > 4.0 * pixel {
                wrong.push(at);
            }
        }
        (shadow.iter().filter(|lit| **lit == 0.0).count(), wrong.len())
    };
    let (count, wrong) = dark(&scene);
    let expected = (f64::from(side) * 2.0 / 3.0).powi(2);
    assert_eq!(wrong, 0);
    assert!((count as f64 / expected - 1.0).abs() < 0.02, "{count} pixels of {expected}");
    // Seen from the light it shows its back now, and is as dark.
    let mut back = lying(1.0, 3.0);
    (back[0][0], back[2][1]) = (-1.0, -1.0);
    scene.set_pose(square, &back).unwrap();
    assert_eq!(dark(&scene).1, 0);
    let mut none = |scene: &Scene| assert_eq!(dark(scene).0, 0);
    scene.set_shadows(square, false, true).unwrap();
    none(&scene);
    scene.set_shadows(square, true, true).unwrap();
    scene.set_shadows(floor, true, false).unwrap();
    none(&scene);
    scene.set_shadows(floor, true, true).unwrap();
    let light = *scene.light(sun).unwrap();
    scene.set_light(sun, Light { casts_shadows: false, ..light }).unwrap();
    none(&scene);
}

#[test]
fn a_floor_in_grazing_light_does_not_shade_itself() {
    let mut scene = Scene::new();
    let flat = square(40);
    let lying = [[50.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -50.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    scene.add(flat, &lying, Material::default()).unwrap();
    let sun = scene.add_light(towards(LightKind::Directional, DVec3::Y)).unwrap();
    for degrees in [0.5f64, 2.0, 10.0, 45.0, 80.0, 90.0] {
        for turn in 0..3 {
            let (up, across) = (degrees * PI / 180.0).sin_cos();
            let (sin, cos) = (0.9 * f64::from(turn)).sin_cos();
            let light = towards(LightKind::Directional, DVec3::new(across * cos, up, across * sin));
            scene.set_light(sun, light).unwrap();
            for height in [0.02, 1.7, 400.0] {
                let mut pose = at(0.3, height, 20.0);
                // Down a little.
                let (sin, cos) = (-0.3f64).sin_cos();
                (pose[1][1], pose[1][2], pose[2][1], pose[2][2]) = (cos, -sin, sin, cos);
                let camera = Camera { znear: 1e-3, ..CAMERA };
                let frame = shoot(&scene, &camera, &pose, SIZE, &options());
                let shadow = frame.shadow().unwrap();
                let dark = shadow.iter().filter(|lit| **lit == 0.0).count();
                assert_eq!(dark, 0, "at {degrees}° turned {turn} from {height}");
            }
        }
    }
    // And from below it is dark.
    scene.set_light(sun, towards(LightKind::Directional, DVec3::new(0.1, -1.0, 0.2))).unwrap();
    let frame = shoot(&scene, &CAMERA, &at(0.0, 2.0, 20.0), SIZE, &options());
    let (shadow, depth) = (frame.shadow().unwrap(), frame.depth().unwrap());
    assert!(shadow.iter().zip(&depth).all(|(lit, depth)| (*lit == 0.0) == (*depth > 0.0)));
}

#[test]
fn a_pebble_has_its_shadow_beside_a_mountain() {
    // A triangle of kilometres is rounded by more than the pebble is large, which is no matter of the square before it.
    let mut scene = Scene::new();
    let far =
        [[3.0e4, 0.0, 0.0, 0.0], [0.0, 0.0, 3.0e4, -0.5], [0.0, -3.0e4, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let near = [[0.5, 0.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0], [0.0, -0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let double_sided = || Material { double_sided: true, ..Material::default() };
    scene.add(square(8), &far, double_sided()).unwrap();
    scene.add(square(8), &near, double_sided()).unwrap();
    let pebble = dag(&bumpy_sphere(40));
    let radius = 0.003;
    let place =
        [[radius, 0.0, 0.0, 0.0], [0.0, radius, 0.0, 0.01], [0.0, 0.0, radius, 0.0], [0.0, 0.0, 0.0, 1.0]];
    scene.add(pebble, &place, Material::default()).unwrap();
    scene.add_light(towards(LightKind::Directional, DVec3::new(0.1, 2.0, 0.2))).unwrap();
    let camera = Camera { znear: 0.001, ..CAMERA };
    let (sin, cos) = (0.5f64.sin(), 0.5f64.cos());
    let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, cos, sin, 0.05], [0.0, -sin, cos, 0.08], [0.0, 0.0, 0.0, 1.0]];
    let frame = shoot(&scene, &camera, &pose, SIZE, &options());
    // The pebble's own dark side is of another instance.
    let (shadow, ids) = (frame.shadow().unwrap(), frame.instance_ids().unwrap());
    let dark = shadow.iter().zip(&ids).filter(|(lit, id)| **lit == 0.0 && **id == 1).count();
    assert!(dark > 30, "{dark}");
}

/// What casts no shadow on what is seen, and what others hide from the light, is left out; the picture is that of all.
#[test]
fn what_cascades_leave_out_changes_no_pixel() {
    let meshes = [dag(&bumpy_sphere(40)), dag(&torus(60, 24)), square(8)];
    let (mut culled, mut drawn, mut all) = ([0, 0], 0, 0);
    for case in 1..=10u32 {
        let mut state = case;
        let mut random = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            2.0 * f64::from(state >> 8) / f64::from(1u32 << 24) - 1.0
        };
        let mut scene = Scene::new();
        let mut handles = Vec::new();
        for k in 0..20 + 20 * case {
            let turn = DAffine3::from_rotation_y(3.0 * random());
            let size = DAffine3::from_scale(DVec3::splat(2f64.powf(2.0 * random() - 1.0)));
            let place = DVec3::new(9.0 * random(), 2.0 + 3.0 * random(), 12.0 * random() - 6.0);
            let pose = nanite_rs::scene::pose::rows(&(DAffine3::from_translation(place) * turn * size));
            let mesh = Arc::clone(&meshes[k as usize % 3]);
            handles.push(scene.add(mesh, &pose, Material::default()).unwrap());
        }
        let floor =
            [[40.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -2.0], [0.0, -40.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        scene.add(Arc::clone(&meshes[2]), &floor, Material::default()).unwrap();
        let mut sun = |height: f64| towards(LightKind::Directional, DVec3::new(random(), height, random()));
        let lights = [sun(0.3), sun(2.0)].map(|light| scene.add_light(light).unwrap());
        let soft = Light { radius: 0.02, ..sun(1.0) };
        scene.add_light(soft).unwrap();
        let projection = match case % 3 {
            0 => Projection::Orthographic { xmag: None, ymag: 6.0 },
            _ => CAMERA.projection,
        };
        let camera = Camera { projection, ..CAMERA };
        let mut kept = Renderer::new(SIZE.0, SIZE.1, "cpu").unwrap();
        for step in 0..6 {
            let pose = turned(at(0.3 * f64::from(step), 1.5, 12.0), 0.05 * f64::from(step));
            match step {
                3 => scene.set_pose(handles[5], &at(random(), 3.0, random())).unwrap(),
                4 => scene
                    .set_light(lights[0], towards(LightKind::Directional, DVec3::new(1.0, 0.4, random())))
                    .unwrap(),
                5 => drop(scene.remove(handles[7]).unwrap()),
                _ => {}
            }
            let frame = kept.render(&scene, &camera, &pose, &cascaded()).unwrap();
            let options = RenderOptions { occlusion: false, ..cascaded() };
            let whole = shoot(&scene, &camera, &pose, SIZE, &options);
            same_shadows(&frame, &whole);
            let (some, every) = (shadow_stats(&frame), shadow_stats(&whole));
            assert_eq!((every.culled_instances, every.culled_clusters), (0, 0));
            assert!(some.clusters <= every.clusters && some.wanted == every.wanted);
            culled = [culled[0] + some.culled_instances, culled[1] + some.culled_clusters];
            (drawn, all) = (drawn + some.clusters, all + every.clusters);
        }
    }
    println!("{culled:?} instances and clusters left out, {drawn} of {all} clusters drawn");
    assert!(culled[0] > 1000 && culled[1] > 100 && 4 * drawn < 3 * all, "{culled:?}, {drawn} of {all}");
}

/// Balls in a row hide each other from lights at its end.
#[test]
fn what_is_hidden_from_lights_changes_no_page() {
    RADII.iter().for_each(|radius| leaves_out_what_is_hidden("cpu", *radius));
}

fn leaves_out_what_is_hidden(backend: &str, radius: f64) {
    let ball = dag(&bumpy_sphere(70));
    let mut scene = Scene::new();
    for k in 0..5 {
        let turn = f64::from(k);
        scene.add(Arc::clone(&ball), &turned(at(2.2 * turn, 0.0, 0.0), turn), Material::default()).unwrap();
    }
    let spot = LightKind::Spot { range: None, inner: 0.1, outer: 0.6 };
    for (kind, place) in [
        (LightKind::Directional, DVec3::new(-1.0, 0.1, 0.1)),
        (spot, DVec3::new(-6.0, 0.4, 0.3)),
        (LightKind::Point { range: None }, DVec3::new(-4.0, 0.0, 0.2)),
    ] {
        scene.add_light(Light { radius, ..towards(kind, place) }).unwrap();
    }
    for far in [4.0, 9.0] {
        let pose = at(4.4, 0.5, far);
        let frame = picture(backend, &scene, &CAMERA, &pose, SIZE, &options());
        let every = RenderOptions { occlusion: false, ..options() };
        let whole = picture(backend, &scene, &CAMERA, &pose, SIZE, &every);
        same_shadows(&frame, &whole);
        same_shadows(&frame, &shoot(&scene, &CAMERA, &pose, SIZE, &every));
        let (some, every) = (shadow_stats(&frame), shadow_stats(&whole));
        assert_eq!(every.culled_clusters, 0);
        assert_eq!(some.clusters + some.culled_clusters, every.clusters);
        println!("{} of {} clusters left out", some.culled_clusters, every.clusters);
        assert!(10 * some.culled_clusters > every.clusters, "{some:?} of {every:?}");
    }
}

#[test]
fn cascades_are_few_and_share_what_is_seen() {
    let scene = lit_crowd(0.0);
    let pose = at(0.0, 1.0, 9.0);
    for size in [(160, 120), (1, 1), (97, 61)] {
        let frame = shoot(&scene, &CAMERA, &pose, size, &cascaded());
        let cascades = &shadow_stats(&frame).cascades;
        // Two of the lights are suns.
        let of = |light: usize| cascades.iter().filter(|cascade| cascade.light == light).collect::<Vec<_>>();
        for light in [0, 1] {
            let own = of(light);
            assert!((1..=4).contains(&own.len()) && (size.0 == 1 || own.len() == 4), "{own:?}");
            assert!(own[0].range[0] == 0.0 && own.last().unwrap().range[1] == f32::INFINITY);
            assert!(own.windows(2).all(|two| two[0].range[1] == two[1].range[0]), "{own:?}");
        }
        assert_eq!(cascades.len(), of(0).len() + of(1).len());
        assert!(shadow_stats(&frame).wanted > 0);
    }
    // With little room they are coarser.
    let room = shadow_stats(&shoot(&scene, &CAMERA, &pose, SIZE, &cascaded())).wanted / 2;
    let small = RenderOptions { shadow_memory: room << 16, ..cascaded() };
    let frame = shoot(&scene, &CAMERA, &pose, SIZE, &small);
    assert!(shadow_stats(&frame).coarser > 0 && shadow_stats(&frame).kept <= room);
    shows_both(&frame, 4);
    // Of depth alone there are none, and where nothing is seen neither.
    let outputs = [Output::Depth].into_iter().collect();
    let depth = RenderOptions { depth_only: true, outputs, ..cascaded() };
    assert!(shadow_stats(&shoot(&scene, &CAMERA, &pose, SIZE, &depth)).cascades.is_empty());
    let away = shoot(&scene, &CAMERA, &at(0.0, 1.0, -900.0), SIZE, &cascaded());
    assert!(shadow_stats(&away).cascades.is_empty() && shadow_stats(&away).wanted == 0);
    // Views of a call are those that are drawn alone, and what was drawn for one frame is looked up by no other.
    let views = [at(0.0, 1.0, 9.0), at(2.0, 3.0, 7.0)];
    let descs: Vec<ViewDesc> = (0..).zip(views).map(|(id, pose)| ViewDesc::new(id, CAMERA, pose)).collect();
    let mut renderer = Renderer::new(SIZE.0, SIZE.1, "cpu").unwrap();
    let together = renderer.render_views(&scene, &descs, &cascaded(), UNINTERRUPTED).unwrap();
    for (pose, frame) in views.iter().zip(&together) {
        same_shadows(frame, &shoot(&scene, &CAMERA, pose, SIZE, &cascaded()));
    }
    let frame = renderer.render(&scene, &CAMERA, &pose, &options()).unwrap();
    same_shadows(&frame, &shoot(&scene, &CAMERA, &pose, SIZE, &options()));
}

#[test]
fn frames_without_shadows_say_so() {
    let frame = shoot(&lit_crowd(0.0), &CAMERA, &at(0.0, 1.0, 9.0), SIZE, &RenderOptions::default());
    let error = frame.shadow().unwrap_err().to_string();
    assert!(error.starts_with("shadows: "), "{error}");
    assert!(frame.stats.shadows.is_none());
    // Where there is no light and nothing to see there is nothing to do.
    let empty = shoot(&Scene::new(), &CAMERA, &IDENTITY, SIZE, &options());
    assert_eq!(empty.shadow().unwrap().len(), 0);
    assert_eq!(shadow_stats(&empty).wanted, 0);
}

#[cfg(feature = "gpu")]
mod on_a_device {
    use nanite_rs::config::Output;
    use nanite_rs::render::Stage;

    use super::*;
    use crate::gpu_parity::{device, tolerances};
    use crate::materials::lattices;

    #[test]
    fn pages_are_marked_and_drawn_as_on_the_cpu() {
        if device("pages_are_marked_and_drawn_as_on_the_cpu").is_none() {
            return;
        }
        let parallel = Projection::Orthographic { xmag: None, ymag: 4.0 };
        let pose = turned(at(0.0, 1.0, 9.0), 0.1);
        for (radius, projection) in RADII.into_iter().zip([CAMERA.projection, parallel]) {
            let (scene, camera) = (lit_crowd(radius), Camera { projection, znear: 0.05, zfar: None });
            for size in [SIZE, (97, 61)] {
                let expected = shoot(&scene, &camera, &pose, size, &options());
                let of_stages = |cpu_from, device_outputs| {
                    let options = RenderOptions { cpu_from, device_outputs, ..options() };
                    picture("gpu", &scene, &camera, &pose, size, &options)
                };
                for from in [Stage::ShadowMark, Stage::ShadowRaster, Stage::Shade] {
                    let frame = of_stages(Some(from), None);
                    same_shadows(&frame, &expected);
                    let drawn = |frame: &Frame| shadow_stats(frame).drawn;
                    // A device marks each pixel by itself, the CPU eight together.
                    assert!(drawn(&frame) <= drawn(&expected) && 2 * drawn(&frame) > drawn(&expected));
                }
                let frame = of_stages(None, None);
                same_shadows(&frame, &expected);
                let shaded = of_stages(None, Some(true));
                assert!(shaded.shadow().unwrap() == expected.shadow().unwrap());
                let (ours, theirs) = (shaded.linear().unwrap(), expected.linear().unwrap());
                let off =
                    ours.iter().zip(&theirs).filter(|(a, b)| (*a - *b).abs() > 2e-3 * a.max(**b) + 1e-4);
                let off = off.count();
                // Receivers are rounded as surfaces are, and some lie on edges of texels.
                assert!(1000 * off <= ours.len(), "{off} of {}", ours.len());
            }
        }
        let mut scene = lattices();
        for light in lights(0.0) {
            scene.add_light(light).unwrap();
        }
        let pose = at(0.0, 0.6, 4.5);
        let expected = shoot(&scene, &CAMERA, &pose, SIZE, &options());
        shows_both(&expected, 1);
        same_shadows(&picture("gpu", &scene, &CAMERA, &pose, SIZE, &options()), &expected);
    }

    #[test]
    fn kept_pages_are_those_that_would_be_drawn_now() {
        if device("kept_pages_are_those_that_would_be_drawn_now").is_some() {
            keeps_what_would_be_drawn_now("gpu", RADII[0]);
            light_moves_comes_and_goes("gpu", RADII[1]);
        }
    }

    #[test]
    fn pages_find_room_share_views_and_are_streamed() {
        if device("pages_find_room_share_views_and_are_streamed").is_some() {
            coarser_without_room("gpu", RADII[0]);
            leaves_out_what_is_hidden("gpu", RADII[0]);
            views_share_pages("gpu");
            streamed_as_whole("gpu");
        }
    }

    /// Frames keep the pages that they look up, though others take their slots.
    #[test]
    fn frames_keep_their_pages() {
        if device("frames_keep_their_pages").is_none() {
            return;
        }
        let mut scene = lit_crowd(0.0);
        let mut renderer = Renderer::new(SIZE.0, SIZE.1, "gpu").unwrap();
        let pages = shadow_stats(&shoot(&scene, &CAMERA, &at(0.0, 1.0, 9.0), SIZE, &options())).wanted;
        let small = RenderOptions { shadow_memory: (pages + 8) << 16, ..options() };
        let handle = scene.lights().handles().map(nanite_rs::scene::LightHandle).nth(1).unwrap();
        let mut frames = Vec::new();
        for step in 0..5 {
            let light = *scene.light(handle).unwrap();
            let turn = DAffine3::from_rotation_y(0.2 * f64::from(step));
            scene.set_light(handle, Light { pose: turn * light.pose, ..light }).unwrap();
            let pose = at(0.2 * f64::from(step), 1.0, 9.0);
            let frame = renderer.render(&scene, &CAMERA, &pose, &small).unwrap();
            frames.push((frame, shoot(&scene, &CAMERA, &pose, SIZE, &options())));
        }
        for (frame, expected) in &frames {
            assert_eq!(shadow_stats(frame).coarser, 0);
            same_shadows(frame, expected);
        }
    }

    /// Where depth alone is asked for as well, and where nothing is to be seen.
    #[test]
    fn any_frames_of_a_call_may_have_shadows() {
        if device("any_frames_of_a_call_may_have_shadows").is_none() {
            return;
        }
        let scene = lit_crowd(0.0);
        let depth = ViewDesc {
            kind: Some(nanite_rs::render::ViewKind::DepthOnly),
            ..ViewDesc::new(1, CAMERA, at(0.0, 1.0, 8.0))
        };
        let views = [ViewDesc::new(0, CAMERA, at(0.0, 1.0, 9.0)), depth];
        let outputs = [Output::Linear, Output::Depth].into_iter().collect();
        let options = RenderOptions { outputs, device_outputs: Some(true), ..options() };
        let mut renderer = Renderer::new(SIZE.0, SIZE.1, "gpu").unwrap();
        let frames = renderer.render_views(&scene, &views, &options, UNINTERRUPTED).unwrap();
        same_shadows(&frames[0], &shoot(&scene, &CAMERA, &at(0.0, 1.0, 9.0), SIZE, &options));
        assert!(frames[1].depth().is_ok());
        let mut empty = Scene::new();
        empty.add_light(lights(0.0)[0]).unwrap();
        let nothing = renderer.render(&empty, &CAMERA, &IDENTITY, &options).unwrap();
        assert!(nothing.shadow().unwrap().iter().all(|lit| *lit == 1.0));
        let away = renderer.render(&scene, &CAMERA, &at(0.0, 1.0, -60.0), &options).unwrap();
        let expected = shoot(&scene, &CAMERA, &at(0.0, 1.0, -60.0), SIZE, &options);
        tolerances::same_light(
            &away.linear().unwrap(),
            &expected.linear().unwrap(),
            tolerances::DARK,
            "away",
        );
    }
}
