//! Whole frames of the CPU renderer: what may not change the picture does not, and what is seen is there.

use std::sync::Arc;

use nanite_rs::Error;
use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, RenderOptions};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::{Dag, UNINTERRUPTED};
use nanite_rs::render::{Frame, Renderer, ViewDesc};
use nanite_rs::scene::{Camera, Light, Material, Projection, Scene};

use crate::shapes::{Mesh, bumpy_sphere, cube, grid, torus};

pub type Pose = [[f64; 4]; 4];

pub const IDENTITY: Pose =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

pub const CAMERA: Camera =
    Camera { projection: Projection::Perspective { yfov: 0.8, aspect: None }, znear: 0.05, zfar: None };

pub fn at(x: f64, y: f64, z: f64) -> Pose {
    let mut pose = IDENTITY;
    (pose[0][3], pose[1][3], pose[2][3]) = (x, y, z);
    pose
}

pub fn dag(mesh: &Mesh) -> Arc<Dag> {
    let options = BuildOptions { face_ids: true, ..BuildOptions::default() };
    Arc::new(build(&SourceMesh::new(Positions::F32(&mesh.0), &mesh.1), &options, &Silent).unwrap())
}

pub fn lit() -> Scene {
    let mut scene = Scene::new();
    scene.set_ambient_light([0.1; 3]).unwrap();
    let pose = glam::DAffine3::from_rotation_x(-0.5) * glam::DAffine3::from_rotation_y(0.4);
    scene.add_light(Light { intensity: 3.0, pose, ..Light::default() }).unwrap();
    scene
}

pub fn shoot(
    scene: &Scene,
    camera: &Camera,
    pose: &Pose,
    size: (u32, u32),
    options: &RenderOptions,
) -> Frame {
    Renderer::new(size.0, size.1, "cpu").unwrap().render(scene, camera, pose, options).unwrap()
}

/// What the picture shows, bit for bit.
pub fn same(a: &Frame, b: &Frame) {
    let depth = |f: &Frame| f.depth().unwrap().into_iter().map(f32::to_bits).collect::<Vec<_>>();
    assert!(depth(a) == depth(b), "depth");
    assert!(a.instance_ids().unwrap() == b.instance_ids().unwrap(), "instances");
    assert!(a.cluster_ids().unwrap() == b.cluster_ids().unwrap(), "clusters");
    assert!(a.triangle_ids().unwrap() == b.triangle_ids().unwrap(), "triangles");
    assert!(a.face_ids().unwrap() == b.face_ids().unwrap(), "faces");
    assert!(a.color().unwrap() == b.color().unwrap(), "colours");
}

fn full() -> RenderOptions {
    RenderOptions { pixel_error: 0.0, ..RenderOptions::default() }
}

/// Blocks of houses along straight streets, `side` by `side` of them.
pub fn city(side: i32) -> Scene {
    let house = dag(&cube(16));
    let mut scene = lit();
    for k in 0..side * side {
        let (x, z) = (f64::from(k % side), f64::from(k / side));
        let height = 4.0 + f64::from(k * 7 % 5);
        let mut pose = at(3.0 * x, height, -3.0 * z);
        (pose[0][0], pose[1][1], pose[2][2]) = (1.1, height, 1.1);
        scene.add(Arc::clone(&house), &pose, Material::default()).unwrap();
    }
    scene
}

/// Turned left by so many radians.
pub fn turned(pose: Pose, angle: f64) -> Pose {
    let (sin, cos) = angle.sin_cos();
    let mut out = pose;
    (out[0][0], out[0][2], out[2][0], out[2][2]) = (cos, sin, -sin, cos);
    out
}

/// A crowd in depth, with two meshes, mirrors, shears and a double-sided sheet.
pub fn crowd() -> Scene {
    let (ball, ring) = (dag(&bumpy_sphere(40)), dag(&torus(60, 24)));
    let sheet = dag(&grid(40, |x, y| 0.1 * (9.0 * x).sin() * (7.0 * y).cos()));
    let mut scene = lit();
    for k in 0..5 {
        for j in 0..4 {
            for i in 0..6 {
                let mut pose = at(2.2 * f64::from(i) - 5.5, 2.1 * f64::from(j) - 3.0, -3.0 * f64::from(k));
                if (i + j) % 3 == 0 {
                    pose[0][0] = -1.0;
                }
                if (i + k) % 4 == 0 {
                    (pose[0][1], pose[1][1]) = (0.4, 0.7);
                }
                let mesh = if (i + j + k) % 2 == 0 { &ball } else { &ring };
                scene.add(Arc::clone(mesh), &pose, Material::default()).unwrap();
            }
        }
    }
    let mut wall = at(-4.0, -3.0, -20.0);
    (wall[0][0], wall[1][1]) = (8.0, 8.0);
    let both = Material { double_sided: true, smooth: false, ..Material::default() };
    scene.add(sheet, &wall, both).unwrap();
    scene
}

#[test]
fn from_the_street_a_city_costs_what_is_seen() {
    let scene = city(120);
    let (mut before, mut after) = (0, 0);
    for k in 0..3 {
        let pose = turned(at(178.5, 1.7, -178.5), 0.8 * f64::from(k) + 0.2);
        let [culled, whole] = [true, false].map(|occlusion| {
            let options = RenderOptions { occlusion, ..RenderOptions::default() };
            shoot(&scene, &CAMERA, &pose, (1280, 720), &options)
        });
        assert!(
            culled.color().unwrap() == whole.color().unwrap()
                && culled.depth().unwrap() == whole.depth().unwrap()
        );
        assert_eq!(culled.instance_ids().unwrap(), whole.instance_ids().unwrap());
        before += whole.stats.clusters;
        after += culled.stats.clusters;
    }
    println!("{after} of {before} clusters");
    assert!(20 * after <= before, "{after} of {before} clusters");
}

#[test]
fn what_a_frame_before_showed_changes_cost_and_no_pixel() {
    let mut scene = city(60);
    let ball = scene.add(dag(&bumpy_sphere(60)), &at(88.5, 2.0, -88.5), Material::default()).unwrap();
    let size = (639, 361);
    // Along a street, a turn, jumps to another one and above the roofs, and back; and twice from each place.
    let mut path: Vec<Pose> = (0..4).map(|k| at(88.5, 1.7, -80.0 - 0.7 * f64::from(k))).collect();
    path.extend((1..4).map(|k| turned(at(88.5, 1.7, -82.5), 0.5 * f64::from(k))));
    path.extend([at(40.5, 1.7, -40.5), at(88.0, 60.0, 20.0), at(88.5, 1.7, -80.0)]);
    let mut kept = [(); 2].map(|()| Renderer::new(size.0, size.1, "cpu").unwrap());
    let (mut fresh, mut again) = (0, 0);
    for (k, pose) in path.iter().enumerate() {
        // The ball fills the street, rolls on, and jumps.
        let place = [-84.0, -84.5, -85.0, -20.0][k % 4];
        scene.set_pose(ball, &at(88.5, 1.5, place)).unwrap();
        let options = RenderOptions::default();
        let whole = RenderOptions { occlusion: false, ..RenderOptions::default() };
        let expected = shoot(&scene, &CAMERA, pose, size, &whole);
        let alone = shoot(&scene, &CAMERA, pose, size, &options);
        // Another view beside it, whose pictures are of elsewhere.
        let other = (CAMERA, at(10.0, 1.7, -10.0));
        let pair = [(CAMERA, *pose), other];
        let mut beside =
            kept[1].render_views(&scene, &ViewDesc::numbered(&pair), &options, UNINTERRUPTED).unwrap();
        let frames = [
            kept[0].render(&scene, &CAMERA, pose, &options).unwrap(),
            kept[0].render(&scene, &CAMERA, pose, &options).unwrap(),
            beside.swap_remove(0),
        ];
        frames.iter().for_each(|frame| same(frame, &expected));
        fresh += alone.stats.clusters;
        again += frames[1].stats.clusters;
    }
    println!("{fresh} clusters without a frame before, {again} where it was of the same place");
    assert!(again < fresh, "{again} of {fresh}");
}

#[test]
fn occlusion_does_not_change_a_bit() {
    let scene = crowd();
    let mut saved = Vec::new();
    for (pose, tau) in [(at(0.0, 0.0, 6.0), 1.0), (at(0.3, 0.2, 1.8), 0.0), (at(-1.0, 0.0, 12.0), 0.5)] {
        let mut options = RenderOptions { pixel_error: tau, ..RenderOptions::default() };
        let on = shoot(&scene, &CAMERA, &pose, (639, 361), &options);
        options.occlusion = false;
        let off = shoot(&scene, &CAMERA, &pose, (639, 361), &options);
        assert!(on.stats.triangles <= off.stats.triangles);
        saved.push(off.stats.triangles - on.stats.triangles);
        same(&on, &off);
    }
    assert!(saved[0] > 0, "{saved:?}");
}

#[test]
fn threads_do_not_change_a_bit() {
    let scene = crowd();
    let frames: Vec<Frame> = [1, 2, 8]
        .iter()
        .map(|&threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| shoot(&scene, &CAMERA, &at(0.0, 0.5, 4.0), (640, 360), &RenderOptions::default()))
        })
        .collect();
    for frame in &frames[1..] {
        assert_eq!(frames[0].words().unwrap(), frame.words().unwrap());
        assert_eq!(frames[0].color().unwrap(), frame.color().unwrap());
        assert_eq!(frames[0].normals().unwrap(), frame.normals().unwrap());
    }
}

#[test]
fn of_coincident_surfaces_the_first_in_the_scene_shows() {
    let ball = dag(&bumpy_sphere(64));
    let mut scene = lit();
    // A stack of decoys in front makes occlusion worthwhile, so that both passes take part.
    for k in 0..6 {
        scene.add(Arc::clone(&ball), &at(0.9, 0.0, 1.2 + 0.1 * f64::from(k)), Material::default()).unwrap();
    }
    let first = scene.add(Arc::clone(&ball), &IDENTITY, Material::default()).unwrap();
    let second = scene.add(Arc::clone(&ball), &IDENTITY, Material::default()).unwrap();
    for occlusion in [true, false] {
        let options = RenderOptions { occlusion, ..full() };
        let ids = shoot(&scene, &CAMERA, &at(0.0, 0.0, 5.0), (320, 240), &options).instance_ids().unwrap();
        assert!(ids.contains(&(first.0.index as i32)));
        assert!(ids.iter().all(|&i| i != second.0.index as i32));
    }
}

#[test]
fn stale_handles_raise_and_edits_are_seen() {
    let ball = dag(&bumpy_sphere(12));
    let mut scene = lit();
    let count =
        |scene: &Scene| shoot(scene, &CAMERA, &at(0.0, 0.0, 4.0), (64, 64), &full()).stats.covered_pixels;
    let a = scene.add(Arc::clone(&ball), &IDENTITY, Material::default()).unwrap();
    let seen = count(&scene);
    assert!(seen > 500);
    scene.set_visible(a, false).unwrap();
    assert_eq!(count(&scene), 0);
    scene.set_visible(a, true).unwrap();
    scene.set_pose(a, &at(100.0, 0.0, 0.0)).unwrap();
    assert_eq!(count(&scene), 0);
    scene.remove(a).unwrap();
    let b = scene.add(ball, &IDENTITY, Material::default()).unwrap();
    assert_eq!((a.0.index, count(&scene)), (b.0.index, seen));
    assert!(matches!(scene.set_pose(a, &IDENTITY), Err(Error::StaleHandle(_))));
    assert!(matches!(scene.set_visible(a, false), Err(Error::StaleHandle(_))));
    assert!(matches!(scene.remove(a), Err(Error::StaleHandle(_))));
    let mut flat = IDENTITY;
    flat[2][2] = 0.0;
    assert!(matches!(scene.set_pose(b, &flat), Err(Error::Argument { argument: "pose", .. })));
}

#[test]
fn the_far_away_looks_the_same() {
    let ball = dag(&bumpy_sphere(24));
    let frame = |offset: f64| {
        let mut scene = lit();
        scene.add(Arc::clone(&ball), &at(offset, -offset, offset), Material::default()).unwrap();
        shoot(&scene, &CAMERA, &at(offset + 0.25, 0.125 - offset, offset + 3.5), (160, 120), &full())
    };
    // Offsets and differences are exact in f64, so the pictures are equal, not just close.
    let (near, far) = (frame(0.0), frame(10_000_000.0));
    assert_eq!(near.words().unwrap(), far.words().unwrap());
    assert_eq!(near.color().unwrap(), far.color().unwrap());
}

#[test]
fn any_size_and_any_projection() {
    let ball = dag(&bumpy_sphere(32));
    let mut scene = lit();
    scene.add(ball, &IDENTITY, Material::default()).unwrap();
    for size in [(1, 1), (1, 9), (17, 1), (3, 5), (127, 63), (640, 359)] {
        let frame = shoot(&scene, &CAMERA, &at(0.0, 0.0, 2.0), size, &RenderOptions::default());
        let pixels = (size.0 * size.1) as usize;
        assert_eq!((frame.color().unwrap().len(), frame.depth().unwrap().len()), (3 * pixels, pixels));
        assert!(frame.stats.covered_pixels > 0, "{size:?}");
    }
    // A pinhole given both ways is the same picture.
    let focal = 0.5 * 90.0 / 0.4f64.tan();
    let intrinsics = Projection::Intrinsics { fx: focal, fy: focal, cx: 60.0, cy: 45.0, skew: 0.0 };
    let a = shoot(&scene, &CAMERA, &at(0.0, 0.0, 3.0), (120, 90), &full());
    let b =
        shoot(&scene, &Camera { projection: intrinsics, ..CAMERA }, &at(0.0, 0.0, 3.0), (120, 90), &full());
    assert_eq!(a.instance_ids().unwrap(), b.instance_ids().unwrap());
    // A shifted centre shifts the picture by whole pixels.
    let shifted = Projection::Intrinsics { fx: focal, fy: focal, cx: 70.0, cy: 40.0, skew: 0.0 };
    let c = shoot(&scene, &Camera { projection: shifted, ..CAMERA }, &at(0.0, 0.0, 3.0), (120, 90), &full());
    let (b, c) = (b.depth().unwrap(), c.depth().unwrap());
    let differing = (0..85)
        .flat_map(|y| (0..110).map(move |x| (x, y)))
        .filter(|&(x, y)| (b[(y + 5) * 120 + x] > 0.0) != (c[y * 120 + x + 10] > 0.0))
        .count();
    assert!(differing <= 4, "{differing} pixels differ");
}

#[test]
fn parallel_views_have_exact_silhouettes_and_depth() {
    // A flat grid over the unit square, seen straight on from 2 units away.
    let mut scene = lit();
    scene
        .add(dag(&grid(20, |_, _| 0.0)), &IDENTITY, Material { double_sided: true, ..Material::default() })
        .unwrap();
    let parallel = Camera {
        projection: Projection::Orthographic { xmag: Some(1.0), ymag: 1.0 },
        znear: 0.1,
        zfar: None,
    };
    for tau in [0.0, 1.0] {
        let options = RenderOptions { pixel_error: tau, ..RenderOptions::default() };
        let frame = shoot(&scene, &parallel, &at(0.5, 0.5, 2.0), (101, 101), &options);
        let depth = frame.depth().unwrap();
        // The square has side 1 of a view of side 2: 50.5 pixels, between columns 25.25 and 75.75.
        for (i, d) in depth.iter().enumerate() {
            let inside =
                |p: usize| (25..=75).contains(&p) && (p as f64 + 0.5) > 25.25 && (p as f64 + 0.5) < 75.75;
            let expected = if inside(i % 101) && inside(i / 101) { 2.0 } else { 0.0 };
            assert_eq!(*d, expected, "pixel {} {}", i % 101, i / 101);
        }
        assert!(frame.normals().unwrap().iter().all(|n| *n == [0.0; 3] || (n[2].abs() - 1.0).abs() < 1e-3));
    }
}

#[test]
fn a_mirrored_instance_is_a_mirrored_picture() {
    let ball = dag(&bumpy_sphere(32));
    let frame = |sign: f64| {
        let mut scene = Scene::new();
        scene.set_ambient_light([0.2; 3]).unwrap();
        let pose = glam::DAffine3::from_rotation_y(0.5 * sign);
        scene.add_light(Light { intensity: 2.0, pose, ..Light::default() }).unwrap();
        let mut pose = IDENTITY;
        pose[0][0] = sign;
        scene.add(Arc::clone(&ball), &pose, Material::default()).unwrap();
        shoot(&scene, &CAMERA, &at(0.0, 0.0, 3.0), (200, 150), &full())
    };
    let (plain, mirrored) = (frame(1.0), frame(-1.0));
    let (a, b) = (plain.color().unwrap(), mirrored.color().unwrap());
    let mut differing = 0;
    for y in 0..150 {
        for x in 0..200 {
            let (p, q) = (3 * (y * 200 + x), 3 * (y * 200 + 199 - x));
            differing += usize::from((0..3).any(|k| a[p + k].abs_diff(b[q + k]) > 2));
        }
    }
    // Edges on pixel centres fall to the other side.
    assert!(differing < 20, "{differing} of 30000 pixels differ");
    assert!(plain.stats.covered_pixels > 3000);
}

#[test]
fn from_inside_a_closed_mesh_every_pixel_is_covered() {
    let ball = dag(&bumpy_sphere(32));
    for (pose, near) in [(IDENTITY, 0.05), (at(0.9, 0.1, 0.2), 0.01), (at(0.0, 0.0, 0.93), 0.001)] {
        for tau in [0.0, 1.0] {
            for double_sided in [true, false] {
                let mut scene = lit();
                let look = Material { double_sided, ..Material::default() };
                scene.add(Arc::clone(&ball), &IDENTITY, look).unwrap();
                let camera = Camera { znear: near, ..CAMERA };
                let options = RenderOptions { pixel_error: tau, ..RenderOptions::default() };
                let frame = shoot(&scene, &camera, &pose, (333, 222), &options);
                if double_sided {
                    assert_eq!(frame.stats.covered_pixels, 333 * 222, "{pose:?} {tau}");
                } else if pose == IDENTITY {
                    // From the middle of a star-shaped body all faces show their backs.
                    assert_eq!(frame.stats.covered_pixels, 0);
                }
            }
        }
    }
}

#[test]
fn clip_distances_cut() {
    let mut scene = lit();
    scene
        .add(dag(&bumpy_sphere(32)), &IDENTITY, Material { double_sided: true, ..Material::default() })
        .unwrap();
    for projection in [CAMERA.projection, Projection::Orthographic { xmag: Some(1.5), ymag: 1.5 }] {
        let camera = Camera { projection, znear: 2.7, zfar: Some(3.1) };
        let depth = shoot(&scene, &camera, &at(0.0, 0.0, 3.0), (150, 150), &full()).depth().unwrap();
        let covered: Vec<f32> = depth.into_iter().filter(|d| *d > 0.0).collect();
        assert!(covered.len() > 500, "{}", covered.len());
        assert!(covered.iter().all(|d| (2.6999..=3.1001).contains(d)));
    }
}

/// Nearest hit of a ray with a mesh, in f64: distance along −z, and the triangle.
fn trace(mesh: &Mesh, eye: [f64; 3], direction: [f64; 3]) -> Option<(f64, usize)> {
    let sub = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let mut best: Option<(f64, usize)> = None;
    for (i, face) in mesh.1.iter().enumerate() {
        let [a, b, c] = face.map(|v| mesh.0[v as usize].map(f64::from));
        let (e1, e2) = (sub(b, a), sub(c, a));
        let p = cross(direction, e2);
        let determinant = dot(e1, p);
        if determinant <= 0.0 {
            continue; // faces away
        }
        let t = sub(eye, a);
        let u = dot(t, p) / determinant;
        let q = cross(t, e1);
        let v = dot(direction, q) / determinant;
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
            let d = dot(e2, q) / determinant;
            if d > 0.0 && best.is_none_or(|(b, _)| d < b) {
                best = Some((d, i));
            }
        }
    }
    best
}

#[test]
fn full_detail_shows_what_rays_hit() {
    let mesh = bumpy_sphere(24);
    let mut scene = lit();
    scene.add(dag(&mesh), &IDENTITY, Material::default()).unwrap();
    let (width, height) = (160u32, 120u32);
    let frame = shoot(&scene, &CAMERA, &at(0.0, 0.0, 3.0), (width, height), &full());
    let (faces, depth) = (frame.face_ids().unwrap(), frame.depth().unwrap());
    let focal = 0.5 * f64::from(height) / 0.4f64.tan();
    let (mut covered, mut same, mut worst) = (0, 0, 0.0f64);
    for y in 0..height {
        for x in 0..width {
            let i = (y * width + x) as usize;
            let direction = [(f64::from(x) + 0.5 - 80.0) / focal, (60.0 - f64::from(y) - 0.5) / focal, -1.0];
            let hit = trace(&mesh, [0.0, 0.0, 3.0], direction);
            assert_eq!(hit.is_some(), depth[i] > 0.0, "pixel {x} {y}");
            let Some((distance, face)) = hit else { continue };
            covered += 1;
            if faces[i] == face as i64 {
                same += 1;
                // How far the point shown lies from the face's plane, in pixels.
                let [a, b, c] = mesh.1[face].map(|v| mesh.0[v as usize].map(f64::from));
                let (e1, e2): ([f64; 3], [f64; 3]) =
                    (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
                let n = [
                    e1[1] * e2[2] - e1[2] * e2[1],
                    e1[2] * e2[0] - e1[0] * e2[2],
                    e1[0] * e2[1] - e1[1] * e2[0],
                ];
                let length = n.iter().map(|x| x * x).sum::<f64>().sqrt();
                let slant: f64 = (0..3).map(|k| n[k] * direction[k]).sum::<f64>() / length;
                let off = slant * (f64::from(depth[i]) - distance);
                worst = worst.max(off.abs() * focal / distance);
            }
        }
    }
    assert!(covered > 5000);
    assert!(f64::from(same) >= 0.995 * f64::from(covered), "{same} of {covered}");
    // Corners are snapped to 1/256 pixel, and the surface moves with them by no more; depth is an f32.
    assert!(worst < 2f64.sqrt() / 512.0 + 2.0e-4, "{worst}");
}

#[test]
fn cost_follows_the_picture() {
    let ball = dag(&bumpy_sphere(128));
    let mut scene = lit();
    scene.add(ball, &IDENTITY, Material::default()).unwrap();
    let triangles = |distance: f64, tau: f32| {
        let options = RenderOptions { pixel_error: tau, ..RenderOptions::default() };
        shoot(&scene, &CAMERA, &at(0.0, 0.0, distance), (320, 240), &options).stats.triangles
    };
    let (near, far, farther) = (triangles(4.0, 1.0), triangles(40.0, 1.0), triangles(400.0, 1.0));
    assert!(near < 131_072 && far < near / 8 && farther <= far, "{near} {far} {farther}");
    assert!(triangles(4.0, 4.0) < near);
    // Full detail, but for what faces away.
    assert!(triangles(4.0, 0.0) > 131_072 / 3);
}

#[test]
fn an_empty_scene_is_background() {
    let mut scene = Scene::new();
    scene.set_bg_color([0.0, 0.5, 1.0]).unwrap();
    let frame = shoot(&scene, &CAMERA, &IDENTITY, (4, 3), &RenderOptions::default());
    assert_eq!(frame.color().unwrap(), [0, 128, 255].repeat(12));
    assert_eq!(frame.instance_ids().unwrap(), [-1; 12]);
    assert_eq!(frame.cluster_ids().unwrap(), [u32::MAX; 12]);
    assert_eq!(frame.overdraw().unwrap(), [0; 12]);
}

#[test]
fn backends_say_what_they_are() {
    assert!(matches!(Renderer::new(4, 4, "metal"), Err(Error::Argument { argument: "backend", .. })));
    assert!(matches!(Renderer::new(0, 4, "cpu"), Err(Error::Argument { argument: "width", .. })));
    let auto = Renderer::new(4, 4, "auto").unwrap();
    assert!(!auto.backend_reason().is_empty());
    assert_eq!(Renderer::new(4, 4, "cpu").unwrap().backend_reason(), "asked for");
}

/// Numbers from a seed.
struct Dice(u64);

impl Dice {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn rotation(&mut self) -> glam::DMat3 {
        let mut angle = || self.within(-3.2, 3.2);
        glam::DMat3::from_euler(glam::EulerRot::XYZ, angle(), angle(), angle())
    }

    fn pose(&mut self, linear: glam::DMat3, reach: f64) -> Pose {
        let mut pose = IDENTITY;
        for (i, row) in pose.iter_mut().enumerate().take(3) {
            for (j, v) in row.iter_mut().enumerate().take(3) {
                *v = linear.col(j)[i];
            }
            row[3] = self.within(-reach, reach);
        }
        pose
    }
}

/// What is drawn in a round of a property test.
pub struct AnyView {
    pub scene: Scene,
    pub camera: Camera,
    pub pose: Pose,
    pub picture: (u32, u32),
    pub options: RenderOptions,
}

/// So many views of any poses: scales, squeezes, mirrors, every projection, near and far, inside and out.
pub fn any_views(rounds: u32) -> impl Iterator<Item = AnyView> {
    let (ball, sheet) = (dag(&bumpy_sphere(32)), dag(&grid(24, |x, y| (5.0 * x).sin() * y)));
    let mut dice = Dice(11);
    (0..rounds).map(move |round| {
        let mut scene = lit();
        let size = 10f64.powf(dice.within(-3.0, 3.0));
        for i in 0..12 {
            let squash = glam::DMat3::from_diagonal(glam::DVec3::new(
                size * dice.within(0.1, 1.5),
                size * dice.within(-1.5, -0.1),
                size * dice.within(0.1, 1.5),
            ));
            let linear = dice.rotation() * squash * dice.rotation();
            let look = Material { double_sided: dice.unit() < 0.3, ..Material::default() };
            let mesh = if i % 3 == 0 { &sheet } else { &ball };
            let pose = dice.pose(linear, 2.0 * size);
            scene.add(Arc::clone(mesh), &pose, look).unwrap();
        }
        let projection = match round % 4 {
            0 => Projection::Orthographic { xmag: Some(size * dice.within(0.1, 3.0)), ymag: size },
            1 => Projection::Intrinsics {
                fx: 90.0,
                fy: 70.0,
                cx: dice.within(-40.0, 200.0),
                cy: 40.0,
                skew: 0.0,
            },
            _ => Projection::Perspective { yfov: dice.within(0.01, 2.9), aspect: None },
        };
        let znear = size * 10f64.powf(dice.within(-4.0, 0.3));
        let zfar = (dice.unit() < 0.3).then_some(znear + size);
        let camera = Camera { projection, znear, zfar };
        let rotation = dice.rotation();
        let pose = dice.pose(rotation, 3.0 * size);
        let tau = if round % 5 == 0 { 0.0 } else { dice.within(0.0, 3.0) as f32 };
        let options = RenderOptions { pixel_error: tau, ..RenderOptions::default() };
        let picture = (1 + (dice.unit() * 160.0) as u32, 1 + (dice.unit() * 120.0) as u32);
        AnyView { scene, camera, pose, picture, options }
    })
}

#[test]
fn any_view_of_any_poses_is_the_same_with_and_without_occlusion() {
    let mut covered = 0;
    for (round, view) in any_views(120).enumerate() {
        let AnyView { scene, camera, pose, picture, options } = view;
        let on = shoot(&scene, &camera, &pose, picture, &options);
        let off = shoot(&scene, &camera, &pose, picture, &RenderOptions { occlusion: false, ..options });
        assert_eq!(on.color().unwrap(), off.color().unwrap(), "round {round}");
        assert_eq!(on.depth().unwrap(), off.depth().unwrap(), "round {round}");
        assert_eq!(on.triangle_ids().unwrap(), off.triangle_ids().unwrap(), "round {round}");
        let (near, far) =
            (camera.znear * 0.999_999, camera.zfar.map_or(f64::INFINITY, |far| far * 1.000_001));
        for d in on.depth().unwrap().into_iter().filter(|d| *d > 0.0).map(f64::from) {
            assert!((near..=far).contains(&d), "round {round}: {d}");
        }
        covered += on.stats.covered_pixels;
    }
    assert!(covered > 100_000, "{covered}");
}

#[test]
fn extreme_scales_render_or_vanish_without_a_fault() {
    let ball = dag(&bumpy_sphere(16));
    let mut dice = Dice(5);
    for _ in 0..60 {
        let mut scene = lit();
        let scale = 10f64.powf(dice.within(-36.0, 36.0));
        let linear = dice.rotation() * scale;
        let reach = 10f64.powf(dice.within(-30.0, 30.0));
        let pose = dice.pose(linear, reach);
        scene.add(Arc::clone(&ball), &pose, Material { double_sided: true, ..Material::default() }).unwrap();
        let camera = Camera { znear: 10f64.powf(dice.within(-20.0, 20.0)), ..CAMERA };
        let frame = shoot(&scene, &camera, &IDENTITY, (40, 30), &RenderOptions::default());
        assert!(frame.depth().unwrap().iter().all(|d| *d >= 0.0));
        assert_eq!(frame.normals().unwrap().len(), 1200);
    }
}

#[test]
fn neighbouring_triangles_cover_every_pixel_exactly_once() {
    // A flat sheet over the whole picture, slanted, at distances that make its triangles small and large.
    let mut drawn = [0; 2];
    let sheet = dag(&grid(200, |_, _| 0.0));
    for size in [8.0, 60.0, 4000.0] {
        let mut scene = Scene::new();
        let slant = glam::DMat3::from_euler(glam::EulerRot::XYZ, 0.5, -0.3, 0.2) * size;
        let mut pose = IDENTITY;
        let middle = slant * glam::DVec3::new(0.5, 0.5, 0.0);
        for i in 0..3 {
            for j in 0..3 {
                pose[i][j] = slant.col(j)[i];
            }
            pose[i][3] = -middle[i];
        }
        scene.add(Arc::clone(&sheet), &pose, Material { double_sided: true, ..Material::default() }).unwrap();
        for tau in [0.0, 1.0, 20.0] {
            let options = RenderOptions { pixel_error: tau, ..RenderOptions::default() };
            let frame = shoot(&scene, &CAMERA, &at(0.0, 0.0, 1.5), (317, 211), &options);
            drawn[0] += frame.stats.drawn_small;
            drawn[1] += frame.stats.drawn_large;
            let wrong: Vec<(usize, u32)> =
                frame.overdraw().unwrap().into_iter().enumerate().filter(|(_, n)| *n != 1).collect();
            assert!(
                wrong.is_empty(),
                "size {size}, threshold {tau}: {} {:?}",
                wrong.len(),
                &wrong[..9.min(wrong.len())]
            );
        }
    }
    // What is flat is coarse at every threshold but that of full detail.
    assert!(drawn.iter().all(|&n| n > 100), "both rasterizers take part: {drawn:?}");
}

#[cfg(feature = "gpu")]
#[test]
fn on_the_cpu_views_are_found_by_their_identity() {
    crate::gpu_parity::views::views_by_identity("cpu");
}
