//! Stage 7. Visibility buffer → colour, encoded or not, and the lights for it.

use wgpu::{Buffer, BufferUsages};

use super::context::Context;
use super::frame::{Recorder, SurfaceBindings};
use super::materials::Buffers;
use super::shaders::{Kernel, Skin};
use crate::config::{Output, Transfer};
use crate::error::Result;
use crate::gpu_types::{self, Lighting};

/// What shading needs besides surfaces.
#[derive(Debug)]
pub(super) struct Light {
    /// [`Lighting`].
    lighting: Buffer,
    lights: Buffer,
    /// The steps of bytes of a transfer.
    steps: Buffer,
    transfer: Transfer,
}

impl Light {
    pub(super) fn new(context: &Context) -> Result<Self> {
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let transfer = Transfer::default();
        let values = transfer.encoder().steps();
        let steps = context.buffer("steps of bytes", size_of_val(values) as u64, storage)?;
        context.queue().write_buffer(&steps, 0, bytemuck::cast_slice(values));
        let uniform = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let lighting = context.buffer("light", size_of::<Lighting>() as u64, uniform)?;
        Ok(Self { lighting, lights: context.buffer("lights", 0, storage)?, steps, transfer })
    }

    /// Writes the lights of a frame.
    pub(super) fn write(
        &mut self,
        context: &Context,
        lighting: &Lighting,
        lights: &[gpu_types::Light],
        transfer: Transfer,
    ) -> Result<()> {
        if self.transfer != transfer {
            self.transfer = transfer;
            context.queue().write_buffer(&self.steps, 0, bytemuck::cast_slice(transfer.encoder().steps()));
        }
        let bytes = size_of_val(lights) as u64;
        if self.lights.size() < bytes {
            self.lights = context.buffer("lights", bytes.next_power_of_two(), self.lights.usage())?;
        }
        context.write("lights", &self.lights, 0, bytemuck::cast_slice(lights))?;
        context.queue().write_buffer(&self.lighting, 0, bytemuck::bytes_of(lighting));
        Ok(())
    }
}

/// What makes an array, and all that it binds.
pub(super) fn kernel<'a>(
    output: Output,
    surface: SurfaceBindings<'a>,
    light: &'a Light,
    materials: Option<&'a Buffers>,
) -> (Kernel, Vec<&'a Buffer>) {
    let Light { lighting, lights, steps, .. } = light;
    let mut bindings = [&surface[..], &[lighting, lights, steps]].concat();
    let skin = match materials {
        Some(Buffers { materials, texels, .. }) => {
            bindings.extend([materials, texels]);
            Skin::Textured
        }
        None => Skin::Plain,
    };
    (Kernel::Shade(output, skin), bindings)
}

pub(super) fn record(r: &mut Recorder<'_>) {
    for (output, out) in r.buffers.outputs.iter().filter(|(output, _)| output.shaded()) {
        let (kernel, bindings) = kernel(*output, r.surface_bindings(out), r.light, r.materials);
        r.run(kernel, &bindings, r.picture_workgroups());
    }
}
