//! A renderer follows its scene, and writes what changed.

use std::sync::Arc;

use nanite_rs::gpu_types;
use nanite_rs::render::Renderer;
use nanite_rs::scene::{Material, Scene};

use super::{device, options};
use crate::render_frames::{CAMERA, IDENTITY, at, crowd, dag, lit, shoot};
use crate::shapes::{bumpy_sphere, torus};

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
