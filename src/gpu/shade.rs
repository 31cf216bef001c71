//! Stage 7. Visibility buffer → colour, encoded or not.

use super::kernel::{Bindings, BoundBuffer, Kernel, bind, bindings};
use super::lights::Lights;
use super::materials::Buffers;
use super::recorder::Recorder;
use super::surface::{SurfaceBindings, output_constants};
use crate::config::{OUTPUTS, Output};

bindings! {
    /// What `shade` binds behind surfaces.
    Light { lighting: Uniform, lights: Read, tables: Read }
}

bindings! {
    /// What shading with textures binds behind that.
    Textures { materials: Read, texels: Read }
}

/// What materials the scene has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MaterialKind {
    /// Each instance has a material without textures.
    Plain,
    /// Some have textures, or several materials.
    Textured,
}

/// Whether there is image-based lighting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ibl {
    /// No environment map.
    Off,
    /// An environment map.
    On,
}

/// Visibility buffer → colour, encoded or not, or what light meets.
pub fn shade(output: Output, kind: MaterialKind, ibl: Ibl) -> Kernel {
    let (kind, bindings): (_, &[_]) = match kind {
        MaterialKind::Plain => ("shared/plain", &[SurfaceBindings::BINDINGS, Light::BINDINGS]),
        MaterialKind::Textured => {
            ("shared/textured", &[SurfaceBindings::BINDINGS, Light::BINDINGS, Textures::BINDINGS])
        }
    };
    let ibl = match ibl {
        Ibl::Off => "shared/no_environment",
        Ibl::On => "shared/environment",
    };
    Kernel::new("shade", bindings).with([kind, ibl]).constants(output_constants(output))
}

/// Whether light makes a difference to it.
fn lit(output: Output) -> bool {
    matches!(output, Output::Color | Output::Linear)
}

pub(super) fn kernels() -> Vec<Kernel> {
    let kinds = |output| {
        let all: &[Ibl] = if lit(output) { &[Ibl::Off, Ibl::On] } else { &[Ibl::Off] };
        let of = move |ibl: &Ibl| {
            [MaterialKind::Plain, MaterialKind::Textured].map(|kind| shade(output, kind, *ibl))
        };
        all.iter().flat_map(of).collect::<Vec<_>>()
    };
    OUTPUTS.into_iter().filter(|output| output.shaded()).flat_map(kinds).collect()
}

/// What makes an array, and all that it binds.
pub(super) fn kernel<'a>(
    output: Output,
    surface: &SurfaceBindings<'a>,
    lights: &'a Lights,
    materials: Option<&'a Buffers>,
) -> (Kernel, Vec<BoundBuffer<'a>>) {
    let Lights { lighting, lights, tables, environment, .. } = lights;
    let light = bind!(Light { lighting: lighting, lights: lights, tables: tables });
    let mut bindings = [surface.buffers(), light.buffers()].concat();
    let kind = match materials {
        Some(Buffers { materials, texels, .. }) => {
            bindings.extend(bind!(Textures { materials: materials, texels: texels }).buffers());
            MaterialKind::Textured
        }
        None => MaterialKind::Plain,
    };
    let ibl = if environment.is_some() && lit(output) { Ibl::On } else { Ibl::Off };
    (shade(output, kind, ibl), bindings)
}

pub(super) fn record(r: &mut Recorder<'_>) {
    for (output, out) in r.buffers.outputs.iter().filter(|(output, _)| output.shaded()) {
        let (kernel, bindings) = kernel(*output, &r.surface(out), r.lights, r.materials);
        r.run(kernel, &bindings, r.picture_workgroups());
    }
}
