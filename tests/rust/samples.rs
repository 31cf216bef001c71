//! Several samples of a pixel: where they are, what their mean is, and that all else stays as it is.

use std::f64::consts::FRAC_PI_2;

use nanite_rs::config::{OUTPUTS, Output, RenderOptions, Samples, Transfer};
#[cfg(feature = "gpu")]
use nanite_rs::model::UNINTERRUPTED;
use nanite_rs::render::{Frame, Stage};
#[cfg(feature = "gpu")]
use nanite_rs::render::{Renderer, ViewDesc};
use nanite_rs::scene::{Camera, Material, Projection, Scene};

#[cfg(feature = "gpu")]
use crate::gpu_parity::device;
#[cfg(feature = "gpu")]
use crate::gpu_parity::tolerances::{DARK, same_light};
use crate::render_frames::{CAMERA, IDENTITY, at, crowd, dag, lit, shoot};
use crate::shapes::bumpy_sphere;

const SEVERAL: [Samples; 2] = [Samples::Four, Samples::Sixteen];

fn sampled(samples: Samples) -> RenderOptions {
    RenderOptions { samples, ..RenderOptions::default() }
}

/// Everything but colour.
fn same_but_colour(a: &Frame, b: &Frame) {
    assert!(a.words().unwrap() == b.words().unwrap());
    for output in OUTPUTS.into_iter().filter(|output| !output.shaded()) {
        assert!(a.array(output).unwrap() == b.array(output).unwrap(), "{}", output.name());
    }
    assert!(a.visible() == b.visible());
    let counts =
        |f: &Frame| (f.stats.clusters, f.stats.triangles, f.stats.drawn_small, f.stats.covered_pixels);
    assert_eq!(counts(a), counts(b));
}

/// A triangle that glows, larger than the picture but for one edge, which crosses the picture near its middle.
#[test]
fn an_edge_covers_what_it_covers() {
    // pyrender, whose shading is the default, multiplies by it twice.
    let glow = Material { base_color: [0.0; 3], emissive: [1.0, 0.5, 0.25], ..Material::default() };
    let parallel = Projection::Orthographic { xmag: Some(1.0), ymag: 1.0 };
    let camera = Camera { projection: parallel, znear: 0.05, zfar: None };
    let side = 32u32;
    let pixel_side = 2.0 / f64::from(side);
    for angle in [0.0f64, 0.1, 0.5, 0.785, 1.2, FRAC_PI_2, 2.2, 4.0] {
        let (along, inwards) = ([angle.cos(), angle.sin()], [-angle.sin(), angle.cos()]);
        let corner = |a: f64, b: f64| {
            [(a * along[0] + b * inwards[0]) as f32, (a * along[1] + b * inwards[1]) as f32, 0.0]
        };
        let middle = 0.013;
        let mesh = (vec![corner(-9.0, middle), corner(9.0, middle), corner(0.0, 9.0)], vec![[0, 1, 2]]);
        let mut scene = Scene::new();
        scene.set_bg_color([0.0; 3]).unwrap();
        scene.add(dag(&mesh), &IDENTITY, glow.clone()).unwrap();
        for samples in SEVERAL {
            let count = f64::from(samples as u32);
            let frame = shoot(&scene, &camera, &at(0.0, 0.0, 2.0), (side, side), &sampled(samples));
            let light = frame.linear().unwrap();
            let (mut edge, mut sum, mut most) = (0, 0.0, 0.0f64);
            for (pixel, rgb) in light.as_chunks::<3>().0.iter().enumerate() {
                let center = [pixel as u32 % side, pixel as u32 / side].map(|v| f64::from(v) + 0.5);
                // Pixels from the edge to a point so far from the centre, right and down.
                let inside = |[x, y]: [f64; 2]| {
                    let (x, y) = ((center[0] + x) * pixel_side - 1.0, 1.0 - (center[1] + y) * pixel_side);
                    (x * inwards[0] + y * inwards[1] - middle) / pixel_side
                };
                // Vertices are moved to 1/256 of a pixel.
                let within = |reach: f64| samples.offsets().iter().filter(|at| inside(**at) > reach).count();
                let got = f64::from(rgb[0]);
                let drawn = (got * count).round() as usize;
                assert!((within(0.01)..=within(-0.01)).contains(&drawn), "{angle}, {samples:?}, {pixel}");
                assert!((got * count - drawn as f64).abs() < 1e-5);
                assert!((rgb[1] - 0.25 * rgb[0]).abs() < 1e-6 && (rgb[2] - 0.0625 * rgb[0]).abs() < 1e-6);
                // The area, by many points.
                let fine = 64;
                let part = |k: u32| (f64::from(k) + 0.5) / f64::from(fine) - 0.5;
                let points = (0..fine * fine).filter(|k| inside([part(k % fine), part(k / fine)]) >= 0.0);
                let area = points.count() as f64 / f64::from(fine * fine);
                if area > 0.0 && area < 1.0 {
                    (edge, sum, most) = (edge + 1, sum + (got - area).abs(), most.max((got - area).abs()));
                }
            }
            assert!(edge >= side && sum / f64::from(edge) <= 1.0 / count, "{angle}, {samples:?}");
            let straight = angle == 0.0 || angle == FRAC_PI_2;
            // What these patterns are off by at most, over all lines.
            let bound = match samples {
                _ if straight => 1.0 / count,
                Samples::Sixteen => 0.15,
                _ => 0.31,
            };
            assert!(most <= bound, "{angle}, {samples:?}: {most}");
        }
    }
}

#[test]
fn the_mean_is_that_of_pictures_moved_by_hand() {
    let mut scene = lit();
    scene.set_bg_color([0.5, 0.2, 0.7]).unwrap();
    scene.add(dag(&bumpy_sphere(40)), &IDENTITY, Material::default()).unwrap();
    let (width, height) = (120, 80);
    for samples in SEVERAL {
        let mut mean = vec![0.0f64; 3 * width as usize * height as usize];
        let options = |samples| RenderOptions { pixel_error: 0.0, ..sampled(samples) };
        let lens = |x: f64, y: f64| Camera {
            projection: Projection::Intrinsics {
                fx: 110.0,
                fy: 105.0,
                cx: 60.0 - x,
                cy: 40.0 - y,
                skew: 0.0,
            },
            znear: 0.05,
            zfar: None,
        };
        for [x, y] in samples.offsets() {
            let one = shoot(&scene, &lens(x, y), &at(0.1, 0.2, 3.0), (width, height), &options(Samples::One));
            let light = one.linear().unwrap();
            mean.iter_mut().zip(light).for_each(|(m, c)| *m += f64::from(c) / f64::from(samples as u32));
        }
        let frame = shoot(&scene, &lens(0.0, 0.0), &at(0.1, 0.2, 3.0), (width, height), &options(samples));
        let light = frame.linear().unwrap();
        assert!(light.iter().zip(&mean).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5));
        assert_eq!((frame.stats.samples, light[0]), (samples as u32, Transfer::Gamma22.light(128)));
        assert!(frame.array(Output::Linear).unwrap() == frame.make(Output::Linear).unwrap());
    }
}

#[test]
fn only_colour_depends_on_samples() {
    let scene = crowd();
    let pose = at(0.0, 0.0, 6.0);
    let plain = shoot(&scene, &CAMERA, &pose, (320, 200), &RenderOptions::default());
    assert_eq!(plain.stats.samples, 1);
    let received = |frame: &Frame, stage| {
        frame.stats.stages.iter().filter(|s| s.stage == stage).map(|s| s.received).sum::<u64>()
    };
    for samples in SEVERAL {
        let frame = shoot(&scene, &CAMERA, &pose, (320, 200), &sampled(samples));
        same_but_colour(&frame, &plain);
        assert!(frame.color().unwrap() != plain.color().unwrap());
        let passes = samples as u64 + 1;
        let instances = received(&plain, Stage::InstanceCull) / 121;
        assert!(instances > 0 && received(&frame, Stage::InstanceCull) >= 121 * passes);
        // A color is what light encodes, in any transfer.
        for transfer in [Transfer::Gamma22, Transfer::Srgb, Transfer::Linear] {
            let frame =
                shoot(&scene, &CAMERA, &pose, (64, 40), &RenderOptions { transfer, ..sampled(samples) });
            let encoded = |c: &f32| (transfer.encode(f64::from(c.min(1.0))) * 255.0).round() as u8;
            let expected: Vec<u8> = frame.linear().unwrap().iter().map(encoded).collect();
            let differ = frame.color().unwrap().iter().zip(&expected).filter(|(a, b)| a != b).count();
            assert_eq!(differ, 0, "{transfer:?}");
        }
    }
}

#[test]
fn every_pass_has_the_same_cut() {
    let mut scene = lit();
    scene.add(dag(&bumpy_sphere(120)), &IDENTITY, Material::default()).unwrap();
    let counts = |samples| {
        let options = RenderOptions { occlusion: false, ..sampled(samples) };
        let frame = shoot(&scene, &CAMERA, &at(0.0, 0.0, 3.0), (640, 480), &options);
        let of = |stage| frame.stats.stages.iter().find(|s| s.stage == stage).map(|s| (s.received, s.passed));
        let (nodes, clusters) = (of(Stage::NodeCull).unwrap(), of(Stage::ClusterCull).unwrap());
        [nodes.0, nodes.1, clusters.0, clusters.1]
    };
    let one = counts(Samples::One);
    for samples in SEVERAL {
        assert_eq!(counts(samples), one.map(|count| (samples as u64 + 1) * count));
    }
}

#[test]
fn where_nothing_is_in_sight_the_background_is_exact() {
    let mut scene = lit();
    scene.set_bg_color([0.1, 0.5, 0.9]).unwrap();
    for transfer in [Transfer::Gamma22, Transfer::Srgb, Transfer::Linear] {
        for samples in [Samples::One, Samples::Four, Samples::Sixteen] {
            let options = RenderOptions { transfer, ..sampled(samples) };
            let frame = shoot(&scene, &CAMERA, &IDENTITY, (5, 3), &options);
            let light = [26, 128, 230].map(|byte| transfer.light(byte));
            assert!(frame.color().unwrap().as_chunks::<3>().0.iter().all(|rgb| *rgb == [26, 128, 230]));
            assert!(frame.linear().unwrap().as_chunks::<3>().0.iter().all(|rgb| *rgb == light));
            assert_eq!(frame.deep_color().unwrap()[..3], [26 * 257, 128 * 257, 230 * 257]);
        }
    }
}

#[test]
fn what_cannot_be_is_refused() {
    for count in [0, 2, 3, 5, 8, 17, u32::MAX] {
        let message = Samples::try_from(count).unwrap_err().to_string();
        assert_eq!(message, format!("samples: must be 1, 4 or 16, not {count}"));
    }
    assert_eq!(Samples::try_from(16).unwrap(), Samples::Sixteen);
    let message = "gamma".parse::<Transfer>().unwrap_err().to_string();
    assert!(message.starts_with("transfer: must be \"gamma22\", \"srgb\" or \"linear\""), "{message}");
    let depth = RenderOptions { samples: Samples::Four, ..RenderOptions::depth_only() };
    assert!(depth.validate().unwrap_err().to_string().starts_with("samples: "));
}

#[cfg(feature = "gpu")]
#[test]
fn a_device_samples_as_the_cpu_does() {
    use nanite_rs::config::Raster;
    let Some(_) = device("a_device_samples_as_the_cpu_does") else { return };
    let mut scene = crowd();
    scene.set_bg_color([0.2, 0.4, 0.6]).unwrap();
    let size = (160, 100);
    let parallel = Camera {
        projection: Projection::Orthographic { xmag: Some(3.0), ymag: 2.0 },
        znear: 0.05,
        zfar: None,
    };
    let views = [(CAMERA, at(0.0, 0.0, 6.0)), (parallel, at(0.3, 0.1, 4.0))];
    for samples in [Samples::One, Samples::Four, Samples::Sixteen] {
        for (device_outputs, occlusion, transfer) in
            [(true, false, Transfer::Srgb), (true, true, Transfer::Gamma22), (false, true, Transfer::Linear)]
        {
            let options = RenderOptions {
                device_outputs: Some(device_outputs),
                occlusion,
                transfer,
                raster: Raster::Compute,
                outputs: [Output::Color, Output::Linear, Output::Depth].into_iter().collect(),
                ..sampled(samples)
            };
            let mut on_device = Renderer::new(size.0, size.1, "gpu").unwrap();
            let mut on_cpu = Renderer::new(size.0, size.1, "cpu").unwrap();
            let cpu =
                on_cpu.render_views(&scene, &ViewDesc::numbered(&views), &options, UNINTERRUPTED).unwrap();
            // Again with what is known of the frame before.
            for _ in 0..2 {
                let gpu = on_device
                    .render_views(&scene, &ViewDesc::numbered(&views), &options, UNINTERRUPTED)
                    .unwrap();
                for (gpu, cpu) in gpu.iter().zip(&cpu) {
                    same_light(&gpu.linear().unwrap(), &cpu.linear().unwrap(), DARK, "linear");
                    assert!(gpu.array(Output::Depth).unwrap() == cpu.array(Output::Depth).unwrap());
                    let colors = gpu.color().unwrap().into_iter().zip(cpu.color().unwrap());
                    assert!(colors.into_iter().all(|(a, b)| a.abs_diff(b) <= 1));
                    assert_eq!(gpu.stats.samples, samples as u32);
                }
            }
        }
    }
}
