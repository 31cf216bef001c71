//! Textured surfaces: what materials and textures say is what is seen, on the CPU and on a device.

use std::sync::Arc;

use nanite_rs::Error;
use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, OUTPUTS, Output, RenderOptions, Shading, Transfer};
use nanite_rs::mesh::{Colors, Positions, SourceMesh};
use nanite_rs::model::Dag;
use nanite_rs::render::Frame;
use nanite_rs::scene::image::Pixels;
use nanite_rs::scene::texture::{Mipmaps, Wrap};
use nanite_rs::scene::{
    Camera, Image, InstanceHandle, Light, LightKind, Material, Materials, Projection, Scene, Slot, Texture,
};

use crate::render_frames::{CAMERA, IDENTITY, Pose, at, lit, shoot, turned};
use crate::shapes::{Mesh, bumpy_sphere, grid};

/// A flat square from −1 to 1.
fn flat(side: usize) -> Mesh {
    let (positions, faces) = grid(side, |_, _| 0.0);
    (positions.into_iter().map(|[x, y, z]| [2.0 * x - 1.0, 2.0 * y - 1.0, z]).collect(), faces)
}

pub const SIZE: (u32, u32) = (240, 160);

/// A mesh with two UV sets, colours where wished, and materials by bands.
fn mesh((positions, faces): &Mesh, colors: bool, bands: i32) -> Arc<Dag> {
    let uvs: Vec<[f32; 2]> =
        positions.iter().map(|p| [0.7 * p[0] + 0.2 * p[2], 0.9 * p[1] - 0.1 * p[0]]).collect();
    let others: Vec<[f32; 2]> = positions.iter().map(|p| [-2.0 * p[1], 3.0 * p[0]]).collect();
    let short = |v: f32| (65_535.0 * v.abs().min(1.0)) as u16;
    let tints: Vec<[u16; 4]> = positions.iter().map(|p| [65_535, short(p[0]), short(p[1]), 65_535]).collect();
    let band = |f: &[u32; 3]| ((positions[f[0] as usize][1] + 1.0) * 0.5 * bands as f32) as i32;
    let materials: Vec<i32> = faces.iter().map(|f| band(f).clamp(0, bands - 1)).collect();
    let mut source = SourceMesh::new(Positions::F32(positions), faces);
    source.uvs = vec![&uvs, &others];
    source.colors = colors.then_some(Colors::U16(&tints));
    source.materials = (bands > 1).then_some(&materials);
    Arc::new(build(&source, &BuildOptions::default(), &Silent).unwrap())
}

/// Images of every kind of number, of sides that are no powers of two.
fn images() -> [Arc<Image>; 4] {
    let hash = |i: usize| (i as u32).wrapping_mul(0x9e37_79b1) >> 7;
    let bytes: Vec<u8> = (0..37 * 23 * 3).map(|i| hash(i) as u8).collect();
    let alpha: Vec<u8> = (0..64 * 64 * 4).map(|i| (hash(i / 64) >> 3) as u8).collect();
    let words: Vec<u16> = (0..5 * 90 * 2).map(|i| hash(i) as u16).collect();
    let floats: Vec<f32> = (0..128 * 3).map(|i| (hash(i) & 0xff) as f32 / 64.0).collect();
    [
        Image::new(Pixels::Bytes(&bytes), 37, 23, 3, true),
        Image::new(Pixels::Bytes(&alpha), 64, 64, 4, false),
        Image::new(Pixels::Words(&words), 90, 5, 2, true),
        Image::new(Pixels::Floats(&floats), 128, 1, 3, false),
    ]
    .map(|image| Arc::new(image.unwrap()))
}

/// One texture of many ways each.
fn texture(images: &[Arc<Image>; 4], number: usize) -> Texture {
    let wraps = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
    let turn = 0.3 * number as f32;
    Texture {
        uv_set: (number % 2) as u8,
        wrap: [wraps[number % 3], wraps[number / 3 % 3]],
        linear: number % 4 != 3,
        mipmaps: [Mipmaps::Linear, Mipmaps::Linear, Mipmaps::Nearest, Mipmaps::Off][number / 2 % 4],
        anisotropy: [1, 8, 16][number % 3],
        rows: [[turn.cos(), turn.sin(), 0.1], [-turn.sin(), turn.cos(), -0.4]],
        ..Texture::new(Arc::clone(&images[number % 4]))
    }
}

fn material(images: &[Arc<Image>; 4], number: usize) -> Material {
    let mut material = Material {
        base_color: [0.9, 0.8, 1.0],
        metallic: 0.5 + 0.1 * (number % 5) as f32,
        roughness: 0.9,
        emissive: [0.1 * (number % 3) as f32; 3],
        double_sided: number.is_multiple_of(2),
        smooth: number % 5 != 4,
        normal_scale: 0.7,
        occlusion_strength: 0.6,
        ..Material::default()
    };
    for slot in Slot::ALL {
        if !(number + slot as usize).is_multiple_of(3) {
            material.textures[slot as usize] = Some(texture(images, number * 5 + slot as usize));
        }
    }
    material
}

/// Textured balls and a ground that reaches behind the eye, beside instances without textures.
pub fn gallery() -> Scene {
    let images = images();
    let (ball, bare) = (mesh(&bumpy_sphere(24), true, 5), mesh(&bumpy_sphere(16), false, 1));
    let ground = mesh(&flat(12), false, 1);
    let mut scene = lit();
    for k in 0..3usize {
        let five: Vec<Material> = (0..5).map(|n| material(&images, 5 * k + n)).collect();
        let x = 1.6 * (k as f64 - 1.0);
        let mut pose = turned(at(x, 0.2 * k as f64, -0.5 * k as f64), 0.8 * k as f64);
        if k == 2 {
            // A mirror.
            pose[1][1] = -0.8;
        }
        scene.add(Arc::clone(&ball), &pose, five).unwrap();
    }
    scene.add(bare, &at(0.0, 1.4, -1.0), Material::default()).unwrap();
    let lying: Pose =
        [[9.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.3], [0.0, -9.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    scene.add(ground, &lying, material(&images, 21)).unwrap();
    let pose = glam::DAffine3::from_translation(glam::DVec3::new(0.5, 2.0, 2.0));
    let point = LightKind::Point { range: Some(9.0) };
    scene
        .add_light(Light { kind: point, color: [1.0, 0.8, 0.6], intensity: 9.0, pose, ..Light::default() })
        .unwrap();
    scene
}

fn options(shading: Shading) -> RenderOptions {
    RenderOptions { shading, ..RenderOptions::default() }
}

const SHADINGS: [Shading; 4] = [Shading::Gltf, Shading::Pyrender, Shading::Flat, Shading::Normals];

/// A square of two triangles that fills a view straight on, its UVs 0 to 1 upwards and to the right.
fn poster(material: impl Into<Materials>, colors: Option<[u8; 4]>) -> (Scene, InstanceHandle, Camera) {
    let positions = [[-1.0f32, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]];
    let faces = [[0u32, 1, 2], [0, 2, 3]];
    let uvs = [[0.0f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let colors = colors.map(|color| [color; 4]);
    let mut source = SourceMesh::new(Positions::F32(&positions), &faces);
    source.uvs = vec![&uvs];
    source.colors = colors.as_ref().map(|colors| Colors::U8(colors));
    let dag = Arc::new(build(&source, &BuildOptions::default(), &Silent).unwrap());
    let mut scene = Scene::new();
    let handle = scene.add(dag, &IDENTITY, material).unwrap();
    let projection = Projection::Orthographic { xmag: Some(1.0), ymag: 1.0 };
    (scene, handle, Camera { projection, znear: 0.1, zfar: None })
}

fn look(scene: &Scene, camera: &Camera, size: u32, options: &RenderOptions) -> Frame {
    shoot(scene, camera, &at(0.0, 0.0, 2.0), (size, size), options)
}

#[test]
fn what_is_hidden_changes_no_texture() {
    let (scene, pose) = (gallery(), at(0.0, 0.6, 4.5));
    for shading in SHADINGS {
        let [whole, culled] = [false, true].map(|occlusion| {
            let options = RenderOptions { occlusion, ..options(shading) };
            shoot(&scene, &CAMERA, &pose, SIZE, &options)
        });
        for output in [Output::Color, Output::Linear] {
            assert!(whole.array(output).unwrap() == culled.array(output).unwrap(), "{shading:?}");
        }
        for output in OUTPUTS.into_iter().filter(|output| output.surface()) {
            let numbers = Vec::<f32>::from(whole.array(output).unwrap());
            assert!(numbers.iter().all(|v| v.is_finite()), "{shading:?}: {}", output.name());
            assert!(numbers == Vec::<f32>::from(culled.array(output).unwrap()));
        }
    }
}

#[cfg(feature = "gpu")]
#[test]
fn devices_shade_textures_as_the_cpu_does() {
    use crate::gpu_parity::tolerances::{TEXTURED, same_color, same_light};
    use crate::gpu_parity::{device, on_device};
    let Some(_) = device("devices_shade_textures_as_the_cpu_does") else { return };
    let scene = gallery();
    let pose = at(0.0, 0.6, 4.5);
    let parallel = Camera { projection: Projection::Orthographic { xmag: Some(2.4), ymag: 1.6 }, ..CAMERA };
    for camera in [CAMERA, parallel] {
        for shading in SHADINGS {
            let surface = OUTPUTS.into_iter().filter(|output| output.surface());
            let outputs = [Output::Color, Output::Linear].into_iter().chain(surface.clone()).collect();
            let options = RenderOptions { outputs, device_outputs: Some(true), ..options(shading) };
            let cpu = shoot(&scene, &camera, &pose, SIZE, &options);
            let gpu = on_device(&scene, &camera, &pose, SIZE, &options);
            assert!(cpu.stats.covered_pixels > 20_000);
            same_color(&gpu.color().unwrap(), &cpu.color().unwrap(), "color");
            let (a, b) = (gpu.linear().unwrap(), cpu.linear().unwrap());
            same_light(&a, &b, TEXTURED, &format!("{shading:?}"));
            for output in surface {
                let numbers = |frame: &Frame| Vec::<f32>::from(frame.array(output).unwrap());
                let near = |(a, b): (&f32, &f32)| (a - b).abs() <= 1e-3;
                assert!(numbers(&gpu).iter().zip(&numbers(&cpu)).all(near), "{shading:?}: {}", output.name());
            }
        }
    }
}

#[cfg(feature = "gpu")]
#[test]
fn materials_change_on_a_device_without_a_rebuild() {
    use nanite_rs::render::Renderer;

    use crate::gpu_parity::device;
    use crate::gpu_parity::tolerances::same_color;
    let Some(_) = device("materials_change_on_a_device_without_a_rebuild") else { return };
    let images = images();
    let ball = mesh(&bumpy_sphere(20), false, 3);
    let mut scene = lit();
    let first = scene.add(Arc::clone(&ball), &at(-0.8, 0.0, 0.0), Material::default()).unwrap();
    let second = scene.add(ball, &at(0.8, 0.0, 0.0), Material::default()).unwrap();
    let mut renderer = Renderer::new(SIZE.0, SIZE.1, "gpu").unwrap();
    let pose = at(0.0, 0.0, 4.0);
    let options = RenderOptions { device_outputs: Some(true), ..options(Shading::Gltf) };
    let mut same = |scene: &Scene| {
        let gpu = renderer.render(scene, &CAMERA, &pose, &options).unwrap();
        let cpu = shoot(scene, &CAMERA, &pose, SIZE, &options);
        same_color(&gpu.color().unwrap(), &cpu.color().unwrap(), "color");
        gpu.stats.uploaded_bytes
    };
    same(&scene);
    scene.set_material(second, vec![material(&images, 0), material(&images, 1)]).unwrap();
    same(&scene);
    assert_eq!(same(&scene), 0, "nothing changed");
    scene.set_material(first, material(&images, 7)).unwrap();
    same(&scene);
    scene.set_material(second, Material::default()).unwrap();
    same(&scene);
    scene.set_material(first, Material::default()).unwrap();
    same(&scene);
    scene.remove(first).unwrap();
    let third = scene.add(mesh(&bumpy_sphere(12), true, 1), &IDENTITY, material(&images, 3)).unwrap();
    same(&scene);
    scene.remove(third).unwrap();
    same(&scene);
}

#[test]
fn an_image_is_seen_texel_by_texel() {
    // Straight on, a texel a pixel: the picture is the image, upright, whatever the filter.
    let side = 16u32;
    let bytes: Vec<u8> = (0..side * side * 3).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let image = Arc::new(Image::new(Pixels::Bytes(&bytes), side, side, 3, true).unwrap());
    for linear in [false, true] {
        let mut material = Material { base_color: [1.0; 3], ..Material::default() };
        material.textures[Slot::BaseColor as usize] =
            Some(Texture { linear, ..Texture::new(Arc::clone(&image)) });
        let (scene, _, camera) = poster(material, None);
        let options = RenderOptions { transfer: Transfer::Srgb, ..options(Shading::Flat) };
        assert_eq!(look(&scene, &camera, side, &options).color().unwrap(), bytes);
        // Twice as large with the nearest texel: each four times. Half as large: the first level.
        if !linear {
            let twice = look(&scene, &camera, 2 * side, &options).color().unwrap();
            for (i, pixel) in twice.chunks(3).enumerate() {
                let (x, y) = (i as u32 % (2 * side) / 2, i as u32 / (2 * side) / 2);
                assert_eq!(pixel, &bytes[3 * (y * side + x) as usize..][..3]);
            }
        }
        let half = look(&scene, &camera, side / 2, &options).color().unwrap();
        let start = image.offset(1);
        let level: Vec<u8> = image.words()[start..image.offset(2)]
            .iter()
            .flat_map(|w| w.to_le_bytes()[..3].to_vec())
            .collect();
        assert_eq!(half, level);
    }
}

#[test]
fn shading_is_what_its_name_says() {
    let grey = |value: u8| Arc::new(Image::new(Pixels::Bytes(&[value]), 1, 1, 1, false).unwrap());
    let mut material =
        Material { base_color: [0.5, 0.4, 0.3], occlusion_strength: 0.5, ..Material::default() };
    material.textures[Slot::Occlusion as usize] = Some(Texture::new(grey(51)));
    let (mut scene, _, camera) = poster(material, Some([128, 255, 255, 255]));
    scene.set_ambient_light([1.0, 0.5, 1.0]).unwrap();
    let center = |shading: Shading| {
        let linear = look(&scene, &camera, 9, &options(shading)).linear().unwrap();
        [linear[120], linear[121], linear[122]]
    };
    let close = |got: [f32; 3], expected: [f32; 3]| {
        assert!((0..3).all(|k| (got[k] - expected[k]).abs() < 1e-5), "{got:?} for {expected:?}");
    };
    let half = 128.0 / 255.0;
    close(center(Shading::Flat), [0.5 * half, 0.4, 0.3]);
    // A fifth of the light arrives, half of which counts.
    close(center(Shading::Gltf), [0.6 * 0.5 * half, 0.6 * 0.2, 0.6 * 0.3]);
    // Its strength counts there, too, which pyrender itself does not know.
    close(center(Shading::Pyrender), [0.6 * 0.5 * half, 0.6 * 0.2, 0.6 * 0.3]);
    close(center(Shading::Normals), [0.5, 0.5, 1.0]);
    let frame = look(&scene, &camera, 9, &options(Shading::Gltf));
    let surface = |output: Output| -> [f32; 3] {
        let numbers = Vec::<f32>::from(frame.array(output).unwrap());
        [numbers[120], numbers[121], numbers[122]]
    };
    close(surface(Output::BaseColor), [0.5 * half, 0.4, 0.3]);
    close(surface(Output::ShadingNormal), [0.0, 0.0, 1.0]);
    close(surface(Output::Orm), [0.6, 0.8, 0.2]);
    close(surface(Output::Emissive), [0.0; 3]);
}

#[test]
fn normal_maps_bend_along_the_image() {
    // Normals that lean to the right of the image, and up it.
    for (texel, world) in [([255u8, 128, 128], [1.0f32, 0.0, 0.0]), ([128, 255, 128], [0.0, 1.0, 0.0])] {
        let image = Arc::new(Image::new(Pixels::Bytes(&texel), 1, 1, 3, false).unwrap());
        for mirrored in [false, true] {
            for flipped in [false, true] {
                let mut texture = Texture::new(Arc::clone(&image));
                let mut world = world;
                if flipped {
                    // The image lies upside down on the surface, so that it leans the other way.
                    texture.rows = [[-1.0, 0.0, 1.0], [0.0, 1.0, 0.0]];
                    world = world.map(|c| -c);
                }
                let mut material = Material { double_sided: true, ..Material::default() };
                material.textures[Slot::Normal as usize] = Some(texture);
                let (mut scene, handle, camera) = poster(material, None);
                if mirrored {
                    let mut pose = IDENTITY;
                    pose[0][0] = -1.0;
                    scene.set_pose(handle, &pose).unwrap();
                    world[0] = -world[0];
                }
                let frame = look(&scene, &camera, 5, &options(Shading::Normals));
                let pixel = &frame.linear().unwrap()[36..39];
                for k in 0..3 {
                    let expected = 0.5 + 0.5 * world[k];
                    assert!(
                        (pixel[k] - expected).abs() < 0.01,
                        "{pixel:?} for {world:?}, mirrored {mirrored}"
                    );
                }
            }
        }
    }
}

#[test]
fn back_faces_are_seen_by_the_material_of_their_cluster() {
    // Seen from behind: of five materials, those of even number show their backs.
    let sheet = mesh(&flat(20), false, 5);
    let one = |n: usize| Material {
        base_color: [0.2 * (n + 1) as f32; 3],
        double_sided: n.is_multiple_of(2),
        ..Material::default()
    };
    let mut scene = Scene::new();
    scene.set_ambient_light([1.0; 3]).unwrap();
    scene.add(sheet, &IDENTITY, (0..5).map(one).collect::<Vec<_>>()).unwrap();
    let front = shoot(&scene, &CAMERA, &at(0.0, 0.0, 3.0), SIZE, &options(Shading::Flat));
    let mut behind = turned(at(0.0, 0.0, -3.0), std::f64::consts::PI);
    behind[3] = [0.0, 0.0, 0.0, 1.0];
    let back = shoot(&scene, &CAMERA, &behind, SIZE, &options(Shading::Flat));
    let shades = |frame: &Frame| -> Vec<u8> {
        let color = frame.color().unwrap();
        let mut shades: Vec<u8> = color.chunks(3).map(|c| c[0]).filter(|c| *c != 255).collect();
        shades.sort_unstable();
        shades.dedup();
        shades
    };
    let expected: Vec<u8> =
        (0..5).map(|n| Transfer::Gamma22.encoder().encode(0.2 * (n + 1) as f32)).collect();
    let (all, even): (Vec<u8>, Vec<u8>) =
        (expected[..4].to_vec(), expected.iter().copied().step_by(2).filter(|c| *c != 255).collect());
    assert_eq!((shades(&front), shades(&back)), (all, even));
}

#[test]
fn what_cannot_be_shaded_is_refused() {
    let image = Arc::new(Image::new(Pixels::Bytes(&[255]), 1, 1, 1, true).unwrap());
    let sheet = mesh(&flat(4), false, 1);
    let mut scene = Scene::new();
    let mut material = Material::default();
    material.textures[Slot::Emissive as usize] = Some(Texture { uv_set: 2, ..Texture::new(image) });
    let name = |result: nanite_rs::Result<_>| match result {
        Err(Error::Argument { argument, .. }) => argument,
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("was taken"),
    };
    assert_eq!(
        name(scene.add(Arc::clone(&sheet), &IDENTITY, material.clone()).map(drop)),
        "emissive_texture"
    );
    let handle = scene.add(sheet, &IDENTITY, Material::default()).unwrap();
    assert_eq!(name(scene.set_material(handle, material)), "emissive_texture");
    for (field, bad) in [
        ("alpha", Material { alpha: 1.5, ..Material::default() }),
        ("occlusion_strength", Material { occlusion_strength: -0.1, ..Material::default() }),
        ("normal_scale", Material { normal_scale: f32::NAN, ..Material::default() }),
        ("alpha_cutoff", Material { alpha_cutoff: Some(f32::INFINITY), ..Material::default() }),
    ] {
        assert_eq!(name(scene.set_material(handle, vec![Material::default(), bad])), field);
    }
}

/// A chessboard of holes, red where there is none.
fn lattice(cutoff: f32) -> Material {
    let alpha = |i: usize| if (i % 8 + i / 8).is_multiple_of(2) { 255 } else { 40 };
    let bytes: Vec<u8> = (0..64).flat_map(|i| [255, 30, 20, alpha(i)]).collect();
    let image = Arc::new(Image::new(Pixels::Bytes(&bytes), 8, 8, 4, true).unwrap());
    let mut material = Material {
        base_color: [1.0; 3],
        alpha_cutoff: Some(cutoff),
        double_sided: true,
        ..Material::default()
    };
    material.textures[Slot::BaseColor as usize] = Some(Texture { linear: false, ..Texture::new(image) });
    material
}

#[test]
fn holes_show_what_is_behind() {
    let (mut scene, handle, camera) = poster(lattice(0.5), None);
    let behind = Material { base_color: [0.0, 0.0, 1.0], ..Material::default() };
    scene.add(mesh(&flat(2), false, 1), &at(0.0, 0.0, -1.0), behind).unwrap();
    let options = options(Shading::Flat);
    let red = |frame: &Frame| -> Vec<bool> {
        frame.linear().unwrap().chunks(3).map(|c| c[0] > 0.5 && c[2] < 0.5).collect()
    };
    let frame = look(&scene, &camera, 64, &options);
    let expected: Vec<bool> = (0..64 * 64).map(|i| (i % 64 / 8 + i / 64 / 8) % 2 == 0).collect();
    assert_eq!(red(&frame), expected);
    let depth = frame.depth().unwrap();
    assert!((0..depth.len()).all(|i| (depth[i] - if expected[i] { 2.0 } else { 3.0 }).abs() < 1e-4));
    // Triangles in a hole cover no pixel of it.
    assert!(frame.overdraw().unwrap().iter().zip(&expected).all(|(n, red)| *n == 1 + u32::from(*red)));
    // Depth alone has the same holes.
    let alone = look(&scene, &camera, 64, &RenderOptions { ..RenderOptions::depth_only() });
    assert!(alone.depth().unwrap() == depth);
    // Above and below all alphas of the image.
    scene.set_material(handle, lattice(0.1)).unwrap();
    assert!(red(&look(&scene, &camera, 64, &options)).iter().all(|red| *red));
    scene.set_material(handle, lattice(1.1)).unwrap();
    assert!(!red(&look(&scene, &camera, 64, &options)).iter().any(|red| *red));
    // Without a texture the factor is tested.
    let bare = |alpha| Material {
        alpha,
        alpha_cutoff: Some(0.5),
        base_color: [1.0, 0.0, 0.0],
        ..Material::default()
    };
    scene.set_material(handle, bare(0.4)).unwrap();
    assert!(!red(&look(&scene, &camera, 64, &options)).iter().any(|red| *red));
    scene.set_material(handle, bare(0.5)).unwrap();
    assert!(red(&look(&scene, &camera, 64, &options)).iter().all(|red| *red));
}

/// The gallery, and balls with holes.
#[cfg(feature = "gpu")]
pub fn lattices() -> Scene {
    let mut scene = gallery();
    let ball = mesh(&bumpy_sphere(24), false, 4);
    // Of four materials two have holes; near enough to be clipped, and far.
    let bands = || vec![lattice(0.5), Material::default(), lattice(0.3), Material::default()];
    scene.add(Arc::clone(&ball), &at(0.3, 0.5, 3.4), bands()).unwrap();
    scene.add(ball, &at(-1.0, 1.0, -6.0), bands()).unwrap();
    scene
}

#[cfg(feature = "gpu")]
#[test]
fn devices_leave_the_same_holes() {
    use nanite_rs::config::Raster;

    use crate::gpu_parity::tolerances::same_color;
    use crate::gpu_parity::{device, on_device};
    let Some(_) = device("devices_leave_the_same_holes") else { return };
    let scene = lattices();
    let (pose, size) = (at(0.0, 0.6, 4.5), (96, 64));
    for occlusion in [false, true] {
        for int64_atomics in [true, false] {
            let outputs = [Output::Color, Output::Overdraw].into_iter().collect();
            let options = RenderOptions {
                occlusion,
                int64_atomics,
                outputs,
                raster: Raster::Compute,
                device_outputs: Some(true),
                ..options(Shading::Gltf)
            };
            let cpu = shoot(&scene, &CAMERA, &pose, size, &options);
            let gpu = on_device(&scene, &CAMERA, &pose, size, &options);
            let (a, b) = (cpu.depth().unwrap(), gpu.depth().unwrap());
            let other = a.iter().zip(&b).filter(|(a, b)| a != b).count();
            assert!(1000 * other <= a.len(), "{other} pixels differ");
            if other == 0 {
                same_color(&gpu.color().unwrap(), &cpu.color().unwrap(), "color");
            }
            if !occlusion {
                assert_eq!(gpu.visible(), cpu.visible());
                let (a, b) = (cpu.overdraw().unwrap(), gpu.overdraw().unwrap());
                assert!(1000 * a.iter().zip(&b).filter(|(a, b)| a != b).count() <= a.len());
            }
            let alone =
                RenderOptions { depth_only: true, outputs: RenderOptions::depth_only().outputs, ..options };
            let depth = on_device(&scene, &CAMERA, &pose, size, &alone).depth().unwrap();
            assert!(depth == gpu.depth().unwrap());
        }
    }
}

#[cfg(feature = "gpu")]
#[test]
fn the_devices_rasterizer_leaves_the_same_holes() {
    use nanite_rs::config::Raster;

    use crate::gpu_parity::on_device;
    use crate::gpu_raster::{FORMS, agree, rasterizer};
    let Some(_) = rasterizer("the_devices_rasterizer_leaves_the_same_holes") else { return };
    let scene = lattices();
    let (pose, size) = (at(0.0, 0.6, 4.5), (96, 64));
    for raster in FORMS {
        let options = RenderOptions { raster, ..options(Shading::Gltf) };
        let frame = on_device(&scene, &CAMERA, &pose, size, &options);
        let compute = RenderOptions { raster: Raster::Compute, ..options };
        agree(&frame, &on_device(&scene, &CAMERA, &pose, size, &compute), raster);
    }
}
