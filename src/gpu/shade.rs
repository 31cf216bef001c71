//! Stage 7. Visibility buffer → colour, and the lights for it.

use wgpu::{Buffer, BufferUsages};

use super::context::Context;
use super::frame::Recorder;
use super::shaders::Kernel;
use crate::config::Output;
use crate::error::Result;
use crate::gpu_types::{self, Lighting};
use crate::math::Gamma;

/// What shading needs besides surfaces.
#[derive(Debug)]
pub(super) struct Light {
    /// [`Lighting`].
    lighting: Buffer,
    lights: Buffer,
    gamma: Buffer,
}

impl Light {
    pub(super) fn new(context: &Context) -> Result<Self> {
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let steps = Gamma::get().steps();
        let gamma = context.buffer("steps of bytes", size_of_val(steps) as u64, storage)?;
        context.queue().write_buffer(&gamma, 0, bytemuck::cast_slice(steps));
        let uniform = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let lighting = context.buffer("light", size_of::<Lighting>() as u64, uniform)?;
        Ok(Self { lighting, lights: context.buffer("lights", 0, storage)?, gamma })
    }

    /// Writes the lights of a frame.
    pub(super) fn write(
        &mut self,
        context: &Context,
        lighting: &Lighting,
        lights: &[gpu_types::Light],
    ) -> Result<()> {
        let bytes = size_of_val(lights) as u64;
        if self.lights.size() < bytes {
            self.lights = context.buffer("lights", bytes.next_power_of_two(), self.lights.usage())?;
        }
        context.write("lights", &self.lights, 0, bytemuck::cast_slice(lights))?;
        context.queue().write_buffer(&self.lighting, 0, bytemuck::bytes_of(lighting));
        Ok(())
    }
}

pub(super) fn record(r: &mut Recorder<'_>) {
    let Light { lighting, lights, gamma } = r.light;
    for (_, out) in r.buffers.outputs.iter().filter(|(output, _)| *output == Output::Color) {
        let bindings = [&r.surface_bindings(out)[..], &[lighting, lights, gamma]].concat();
        r.run(Kernel::Shade, &bindings, r.picture_workgroups());
    }
}
