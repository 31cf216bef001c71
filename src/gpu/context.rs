//! A device of wgpu with what this backend needs of it, found once and shared while any renderer lives.

use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};
use std::time::Duration;

use pollster::block_on;
use wgpu::{
    Adapter, Backends, BindGroup, BindGroupDescriptor, BindGroupEntry, Buffer, BufferDescriptor,
    BufferUsages, ComputePipeline, ComputePipelineDescriptor, Device, DeviceDescriptor, DeviceType, Features,
    Instance, InstanceDescriptor, InstanceFlags, Limits, MapMode, PollType, Queue, ShaderModuleDescriptor,
    ShaderSource,
};

use super::shaders::{KERNELS, Kernel, SCAN_WIDTH};
use crate::error::{Error, Result};

/// Storage buffers that a stage binds at most.
pub const STORAGE_BUFFERS: u32 = 14;
/// Bytes of workgroup memory that a stage uses at most.
pub const WORKGROUP_BYTES: u32 = 16 << 10;
/// A frame that takes longer is given up.
const PATIENCE: Duration = Duration::from_secs(60);
/// Trips of the loop that the driver has to finish; those known to be bad stop at 65,535.
const PROBE_TRIPS: u32 = 70_000;
/// 64-bit atomics and all that they need.
const WIDE_ATOMICS: Features = Features::SHADER_INT64.union(Features::SHADER_INT64_ATOMIC_MIN_MAX);

/// A device, ready to run kernels.
#[derive(Debug)]
pub struct Context {
    device: Device,
    queue: Queue,
    name: String,
    software: bool,
    wide_atomics: bool,
    tick: Option<f64>,
    limits: Limits,
    /// The first error that the device reported, which ends its use.
    failure: Arc<Mutex<Option<String>>>,
    /// Of each kernel: with pages in one array, and in several.
    pipelines: [[OnceLock<ComputePipeline>; 2]; KERNELS.len()],
}

/// The error of a backend that cannot be used, or no longer.
pub(super) fn unavailable(message: impl Into<String>) -> Error {
    Error::Backend { backend: "gpu".to_owned(), message: message.into() }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Of what adapters are, the better the larger.
fn rank(adapter: &Adapter) -> u8 {
    match adapter.get_info().device_type {
        DeviceType::DiscreteGpu => 4,
        DeviceType::IntegratedGpu => 3,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other => 1,
        DeviceType::Cpu => 0,
    }
}

/// What of the limits that every stage counts on an adapter lacks.
fn lacking(limits: &Limits) -> Vec<String> {
    [
        ("storage buffers per stage", limits.max_storage_buffers_per_shader_stage, STORAGE_BUFFERS),
        ("bytes of workgroup memory", limits.max_compute_workgroup_storage_size, WORKGROUP_BYTES),
        ("invocations per workgroup", limits.max_compute_invocations_per_workgroup, SCAN_WIDTH),
    ]
    .iter()
    .filter(|(_, has, needs)| has < needs)
    .map(|(what, has, needs)| format!("{has} {what} instead of {needs}"))
    .collect()
}

impl Context {
    /// The device in use, or the best there is. Nothing of Vulkan, Metal or DX12 is loaded before this.
    pub fn shared() -> Result<Arc<Self>> {
        static SHARED: Mutex<Weak<Context>> = Mutex::new(Weak::new());
        let mut shared = lock(&SHARED);
        if let Some(context) = shared.upgrade()
            && context.check().is_ok()
        {
            return Ok(context);
        }
        let context = Arc::new(Self::new()?);
        *shared = Arc::downgrade(&context);
        Ok(context)
    }

    fn new() -> Result<Self> {
        let mut descriptor = InstanceDescriptor::new_without_display_handle();
        descriptor.backends = Backends::PRIMARY;
        // Its checks of indirect dispatches cost one more dispatch each; ours are computed within the limits.
        descriptor.flags = InstanceFlags::empty();
        let instance = Instance::new(descriptor);
        let adapters = block_on(instance.enumerate_adapters(Backends::PRIMARY));
        let Some(adapter) = adapters.into_iter().max_by_key(rank) else {
            return Err(unavailable(
                "there is no Vulkan, Metal or DX12 adapter. Install a driver (in software: Mesa 25 or later with \
                 lavapipe), or use \"cpu\"",
            ));
        };
        let info = adapter.get_info();
        let name = [info.name, info.driver_info].join(", ").trim_end_matches(", ").to_owned();
        let limits = adapter.limits();
        let lacking = lacking(&limits);
        if !lacking.is_empty() {
            return Err(unavailable(format!("{name} has {}", lacking.join(", "))));
        }
        let wide_atomics = adapter.features().contains(WIDE_ATOMICS);
        let descriptor = DeviceDescriptor {
            label: Some("nanite_rs"),
            required_features: adapter.features() & (WIDE_ATOMICS | Features::TIMESTAMP_QUERY),
            required_limits: limits.clone(),
            ..DeviceDescriptor::default()
        };
        let (device, queue) = block_on(adapter.request_device(&descriptor))
            .map_err(|error| unavailable(format!("{name} gives no device: {error}")))?;
        let failure = Arc::new(Mutex::new(None));
        let first = Arc::clone(&failure);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            lock(&first).get_or_insert_with(|| error.to_string());
        }));
        let first = Arc::clone(&failure);
        device.set_device_lost_callback(move |_, message| {
            lock(&first).get_or_insert_with(|| format!("the device was lost. {message}"));
        });
        let software = info.device_type == DeviceType::Cpu;
        let timed = device.features().contains(Features::TIMESTAMP_QUERY);
        let tick = timed.then(|| f64::from(queue.get_timestamp_period()) * 1e-6);
        let pipelines = std::array::from_fn(|_| [OnceLock::new(), OnceLock::new()]);
        let context = Self { device, queue, name, software, wide_atomics, tick, limits, failure, pipelines };
        context.probe()?;
        Ok(context)
    }

    /// Runs a long loop and compares what it gives.
    fn probe(&self) -> Result<()> {
        let seed = 1u32;
        let expected =
            (0..PROBE_TRIPS).fold(seed, |n, trip| (n ^ (n >> 7)).wrapping_mul(1_664_525).wrapping_add(trip));
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let state = self.buffer("loop probe", 8, usage)?;
        let staging = self.buffer("loop probe", 8, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
        self.queue.write_buffer(&state, 0, bytemuck::cast_slice(&[PROBE_TRIPS, seed]));
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(self.pipeline(Kernel::LoopProbe, false));
            pass.set_bind_group(0, &self.bind(Kernel::LoopProbe, false, &[&state]), &[]);
            pass.dispatch_workgroups(1, 1, 1);
        }
        encoder.copy_buffer_to_buffer(&state, 0, &staging, 0, 8);
        let mut found = [0u32; 2];
        self.submit(encoder, &staging, 8, |bytes| {
            bytemuck::cast_slice_mut(&mut found).copy_from_slice(bytes)
        })?;
        if found[1] != expected {
            return Err(unavailable(format!(
                "{} ends loops of shaders early, as Mesa 22 does; it has to be 25 or later",
                self.name
            )));
        }
        Ok(())
    }

    /// The adapter and its driver.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The adapter is a program on the CPU.
    pub fn software(&self) -> bool {
        self.software
    }

    /// The device has 64-bit atomic maxima.
    pub fn wide_atomics(&self) -> bool {
        self.wide_atomics
    }

    /// Milliseconds of a tick of the device's clock, where it has one.
    pub fn tick(&self) -> Option<f64> {
        self.tick
    }

    /// The device of wgpu.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Its queue.
    pub fn queue(&self) -> &Queue {
        &self.queue
    }

    /// The most bytes that a stage can read or write as one array.
    pub fn largest_array(&self) -> u64 {
        self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size)
    }

    /// Gives the device up, as if it had been lost: for tests.
    pub fn lose(&self) {
        self.device.destroy();
    }

    /// The error that the device reported, if it did.
    pub fn check(&self) -> Result<()> {
        match &*lock(&self.failure) {
            Some(message) => Err(unavailable(format!("{}: {message}", self.name))),
            None => Ok(()),
        }
    }

    /// A buffer of zeros. `what` names it where it is too large for the device.
    pub fn buffer(&self, what: &str, bytes: u64, usage: BufferUsages) -> Result<Buffer> {
        let storage = usage.contains(BufferUsages::STORAGE);
        let most = if storage { self.largest_array() } else { self.limits.max_buffer_size };
        if bytes > most {
            let mib = |bytes: u64| bytes.div_ceil(1 << 20);
            return Err(unavailable(format!(
                "{what} take {} MiB, and {} gives at most {} MiB at once",
                mib(bytes),
                self.name,
                mib(most)
            )));
        }
        let size = bytes.max(16).next_multiple_of(4);
        Ok(self.device.create_buffer(&BufferDescriptor {
            label: Some(what),
            size,
            usage,
            mapped_at_creation: false,
        }))
    }

    /// The most words that an array of pages holds, as a power of two.
    pub fn array_bits(&self) -> u32 {
        (self.largest_array() / size_of::<u32>() as u64).ilog2().min(u32::BITS - 2)
    }

    /// The pipeline of a kernel, compiled when first used; `split` where the pages lie in several arrays.
    pub fn pipeline(&self, kernel: Kernel, split: bool) -> &ComputePipeline {
        self.pipelines[kernel.number()][usize::from(split)].get_or_init(|| {
            let label = Some(kernel.name());
            let source = kernel.source(split.then(|| self.array_bits()));
            let source = ShaderSource::Wgsl(source.into());
            let module = self.device.create_shader_module(ShaderModuleDescriptor { label, source });
            self.device.create_compute_pipeline(&ComputePipelineDescriptor {
                label,
                layout: None,
                module: &module,
                entry_point: Some("main"),
                // Shaders write what they read of it.
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..wgpu::PipelineCompilationOptions::default()
                },
                cache: None,
            })
        })
    }

    /// A kernel's bindings, in the order of their numbers.
    pub fn bind(&self, kernel: Kernel, split: bool, buffers: &[&Buffer]) -> BindGroup {
        let entries: Vec<_> = buffers
            .iter()
            .zip(0..)
            .map(|(buffer, binding)| BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let layout = self.pipeline(kernel, split).get_bind_group_layout(0);
        let label = Some(kernel.name());
        self.device.create_bind_group(&BindGroupDescriptor { label, layout: &layout, entries: &entries })
    }

    /// Submits, waits, and hands over the first `bytes` of `staging`, which the submission wrote.
    pub fn submit(
        &self,
        encoder: wgpu::CommandEncoder,
        staging: &Buffer,
        bytes: u64,
        read: impl FnOnce(&[u8]),
    ) -> Result<()> {
        let submission = self.queue.submit([encoder.finish()]);
        self.check()?;
        let (sender, receiver) = std::sync::mpsc::channel();
        let slice = staging.slice(..bytes);
        slice.map_async(MapMode::Read, move |result| {
            // The receiver is gone where waiting failed.
            let _ = sender.send(result);
        });
        let wait = PollType::Wait { submission_index: Some(submission), timeout: Some(PATIENCE) };
        let polled = self.device.poll(wait);
        if polled.is_err() {
            // A lost device says so by a callback, for which somebody has to ask.
            let _ = self.device.poll(PollType::Poll);
        }
        self.check()?;
        polled.map_err(|error| self.fail(&error.to_string()))?;
        // Another thread's wait may have taken the answer along, and be about to call back.
        match receiver.recv_timeout(PATIENCE) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(self.fail(&error.to_string())),
            Err(_) => return Err(self.fail("the device did not answer")),
        }
        let mapped = slice.get_mapped_range().map_err(|error| self.fail(&error.to_string()))?;
        read(&mapped);
        drop(mapped);
        staging.unmap();
        Ok(())
    }

    /// Records a failure, so that the device is not used again.
    fn fail(&self, message: &str) -> Error {
        lock(&self.failure).get_or_insert_with(|| message.to_owned());
        unavailable(format!("{}: {message}", self.name))
    }
}
