//! Light from all around, by a map: the same on a device as on the CPU, and none of it where it is not asked for.

use std::sync::Arc;

use nanite_rs::config::{Output, RenderOptions, Shading};
use nanite_rs::render::Frame;
use nanite_rs::scene::image::Pixels;
use nanite_rs::scene::{Environment, EnvironmentMap};

use crate::materials::gallery;
use crate::render_frames::{CAMERA, at, shoot};

const SIZE: (u32, u32) = (240, 160);

/// A sky over ground with a small sun.
fn map(sun: f32) -> Arc<EnvironmentMap> {
    let (width, height) = (64u32, 32u32);
    let texel = |at: u32| {
        let (x, y) = (at % width, at / width);
        let wave = 0.3 + 0.2 * (x as f32 * 0.4).sin();
        if (x, y) == (40, 9) { [sun, 0.9 * sun, 0.7 * sun] } else { [wave, 0.4, 0.8 - 0.02 * y as f32] }
    };
    let floats: Vec<f32> = (0..width * height).flat_map(texel).collect();
    Arc::new(EnvironmentMap::new(Pixels::Floats(&floats), width, height, 3).unwrap())
}

fn environment(map: &Arc<EnvironmentMap>) -> Environment {
    Environment { map: Arc::clone(map), intensity: 0.7, rotation: 0.8, background: true }
}

fn options(shading: Shading) -> RenderOptions {
    let outputs = [Output::Color, Output::Linear].into_iter().collect();
    RenderOptions { shading, outputs, ..RenderOptions::default() }
}

fn same(a: &Frame, b: &Frame) -> bool {
    a.color().unwrap() == b.color().unwrap() && a.linear().unwrap() == b.linear().unwrap()
}

#[test]
fn only_what_asks_for_it_is_lit_by_it() {
    let (bare, pose) = (gallery(), at(0.0, 0.6, 4.5));
    let mut environment_visible = bare.clone();
    environment_visible.set_environment(Some(environment(&map(200.0)))).unwrap();
    for shading in [Shading::Gltf, Shading::Pyrender, Shading::Flat, Shading::Normals] {
        let [a, b] =
            [&bare, &environment_visible].map(|scene| shoot(scene, &CAMERA, &pose, SIZE, &options(shading)));
        assert_eq!(same(&a, &b), shading != Shading::Gltf, "{shading:?}");
    }
    environment_visible.set_environment(None).unwrap();
    let [a, b] = [&bare, &environment_visible]
        .map(|scene| shoot(scene, &CAMERA, &pose, SIZE, &options(Shading::Gltf)));
    assert!(same(&a, &b));
}

#[test]
fn maps_are_the_same_whenever_they_are_made() {
    let [a, b] = [(); 2].map(|()| map(900.0));
    assert!(a.values() == b.values() && a.grids() == b.grids());
    assert!(a.values().iter().all(|v| v.is_finite() && *v >= 0.0));
}

#[cfg(feature = "gpu")]
#[test]
fn devices_shade_by_a_map_as_the_cpu_does() {
    use nanite_rs::render::Renderer;
    use nanite_rs::scene::{Camera, Material, Projection, Scene};

    use crate::gpu_parity::device;
    use crate::gpu_parity::tolerances::{TEXTURED, same_color, same_light};
    use crate::render_frames::{dag, lit};
    use crate::shapes::bumpy_sphere;
    let Some(_) = device("devices_shade_by_a_map_as_the_cpu_does") else { return };
    let mut plain = lit();
    plain.add(dag(&bumpy_sphere(40)), &at(0.3, 0.0, 0.0), Material::default()).unwrap();
    let parallel = Camera { projection: Projection::Orthographic { xmag: Some(2.4), ymag: 1.6 }, ..CAMERA };
    let (dim, bright) = (map(1.0), map(300.0));
    let hidden = Environment { background: false, rotation: -2.0, ..environment(&dim) };
    let mut renderer = Renderer::new(SIZE.0, SIZE.1, "gpu").unwrap();
    let pose = at(0.0, 0.6, 4.5);
    // With it and without, and from one map to another.
    let around = [Some(environment(&bright)), None, Some(hidden), Some(environment(&dim))];
    for (scene, camera) in [(plain, CAMERA), (gallery(), CAMERA), (gallery(), parallel)] {
        for around in &around {
            let mut scene: Scene = scene.clone();
            scene.set_environment(around.clone()).unwrap();
            let options = RenderOptions { device_outputs: Some(true), ..options(Shading::Gltf) };
            let cpu = shoot(&scene, &camera, &pose, SIZE, &options);
            let gpu = renderer.render(&scene, &camera, &pose, &options).unwrap();
            same_color(&gpu.color().unwrap(), &cpu.color().unwrap(), "color");
            let (a, b) = (gpu.linear().unwrap(), cpu.linear().unwrap());
            same_light(&a, &b, TEXTURED, "linear");
        }
    }
}
