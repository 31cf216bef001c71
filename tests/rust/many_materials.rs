//! The ways to shade many materials that `benchmarks/rust/materials/` keeps: they show what the product shows.

use naga::valid::{Capabilities, ValidationFlags, Validator};
use nanite_rs::config::{Output, RenderOptions, Shading};
use nanite_rs::gpu::kernels::{Ibl, MaterialKind, Shadowing, shade};
use nanite_rs::render::Renderer;
use nanite_rs::scene::{Camera, Projection};

use crate::gpu_parity::device;
use crate::gpu_parity::tolerances::same_color;
use crate::materials::{SIZE, gallery};
use crate::render_frames::{CAMERA, at, shoot};

#[path = "../../benchmarks/rust/materials/ways.rs"]
#[allow(dead_code)]
mod ways;

use ways::{OWN, Picture, Shaders, TILE, WAYS, Way, source};

#[test]
fn own_modules_are_valid() {
    for (name, own) in OWN {
        for array_bits in [None, Some(25)] {
            let source = source(
                shade(Output::Color, MaterialKind::Textured, Ibl::Off, Shadowing::Off),
                array_bits,
                own,
            )
            .unwrap();
            let module = naga::front::wgsl::parse_str(&source)
                .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(&source)));
            let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
            if let Err(error) = validator.validate(&module) {
                panic!("{name}: {}", error.emit_to_string(&source));
            }
        }
    }
    // Without materials there are none to sort by.
    assert!(
        source(shade(Output::Color, MaterialKind::Plain, Ibl::Off, Shadowing::Off), None, OWN[0].1).is_err()
    );
}

/// Several instances with materials, one without, and the background; tiles that the picture cuts.
#[test]
fn ways_show_the_same() {
    let Some(_) = device("ways_show_the_same") else { return };
    let (scene, pose) = (gallery(), at(0.0, 0.6, 4.5));
    let materials = scene.instances().iter().filter(|(_, instance)| instance.materials.plain().is_none());
    let materials = materials.map(|(_, instance)| instance.materials.list().len() as u32).sum();
    let tiles = SIZE.0.div_ceil(TILE) * SIZE.1.div_ceil(TILE);
    let parallel = Camera { projection: Projection::Orthographic { xmag: Some(2.4), ymag: 1.6 }, ..CAMERA };
    let mut renderer = Renderer::new(SIZE.0, SIZE.1, "gpu").unwrap();
    for (camera, shading) in [(CAMERA, Shading::Gltf), (parallel, Shading::Pyrender)] {
        let options = RenderOptions {
            outputs: [Output::Color].into_iter().collect(),
            device_outputs: Some(true),
            shading,
            ..RenderOptions::default()
        };
        let gpu = renderer.render(&scene, &camera, &pose, &options).unwrap();
        let cpu = shoot(&scene, &camera, &pose, SIZE, &options);
        let device = renderer.on_device().unwrap();
        let shaders = Shaders::new(device).unwrap();
        let picture = Picture::new(&shaders, device, SIZE, materials, true).unwrap();
        for way in WAYS {
            let found = picture.shade(way).unwrap();
            same_color(&found.colors, &gpu.color().unwrap(), way.name());
            same_color(&found.colors, &cpu.color().unwrap(), way.name());
            // Several to a tile, and no tile on all lists.
            let listed = (tiles..tiles * materials).contains(&found.pairs);
            assert_eq!(listed, way == Way::Tiles, "{} pairs", found.pairs);
        }
    }
}
