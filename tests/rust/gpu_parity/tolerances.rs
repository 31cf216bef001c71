//! By how much shading may differ. `tests/python/oracles/adapters.json` has the limits of each adapter, for Rust and Python.

use nanite_rs::config::{OUTPUTS, Output};
use nanite_rs::gpu::Context;
use nanite_rs::gpu_types::Array;
use nanite_rs::render::Frame;
use serde::Deserialize;

/// What the file says of adapters whose names begin with this one.
#[derive(Deserialize)]
struct Adapter {
    name: String,
    rich: Colors,
    normal: f32,
    light: f32,
    light_most: f32,
    light_share: f64,
}

#[derive(Deserialize)]
struct Colors {
    color: u8,
    share: f64,
}

#[derive(Deserialize)]
struct Limits {
    adapters: Vec<Adapter>,
}

/// The limits of the device.
fn limits() -> Adapter {
    let text = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/python/oracles/adapters.json"));
    let limits: Limits = serde_json::from_str(text).unwrap();
    let device = Context::shared().unwrap();
    limits.adapters.into_iter().find(|adapter| device.name().starts_with(&adapter.name)).unwrap()
}

/// Below this no light is told from another: a hundredth of the smallest step of a byte.
pub const DARK: f32 = 3e-6;

/// The same where textures or environment maps light a pixel: a twentieth of a byte's step, since bent normals magnify
/// what is rounded.
pub const TEXTURED: f32 = 2e-4;

/// Colours before they are encoded. Differences up to `floor` do not count.
pub fn same_light(gpu: &[f32], cpu: &[f32], floor: f32, what: &str) {
    assert_eq!(gpu.len(), cpu.len());
    let limits = limits();
    let beyond = |part: f32| {
        let near = move |(a, b): (&f32, &f32)| (a - b).abs() <= part * a.max(*b) + floor;
        gpu.iter().zip(cpu).enumerate().filter(move |(_, pair)| !near(*pair))
    };
    let (some, many) = (beyond(limits.light_most).count(), beyond(limits.light).count());
    let such: Vec<_> = beyond(limits.light).take(6).collect();
    let few = (limits.light_share * gpu.len() as f64) as usize;
    assert!(some == 0 && many <= few, "{what}: {some}, {many} of {}, such as {such:?}", gpu.len());
}

/// Colours as bytes.
pub fn same_color(gpu: &[u8], cpu: &[u8], what: &str) {
    assert_eq!(gpu.len(), cpu.len());
    let Colors { color, share } = limits().rich;
    let steps = gpu.iter().zip(cpu).map(|(a, b)| a.abs_diff(*b));
    let other = steps.clone().filter(|step| *step > 0).count();
    let most = steps.max().unwrap();
    assert!(most <= color, "{what}: {most} steps");
    assert!(other as f64 <= share * gpu.len() as f64, "{what}: {other} of {}", gpu.len());
}

/// Unit vectors, and what surfaces are: slivers and surfaces that are seen at a slant differ more than others.
fn same_surface(gpu: &[f32], cpu: &[f32], what: &str) {
    let worst = gpu.iter().zip(cpu).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(gpu.len() == cpu.len() && worst <= limits().normal, "{what}: {worst:e}");
}

/// Every array that can be made with a frame. Words are equal, colours all but.
pub fn same_arrays(gpu: &Frame, cpu: &Frame) {
    for output in OUTPUTS {
        match (gpu.array(output).unwrap(), cpu.array(output).unwrap()) {
            (Array::Bytes(ours), Array::Bytes(theirs)) => same_color(&ours, &theirs, output.name()),
            (Array::Floats(ours), Array::Floats(theirs)) if output == Output::Linear => {
                same_light(&ours, &theirs, DARK, output.name())
            }
            (Array::Floats(ours), Array::Floats(theirs)) if output == Output::Normal || output.surface() => {
                same_surface(&ours, &theirs, output.name())
            }
            (ours, theirs) => assert!(ours == theirs, "{}", output.name()),
        }
    }
}
