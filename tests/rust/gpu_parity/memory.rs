//! Devices that are lost or out of memory, and meshes that more than one array holds.

use std::sync::Arc;

use nanite_rs::Error;
use nanite_rs::config::RenderOptions;

use nanite_rs::gpu::Context;
use nanite_rs::model::Dag;
use nanite_rs::render::{Frame, Renderer};
use nanite_rs::scene::Material;

use super::{alone, device, equal, options, skip};
use crate::render_frames::{CAMERA, IDENTITY, at, crowd, dag, lit, shoot};
use crate::shapes::{bumpy_sphere, torus};

#[test]
fn a_lost_device_is_an_error_and_another_one_serves() {
    let test = "a_lost_device_is_an_error_and_another_one_serves";
    let Some(context) = device(test) else { return };
    if !alone(&format!("gpu_parity::memory::{test}")) {
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
    if !alone(&format!("gpu_parity::memory::{test}")) {
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
