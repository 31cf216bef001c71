//! Frames of the CPU renderer at 1280×720: by size of the mesh, by threshold, and by number of instances.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use glam::DAffine3;
use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, Outputs, RenderOptions};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::Dag;
use nanite_rs::render::Renderer;
use nanite_rs::scene::{Camera, Light, Material, Projection, Scene};

#[path = "../../tests/rust/shapes.rs"]
#[allow(dead_code)]
mod shapes;

type Pose = [[f64; 4]; 4];

fn at(x: f64, y: f64, z: f64, scale: f64) -> Pose {
    [[scale, 0.0, 0.0, x], [0.0, scale, 0.0, y], [0.0, 0.0, scale, z], [0.0, 0.0, 0.0, 1.0]]
}

/// A closed wavy sphere of 8·n² triangles.
fn sphere(n: usize) -> Arc<Dag> {
    let (positions, faces) = shapes::bumpy_sphere(n);
    let source = SourceMesh::new(Positions::F32(&positions), &faces);
    Arc::new(build(&source, &BuildOptions::default(), &Silent).expect("a sphere builds"))
}

/// `side`² instances on a grid that together cover what one covers.
fn scene(mesh: &Arc<Dag>, side: u32) -> Scene {
    let mut scene = Scene::new();
    scene.set_ambient_light([0.1; 3]).expect("a colour");
    let pose = DAffine3::from_rotation_y(0.5) * DAffine3::from_rotation_x(-0.6);
    let light = Light { intensity: 3.0, pose, ..Light::default() };
    scene.add_light(light).expect("a light");
    let scale = 1.0 / f64::from(side);
    for i in 0..side {
        for j in 0..side {
            let place = |k: u32| (2.0 * f64::from(k) + 1.0) * scale - 1.0;
            let pose = at(place(i), place(j), 0.0, scale * 0.93);
            scene.add(Arc::clone(mesh), &pose, Material::default()).expect("an instance");
        }
    }
    scene
}

fn frame(c: &mut Criterion, name: &str, scene: &Scene, options: &RenderOptions) {
    let camera =
        Camera { projection: Projection::Perspective { yfov: 0.8, aspect: None }, znear: 0.05, zfar: None };
    let mut renderer = Renderer::new(1280, 720, "cpu").expect("a renderer");
    let pose = at(0.0, 0.0, 3.6, 1.0);
    let stats = renderer.render(scene, &camera, &pose, options).expect("a frame").stats.clone();
    println!("{name}\n{stats}");
    c.bench_function(name, |b| {
        b.iter(|| black_box(renderer.render(scene, &camera, &pose, options).expect("a frame")));
    });
}

fn frames(c: &mut Criterion) {
    let default = RenderOptions::default();
    let all_large = RenderOptions { pixel_error: 0.0, outputs: Outputs::default(), ..default.clone() };
    frame(c, "frame/large triangles, visibility only", &scene(&sphere(4), 1), &all_large);
    for n in [93, 177, 354] {
        let mesh = sphere(n);
        let (scene, faces) = (scene(&mesh, 1), 8 * n * n);
        frame(c, &format!("frame/{faces} triangles"), &scene, &default);
        if n == 177 {
            let full = RenderOptions { pixel_error: 0.0, ..default.clone() };
            frame(c, &format!("frame/{faces} triangles, full detail"), &scene, &full);
            let hidden = RenderOptions { occlusion: false, ..default.clone() };
            frame(c, &format!("frame/{faces} triangles, no occlusion"), &scene, &hidden);
            let bare = RenderOptions { outputs: Outputs::default(), ..default.clone() };
            frame(c, &format!("frame/{faces} triangles, visibility only"), &scene, &bare);
            let depth = RenderOptions::depth_only();
            frame(c, &format!("frame/{faces} triangles, depth only"), &scene, &depth);
        }
        if n == 354 {
            for side in [3, 10, 32] {
                frame(c, &format!("frame/{} instances", side * side), &self::scene(&mesh, side), &default);
            }
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).warm_up_time(std::time::Duration::from_secs(1));
    targets = frames
}
criterion_main!(benches);
