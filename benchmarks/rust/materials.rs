//! Three ways to shade a picture of many materials, in turn, on the device: `cargo bench --bench materials`; with
//! numbers behind `--`, of so many materials. Every picture of every way is compared with what the product makes.

use std::sync::Arc;

use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, Output, RenderOptions, Shading};
use nanite_rs::gpu::Context;
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::Dag;
use nanite_rs::render::Renderer;
use nanite_rs::scene::image::Pixels;
use nanite_rs::scene::{Camera, Image, Light, Material, Projection, Scene, Slot, Texture};

#[path = "materials/ways.rs"]
mod ways;

use ways::{Found, INDIRECT_ENTRIES, IndirectEntry, Picture, Shaders, TILE, WAYS, Way};

const PICTURE: (u32, u32) = (1280, 720);
const MATERIALS: [usize; 4] = [1, 10, 50, 200];
/// Rounds that count, after those that do not.
const ROUNDS: usize = 9;
const WARM_UP: usize = 1;
/// Quads of the sheet across and down, about ten pixels each.
const QUADS: [usize; 2] = [176, 120];
/// Pixels across and down.
const IMAGE: u32 = 192;

/// Where materials lie on the sheet.
#[derive(Clone, Copy, Debug)]
enum Layout {
    /// Each a stripe of its own.
    Stripes,
    /// Of each quad any.
    Scattered,
}

/// What materials have.
#[derive(Clone, Copy, Debug)]
enum Kind {
    /// A texture for the base colour.
    One,
    /// All five, of two images.
    Five,
    /// By turns five, and none.
    Mixed,
}

impl Layout {
    fn name(self) -> &'static str {
        match self {
            Self::Stripes => "stripes",
            Self::Scattered => "scattered",
        }
    }
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::One => "one",
            Self::Five => "five",
            Self::Mixed => "five or none",
        }
    }
}

fn hash(number: usize) -> usize {
    let mixed = (number as u32 ^ 0x5bd1_e995).wrapping_mul(0x9e37_79b1);
    ((mixed ^ mixed >> 15).wrapping_mul(0x85eb_ca6b) >> 8) as usize
}

/// A wavy sheet larger than what the camera sees of it, of so many materials.
fn sheet(layout: Layout, materials: usize) -> Arc<Dag> {
    let [columns, rows] = QUADS;
    let mut positions = Vec::new();
    for row in 0..=rows {
        for column in 0..=columns {
            let x = 2.0 * column as f32 / columns as f32 - 1.0;
            let y = 2.0 * row as f32 / rows as f32 - 1.0;
            positions.push([x, y * rows as f32 / columns as f32, 0.02 * (9.0 * x).sin() * (7.0 * y).cos()]);
        }
    }
    let (mut faces, mut of_faces) = (Vec::new(), Vec::new());
    for row in 0..rows {
        for column in 0..columns {
            let at = |right: usize, up: usize| ((row + up) * (columns + 1) + column + right) as u32;
            faces.extend([[at(0, 0), at(1, 0), at(1, 1)], [at(0, 0), at(1, 1), at(0, 1)]]);
            let material = match layout {
                Layout::Stripes => column * materials / columns,
                Layout::Scattered => hash(row * columns + column) % materials,
            };
            of_faces.extend([material as i32; 2]);
        }
    }
    let uvs: Vec<[f32; 2]> = positions.iter().map(|p| [2.0 * p[0], 2.0 * p[1]]).collect();
    let mut source = SourceMesh::new(Positions::F32(&positions), &faces);
    source.uvs = vec![&uvs];
    source.materials = (materials > 1).then_some(&of_faces);
    Arc::new(build(&source, &BuildOptions::default(), &Silent).expect("a sheet builds"))
}

/// An image that no other material has.
fn image(number: usize) -> Arc<Image> {
    let count = 3 * (IMAGE * IMAGE) as usize;
    let bytes: Vec<u8> = (0..count).map(|i| hash(number * count + i) as u8).collect();
    let image = Image::new(Pixels::Bytes(&bytes), IMAGE, IMAGE, 3, number.is_multiple_of(2));
    Arc::new(image.expect("an image"))
}

fn material(kind: Kind, number: usize) -> Material {
    // Seen where it is another's.
    let base_color = [1, 2, 3].map(|k| 0.2 + (hash(4 * number + k) % 64) as f32 / 80.0);
    let mut material = Material { base_color, emissive: [0.1; 3], ..Material::default() };
    let mut put = |slot: Slot, image: &Arc<Image>| {
        material.textures[slot as usize] = Some(Texture::new(Arc::clone(image)));
    };
    if matches!(kind, Kind::One) || matches!(kind, Kind::Five) || number.is_multiple_of(2) {
        let colors = image(2 * number);
        put(Slot::BaseColor, &colors);
        if !matches!(kind, Kind::One) {
            let rest = image(2 * number + 1);
            put(Slot::Emissive, &colors);
            for slot in [Slot::MetallicRoughness, Slot::Normal, Slot::Occlusion] {
                put(slot, &rest);
            }
        }
    }
    material
}

fn scene(layout: Layout, kind: Kind, count: usize) -> Scene {
    let mut scene = Scene::new();
    scene.set_ambient_light([0.2; 3]).expect("a colour");
    let pose = glam::DAffine3::from_rotation_x(-0.4);
    let light = Light { intensity: 2.0, pose, ..Light::default() };
    scene.add_light(light).expect("a light");
    let materials: Vec<Material> = (0..count).map(|number| material(kind, number)).collect();
    // Turned, so that no line runs along those of pixels and tiles.
    let (sin, cos) = 0.2f64.sin_cos();
    let pose = [[cos, -sin, 0.0, 0.0], [sin, cos, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    scene.add(sheet(layout, count), &pose, materials).expect("an instance");
    scene
}

/// Equal but for what devices may differ by: one step, in a thousandth of the pixels.
fn same(a: &[u8], b: &[u8]) -> bool {
    let differing = a.chunks_exact(3).zip(b.chunks_exact(3)).filter(|(a, b)| a != b).count();
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 1) && differing * 1000 <= a.len() / 3
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Rounds of all ways in turn.
fn measure(picture: &Picture<'_>, product: &[u8]) -> [Vec<Found>; 3] {
    let mut out: [Vec<Found>; 3] = Default::default();
    for round in 0..WARM_UP + ROUNDS {
        // Who comes first changes.
        for k in 0..WAYS.len() {
            let k = (k + round) % WAYS.len();
            let found = picture.shade(WAYS[k]).expect("a picture");
            assert!(same(&found.colors, product), "{} shades otherwise", WAYS[k].name());
            if round >= WARM_UP {
                out[k].push(found);
            }
        }
    }
    out
}

fn print(layout: Layout, kind: Kind, count: usize, measured: &[Vec<Found>; 3]) {
    let wall = |rounds: &[Found]| median(rounds.iter().map(|found| found.wall));
    let sum = |rounds: &[Found]| median(rounds.iter().map(|found| found.ms.iter().sum()));
    let tiles = f64::from(PICTURE.0.div_ceil(TILE) * PICTURE.1.div_ceil(TILE));
    for (way, rounds) in WAYS.iter().zip(measured) {
        let step = |step: IndirectEntry| median(rounds.iter().map(|found| found.ms[step as usize]));
        let pairs = match way {
            Way::Tiles => format!("{:.1}", f64::from(rounds[0].pairs) / tiles),
            _ => String::new(),
        };
        println!(
            "| {} | {} | {count} | {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} | {:.2} | {pairs} |",
            layout.name(),
            kind.name(),
            way.name(),
            step(IndirectEntry::Sort),
            step(IndirectEntry::Shade),
            step(IndirectEntry::Pack),
            sum(rounds),
            wall(rounds),
            wall(rounds) / wall(&measured[0]),
        );
    }
}

fn main() {
    let context = match Context::shared() {
        Ok(context) => context,
        Err(error) => return println!("skipped: {error}"),
    };
    println!("{}; {}×{}, medians of {ROUNDS} rounds", context.name(), PICTURE.0, PICTURE.1);
    println!(
        "\n| layout | textures | materials | way | sort ms | shade ms | pack ms | sum ms | wall ms | wall, × one dispatch | materials of a tile |"
    );
    println!("|{}", "---|".repeat(4 + INDIRECT_ENTRIES + 4));
    let camera =
        Camera { projection: Projection::Perspective { yfov: 0.8, aspect: None }, znear: 0.05, zfar: None };
    // As near as that the sheet covers the picture.
    let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]];
    let options = RenderOptions {
        outputs: [Output::Color].into_iter().collect(),
        device_outputs: Some(true),
        shading: Shading::Gltf,
        pixel_error: 0.0,
        ..RenderOptions::default()
    };
    let counts: Vec<usize> = std::env::args().filter_map(|word| word.parse().ok()).collect();
    let counts = if counts.is_empty() { MATERIALS.to_vec() } else { counts };
    let mut shaders = None;
    for kind in [Kind::One, Kind::Five, Kind::Mixed] {
        for layout in [Layout::Stripes, Layout::Scattered] {
            for &count in &counts {
                let scene = scene(layout, kind, count);
                let mut renderer = Renderer::new(PICTURE.0, PICTURE.1, "gpu").expect("a renderer");
                let frame = renderer.render(&scene, &camera, &pose, &options).expect("a frame");
                let covered = u64::from(PICTURE.0) * u64::from(PICTURE.1);
                assert_eq!(frame.stats.covered_pixels, covered, "the sheet leaves pixels free");
                let device = renderer.on_device().expect("a device");
                let shaders = shaders.get_or_insert_with(|| Shaders::new(device).expect("shaders"));
                let picture = Picture::new(shaders, device, PICTURE, count as u32, false).expect("buffers");
                print(layout, kind, count, &measure(&picture, &frame.color().expect("colours")));
            }
        }
    }
}
