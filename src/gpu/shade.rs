//! Stage 7. Visibility buffer → colour, encoded or not.

use super::kernel::{Binding, Bindings, BoundBuffer, Constant, Kernel, bind, bindings};
use super::lights::Lights;
use super::materials::Buffers;
use super::recorder::Recorder;
use super::shadow_table::ShadowBindings;
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

/// Whether something may be in the way of lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shadowing {
    /// No light throws a shadow.
    Off,
    /// Some do.
    On,
}

/// What plain and textured shading binds, without shadows and with them.
const PLAIN: [&[Binding]; 2] = [SurfaceBindings::BINDINGS, Light::BINDINGS];
const TEXTURED: [&[Binding]; 3] = [SurfaceBindings::BINDINGS, Light::BINDINGS, Textures::BINDINGS];
const PLAIN_SHADOWED: [&[Binding]; 3] =
    [SurfaceBindings::BINDINGS, Light::BINDINGS, ShadowBindings::BINDINGS];
const TEXTURED_SHADOWED: [&[Binding]; 4] =
    [SurfaceBindings::BINDINGS, Light::BINDINGS, Textures::BINDINGS, ShadowBindings::BINDINGS];

/// Visibility buffer → colour, encoded or not, or what light meets.
pub fn shade(output: Output, kind: MaterialKind, ibl: Ibl, shadowing: Shadowing) -> Kernel {
    let bindings: &[_] = match (kind, shadowing) {
        (MaterialKind::Plain, Shadowing::Off) => &PLAIN,
        (MaterialKind::Textured, Shadowing::Off) => &TEXTURED,
        (MaterialKind::Plain, Shadowing::On) => &PLAIN_SHADOWED,
        (MaterialKind::Textured, Shadowing::On) => &TEXTURED_SHADOWED,
    };
    let kind = match kind {
        MaterialKind::Plain => "shared/plain",
        MaterialKind::Textured => "shared/textured",
    };
    let ibl = match ibl {
        Ibl::Off => "shared/no_environment",
        Ibl::On => "shared/environment",
    };
    let (shadow, first) = match shadowing {
        Shadowing::Off => ("shared/no_shadow", Constant::None),
        Shadowing::On => {
            let before =
                bindings.iter().map(|list| list.len()).sum::<usize>() - ShadowBindings::BINDINGS.len();
            ("shared/shadow", Constant::Number("SHADOW_BINDING", before as u32))
        }
    };
    let [number, rgb, surface] = output_constants(output);
    Kernel::new("shade", bindings).with([kind, ibl, shadow]).constants([number, rgb, surface, first])
}

/// Whether light makes a difference to it.
fn lit(output: Output) -> bool {
    matches!(output, Output::Color | Output::Linear)
}

pub(super) fn kernels() -> Vec<Kernel> {
    let kinds = |output| {
        let off = (Ibl::Off, Shadowing::Off);
        let lights = [off, (Ibl::On, Shadowing::Off), (Ibl::Off, Shadowing::On), (Ibl::On, Shadowing::On)];
        let all = if lit(output) { lights.to_vec() } else { vec![off] };
        let of = move |(ibl, shadowing): (Ibl, Shadowing)| {
            [MaterialKind::Plain, MaterialKind::Textured].map(|kind| shade(output, kind, ibl, shadowing))
        };
        all.into_iter().flat_map(of).collect::<Vec<_>>()
    };
    OUTPUTS.into_iter().filter(|output| output.shaded()).flat_map(kinds).collect()
}

/// What makes an array, and all that it binds. With shadows, if there are any.
pub(super) fn kernel<'a>(
    output: Output,
    surface: &SurfaceBindings<'a>,
    lights: &'a Lights,
    materials: Option<&'a Buffers>,
    shadows: Option<&ShadowBindings<'a>>,
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
    let shadows = shadows.filter(|_| lit(output));
    bindings.extend(shadows.iter().flat_map(|shadows| shadows.buffers()));
    let shadowing = if shadows.is_some() { Shadowing::On } else { Shadowing::Off };
    (shade(output, kind, ibl, shadowing), bindings)
}

pub(super) fn record(r: &mut Recorder<'_>) {
    for (output, out) in r.buffers.outputs.iter().filter(|(output, _)| output.shaded()) {
        let (kernel, bindings) = kernel(*output, &r.surface(out), r.lights, r.materials, r.shadows.as_ref());
        r.run(kernel, &bindings, r.picture_workgroups());
    }
}
