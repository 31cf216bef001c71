//! Arrays for the caller: made on the device, and read back when they are asked for.

use std::sync::Arc;

use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, OUTPUTS, Output, RenderOptions};
use nanite_rs::mesh::{Colors, Positions, SourceMesh};
use nanite_rs::model::ColorFormat;
use nanite_rs::render::{Frame, Renderer, Stage};
use nanite_rs::scene::{Light, LightKind, Material, Scene};

use super::tolerances::{same_arrays, same_color};
use super::{PARALLEL, device, on_device, options, scaled};
use crate::render_frames::{CAMERA, IDENTITY, Pose, at, crowd, dag, lit, shoot, turned};
use crate::shapes::{Mesh, bumpy_sphere, torus};

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
        ..Light::default()
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
