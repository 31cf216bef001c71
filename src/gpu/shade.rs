//! Stage 7. Visibility buffer → colour, encoded or not.

use wgpu::Buffer;

use super::lights::Lights;
use super::materials::Buffers;
use super::recorder::{Recorder, SurfaceBindings};
use super::shaders::{Ibl, Kernel, MaterialKind};
use crate::config::Output;

/// What makes an array, and all that it binds.
pub(super) fn kernel<'a>(
    output: Output,
    surface: SurfaceBindings<'a>,
    lights: &'a Lights,
    materials: Option<&'a Buffers>,
) -> (Kernel, Vec<&'a Buffer>) {
    let (lights, environment) = lights.bindings();
    let mut bindings = [&surface[..], &lights].concat();
    let kind = match materials {
        Some(Buffers { materials, texels, .. }) => {
            bindings.extend([materials, texels]);
            MaterialKind::Textured
        }
        None => MaterialKind::Plain,
    };
    let lit = environment && matches!(output, Output::Color | Output::Linear);
    let ibl = if lit { Ibl::On } else { Ibl::Off };
    (Kernel::Shade(output, kind, ibl), bindings)
}

pub(super) fn record(r: &mut Recorder<'_>) {
    for (output, out) in r.buffers.outputs.iter().filter(|(output, _)| output.shaded()) {
        let (kernel, bindings) = kernel(*output, r.surface_bindings(out), r.lights, r.materials);
        r.run(kernel, &bindings, r.picture_workgroups());
    }
}
