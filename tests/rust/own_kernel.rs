//! Kernels that only tests have, made of the product's shared files.

use bytemuck::Pod;
use nanite_rs::gpu::Context;
use nanite_rs::gpu::wgpu::{
    self, BindGroupDescriptor, BindGroupEntry, BufferUsages, CommandEncoderDescriptor, ComputePassDescriptor,
    ComputePipelineDescriptor, ShaderModuleDescriptor, ShaderSource,
};

/// A shared file by its name.
macro_rules! shared {
    ($name:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/shared/", $name, ".wgsl"))
    };
}
pub(crate) use shared;

/// Runs `main` of a source in workgroups of 64 for so many items. Its storage buffers are these, which it reads, and then one
/// of `made` values, which it writes and which come back.
pub fn run<T: Pod>(
    context: &Context,
    source: String,
    constants: &[(&str, f64)],
    inputs: &[&[u8]],
    items: usize,
    made: usize,
) -> Vec<T> {
    let device = context.device();
    let source = ShaderSource::Wgsl(source.into());
    let module = device.create_shader_module(ShaderModuleDescriptor { label: None, source });
    let pipeline = device.create_compute_pipeline(&ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some("main"),
        compilation_options: wgpu::PipelineCompilationOptions {
            constants,
            ..wgpu::PipelineCompilationOptions::default()
        },
        cache: None,
    });
    let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
    let made = (size_of::<T>() * made) as u64;
    let sizes = inputs.iter().map(|bytes| bytes.len() as u64).chain([made]);
    let buffers: Vec<_> = sizes.map(|bytes| context.buffer("numbers", bytes, storage).unwrap()).collect();
    let read = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
    let staging = context.buffer("numbers", made, read).unwrap();
    for (buffer, bytes) in buffers.iter().zip(inputs) {
        context.queue().write_buffer(buffer, 0, bytes);
    }
    let layout = pipeline.get_bind_group_layout(0);
    let entries: Vec<_> = (0..)
        .zip(&buffers)
        .map(|(binding, buffer)| BindGroupEntry { binding, resource: buffer.as_entire_binding() })
        .collect();
    let bound =
        device.create_bind_group(&BindGroupDescriptor { label: None, layout: &layout, entries: &entries });
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bound, &[]);
        let workgroups = items.div_ceil(64) as u32;
        pass.dispatch_workgroups(workgroups.min(1024), workgroups.div_ceil(1024), 1);
    }
    encoder.copy_buffer_to_buffer(buffers.last().unwrap(), 0, &staging, 0, made);
    let mut found = Vec::new();
    context.submit(encoder, &staging, made, |bytes| found = bytemuck::pod_collect_to_vec(bytes)).unwrap();
    found
}
