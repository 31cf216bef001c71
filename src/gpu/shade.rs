//! Stage 7. Visibility buffer → colour, encoded or not.

use wgpu::Buffer;

use super::bindings::{Bindings, SurfaceBindings, bindings};
use super::lights::Lights;
use super::materials::Buffers;
use super::recorder::Recorder;
use super::shaders::{Ibl, Kernel, MaterialKind};
use crate::config::Output;

bindings! {
    /// What `shade` binds behind surfaces.
    Light { lighting, lights, tables }
}

bindings! {
    /// What shading with textures binds behind that.
    Textures { materials, texels }
}

/// What makes an array, and all that it binds.
pub(super) fn kernel<'a>(
    output: Output,
    surface: &SurfaceBindings<'a>,
    lights: &'a Lights,
    materials: Option<&'a Buffers>,
) -> (Kernel, Vec<&'a Buffer>) {
    let Lights { lighting, lights, tables, environment, .. } = lights;
    let light = Light { lighting, lights, tables };
    let mut bindings = [surface.buffers(), light.buffers()].concat();
    let kind = match materials {
        Some(Buffers { materials, texels, .. }) => {
            bindings.extend(Textures { materials, texels }.buffers());
            MaterialKind::Textured
        }
        None => MaterialKind::Plain,
    };
    let lit = environment.is_some() && matches!(output, Output::Color | Output::Linear);
    let ibl = if lit { Ibl::On } else { Ibl::Off };
    (Kernel::Shade(output, kind, ibl), bindings)
}

pub(super) fn record(r: &mut Recorder<'_>) {
    for (output, out) in r.buffers.outputs.iter().filter(|(output, _)| output.shaded()) {
        let (kernel, bindings) = kernel(*output, &r.surface(out), r.lights, r.materials);
        r.run(kernel, &bindings, r.picture_workgroups());
    }
}
