//! The lights of a view on the device, with the steps of bytes and the environment map.

use std::sync::Arc;

use wgpu::{Buffer, BufferUsages};

use super::context::Context;
use super::request::ViewRequest;
use crate::config::Transfer;
use crate::error::Result;
use crate::gpu_types::{self, Lighting};
use crate::scene::EnvironmentMap;

/// What shading needs besides surfaces.
#[derive(Debug)]
pub(super) struct Lights {
    /// [`Lighting`].
    pub(super) lighting: Buffer,
    pub(super) lights: Buffer,
    /// The steps of bytes of a transfer, then what there is of an environment.
    pub(super) tables: Buffer,
    transfer: Transfer,
    pub(super) environment: Option<Arc<EnvironmentMap>>,
}

impl Lights {
    pub(super) fn new(context: &Context) -> Result<Self> {
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let transfer = Transfer::default();
        let steps = transfer.encoder().steps();
        let tables = context.buffer("steps of bytes", size_of_val(steps) as u64, storage)?;
        context.queue().write_buffer(&tables, 0, bytemuck::cast_slice(steps));
        let uniform = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let lighting = context.buffer("light", size_of::<Lighting>() as u64, uniform)?;
        // What is bound has room for one, also where a scene has none.
        let lights = context.buffer("lights", size_of::<gpu_types::Light>() as u64, storage)?;
        Ok(Self { lighting, lights, tables, transfer, environment: None })
    }

    /// Writes the light of a frame.
    pub(super) fn write(&mut self, context: &Context, request: &ViewRequest<'_>) -> Result<()> {
        let ViewRequest { lighting, lights, transfer, environment, .. } = request;
        let known = self.environment.as_ref().map(Arc::as_ptr);
        if (self.transfer, known) != (*transfer, environment.as_ref().map(Arc::as_ptr)) {
            self.write_tables(context, *transfer, environment.as_ref())?;
        }
        let bytes = size_of_val(&lights[..]) as u64;
        if self.lights.size() < bytes {
            self.lights = context.buffer("lights", bytes.next_power_of_two(), self.lights.usage())?;
        }
        context.write("lights", &self.lights, 0, bytemuck::cast_slice(lights))?;
        context.queue().write_buffer(&self.lighting, 0, bytemuck::bytes_of(lighting));
        Ok(())
    }

    fn write_tables(
        &mut self,
        context: &Context,
        transfer: Transfer,
        environment: Option<&Arc<EnvironmentMap>>,
    ) -> Result<()> {
        const WHAT: &str = "the environment of the scene";
        let steps = transfer.encoder().steps();
        let values = environment.map_or(&[][..], |map| map.values());
        let head = size_of_val(steps) as u64;
        // Nothing is known until all is written.
        self.environment = None;
        let bytes = head + size_of_val(values) as u64;
        if self.tables.size() != bytes {
            self.tables = context.buffer(WHAT, bytes, self.tables.usage())?;
        }
        context.queue().write_buffer(&self.tables, 0, bytemuck::cast_slice(steps));
        context.write(WHAT, &self.tables, head, bytemuck::cast_slice(values))?;
        (self.transfer, self.environment) = (transfer, environment.cloned());
        Ok(())
    }
}
