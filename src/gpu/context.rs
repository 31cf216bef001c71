//! A device of wgpu with what this backend needs of it, found once and shared while any renderer lives.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};
use std::time::Duration;

use pollster::block_on;
use rustc_hash::FxHashMap;
use wgpu::{
    Adapter, Backends, BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout,
    BindGroupLayoutDescriptor, BindGroupLayoutEntry, BindingResource, BindingType, Buffer, BufferBindingType,
    BufferDescriptor, BufferUsages, ColorTargetState, ColorWrites, CommandEncoder, CommandEncoderDescriptor,
    ComputePassDescriptor, ComputePipeline, ComputePipelineDescriptor, Device, DeviceDescriptor, DeviceType,
    DownlevelFlags, ErrorFilter, Features, FragmentState, Instance, InstanceDescriptor, InstanceFlags,
    Limits, MapMode, MultisampleState, PipelineCompilationOptions, PipelineLayout, PipelineLayoutDescriptor,
    PollType, PrimitiveState, Queue, RenderPipeline, RenderPipelineDescriptor, ShaderModule,
    ShaderModuleDescriptor, ShaderSource, ShaderStages, SubmissionIndex, TextureFormat, VertexState,
};

use super::kernel::{Access, Binding, BindingLists, Bindings, BoundBuffer, Kernel, bindings};
use super::lists::SCAN_WIDTH;
use crate::config::Calibration;
use crate::error::{Error, Result};
use crate::threads::PerProcess;

/// Storage buffers that a stage binds at most.
pub const STORAGE_BUFFERS: u32 = 16;
/// Bytes of workgroup memory that a stage uses at most.
pub const WORKGROUP_BYTES: u32 = 16 << 10;
/// A frame that takes longer is given up.
const LONGEST_WAIT: Duration = Duration::from_secs(60);
/// Trips of the loop that the driver has to finish; those known to be bad stop at 65,535.
const PROBE_TRIPS: u32 = 70_000;
/// Writes of as many bytes go by a buffer of our own, see [`Context::write`].
const LONG_WRITE: usize = 64 << 10;
/// 64-bit atomics and all that they need.
const INT64_ATOMICS: Features = Features::SHADER_INT64.union(Features::SHADER_INT64_ATOMIC_MIN_MAX);

/// What the hardware rasterizer needs of a device besides what every device has: vertex shaders count the triangles that are drawn. Where a
/// device runs them more than once for a vertex, as some that draw in tiles do, they count more.
const RASTER_FEATURES: Features = Features::VERTEX_WRITABLE_STORAGE;
/// Passes that draw have to have a target, which nothing is written to.
pub(super) const NO_COLOR: TextureFormat = TextureFormat::R8Unorm;

/// What of it an adapter lacks, if it does.
fn raster_obstacle(adapter: &Adapter) -> Option<String> {
    let flags = adapter.get_downlevel_capabilities().flags;
    let needs = [
        ("vertex", adapter.features().contains(RASTER_FEATURES)),
        ("fragment", flags.contains(DownlevelFlags::FRAGMENT_WRITABLE_STORAGE)),
    ];
    let lacking: Vec<&str> = needs.iter().filter(|(_, has)| !has).map(|(stage, _)| *stage).collect();
    (!lacking.is_empty()).then(|| format!("its {} shaders cannot write to buffers", lacking.join(" and ")))
}

bindings! {
    /// What `loop_probe` binds.
    LoopProbe { state: Write }
}

/// A long loop, to see whether the driver finishes it.
pub const LOOP_PROBE: Kernel = Kernel::new("loop_probe", &[LoopProbe::BINDINGS]);

/// A device, ready to run kernels.
#[derive(Debug)]
pub struct Context {
    device: Device,
    queue: Queue,
    name: String,
    software: bool,
    int64_atomics: bool,
    tick: Option<f64>,
    limits: Limits,
    /// See [`Context::limit_memory`].
    memory: AtomicU64,
    /// The first error that the device reported, which ends its use.
    failure: Arc<Mutex<Option<String>>>,
    /// By what kernels bind, and the shaders that do.
    layouts: Mutex<FxHashMap<(BindingLists, ShaderStages), BindGroupLayout>>,
    /// Of each kernel: with pages in one array, and in several.
    pipelines: Mutex<FxHashMap<(Kernel, bool), ComputePipeline>>,
    /// What the hardware rasterizer lacks.
    obstacle: Option<String>,
    /// The same of the kernels that draw.
    draws: Mutex<FxHashMap<(Kernel, bool), RenderPipeline>>,
    calibration: OnceLock<Calibration>,
}

/// The error of a backend that cannot be used, or no longer.
pub(super) fn unavailable(message: impl Into<String>) -> Error {
    Error::Backend { backend: "gpu".to_owned(), message: message.into() }
}

/// So many bytes, for messages.
pub(super) fn mib(bytes: u64) -> u64 {
    bytes.div_ceil(1 << 20)
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
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

/// The best adapter. The instance that knows it stays: some drivers can be loaded a few dozen times in a process, and then
/// no more (NVIDIA's 580).
fn adapter() -> Result<Adapter> {
    static INSTANCE: Mutex<Option<Instance>> = Mutex::new(None);
    let mut known = lock(&INSTANCE);
    let instance = known.take().unwrap_or_else(|| {
        let mut descriptor = InstanceDescriptor::new_without_display_handle();
        descriptor.backends = Backends::PRIMARY;
        // Its checks of indirect dispatches cost one more dispatch each; ours are computed within the limits.
        descriptor.flags = InstanceFlags::empty();
        Instance::new(descriptor)
    });
    let adapters = block_on(instance.enumerate_adapters(Backends::PRIMARY));
    let best = adapters.into_iter().max_by_key(rank).ok_or_else(|| {
        unavailable(
            "there is no Vulkan, Metal or DX12 adapter. Install a driver (in software: Mesa 25 or later with \
             lavapipe), or use \"cpu\"",
        )
    })?;
    // Where it knows none, another may once a driver is there.
    *known = Some(instance);
    Ok(best)
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
        static SHARED: PerProcess<Mutex<Weak<Context>>> = PerProcess::new();
        /// The process that first asked for one.
        static FIRST: OnceLock<u32> = OnceLock::new();
        if *FIRST.get_or_init(std::process::id) != std::process::id() {
            return Err(unavailable(
                "the process that this one was forked from had a device, and drivers do not work on both sides of a \
                 fork: start workers with \"spawn\" or \"forkserver\", or use \"cpu\"",
            ));
        }
        let mut shared = lock(SHARED.get());
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
        let adapter = adapter()?;
        let info = adapter.get_info();
        let name = [info.name, info.driver_info].join(", ").trim_end_matches(", ").to_owned();
        let limits = adapter.limits();
        let lacking = lacking(&limits);
        if !lacking.is_empty() {
            return Err(unavailable(format!("{name} has {}", lacking.join(", "))));
        }
        let int64_atomics = adapter.features().contains(INT64_ATOMICS);
        let descriptor = DeviceDescriptor {
            label: Some("nanite_rs"),
            required_features: adapter.features()
                & (INT64_ATOMICS | RASTER_FEATURES | Features::TIMESTAMP_QUERY),
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
        let context = Self {
            device,
            queue,
            name,
            software,
            int64_atomics,
            tick,
            limits,
            memory: AtomicU64::new(u64::MAX),
            failure,
            layouts: Mutex::default(),
            pipelines: Mutex::default(),
            obstacle: raster_obstacle(&adapter),
            draws: Mutex::default(),
            calibration: OnceLock::new(),
        };
        context.probe()?;
        Ok(context)
    }

    /// Runs a long loop and compares what it gives.
    fn probe(&self) -> Result<()> {
        let seed = 1u32;
        let expected =
            (0..PROBE_TRIPS).fold(seed, |n, trip| (n ^ (n >> 7)).wrapping_mul(1_664_525).wrapping_add(trip));
        let found = self.run(LOOP_PROBE, &[&[PROBE_TRIPS, seed]], 1)?;
        if found[0][1] != expected {
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
    pub fn int64_atomics(&self) -> bool {
        self.int64_atomics
    }

    /// Milliseconds of a tick of the device's clock, where it has one.
    pub fn tick(&self) -> Option<f64> {
        self.tick
    }

    /// Why the device's own rasterizer cannot draw, if it cannot.
    pub fn raster_obstacle(&self) -> Option<&str> {
        self.obstacle.as_deref()
    }

    /// The fastest rasterizers, measured when first asked for.
    pub(super) fn calibrated(&self, measure: impl FnOnce(&Self) -> Calibration) -> &Calibration {
        self.calibration.get_or_init(|| measure(self))
    }

    /// The same if it was asked for.
    pub fn calibration(&self) -> Option<&Calibration> {
        self.calibration.get()
    }

    pub(super) fn limits(&self) -> &Limits {
        &self.limits
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

    /// Takes what asks for more bytes at once for a lack of memory: for tests, since a software device never says that it
    /// has none left.
    pub fn limit_memory(&self, most: u64) {
        self.memory.store(most, Ordering::Relaxed);
    }

    /// The error that the device reported, if it did.
    pub fn check(&self) -> Result<()> {
        match &*lock(&self.failure) {
            Some(message) => Err(unavailable(format!("{}: {message}", self.name))),
            None => Ok(()),
        }
    }

    /// An encoder of commands by the name of what they do.
    pub(super) fn encoder(&self, label: &str) -> CommandEncoder {
        self.device.create_command_encoder(&CommandEncoderDescriptor { label: Some(label) })
    }

    /// A buffer of zeros. `what` names it where it is too large for the device.
    pub fn buffer(&self, what: &str, bytes: u64, usage: BufferUsages) -> Result<Buffer> {
        let storage = usage.contains(BufferUsages::STORAGE);
        let most = if storage { self.largest_array() } else { self.limits.max_buffer_size };
        if bytes > most {
            return Err(unavailable(format!(
                "{what} take {} MiB, and {} gives at most {} MiB at once",
                mib(bytes),
                self.name,
                mib(most)
            )));
        }
        let size = bytes.max(16).next_multiple_of(4);
        let descriptor = BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: false };
        self.within_memory(what, size, || self.device.create_buffer(&descriptor))
    }

    /// What `make` gives, unless the device has no memory left for it: then an error that names what so many bytes were
    /// for. The device stays in use.
    pub(super) fn within_memory<T>(&self, what: &str, bytes: u64, make: impl FnOnce() -> T) -> Result<T> {
        let scope = self.device.push_error_scope(ErrorFilter::OutOfMemory);
        let made = make();
        let lacks = block_on(scope.pop()).is_some();
        if lacks || bytes > self.memory.load(Ordering::Relaxed) {
            let size = mib(bytes);
            return Err(unavailable(format!("{} is out of memory: {what} take {size} MiB", self.name)));
        }
        Ok(made)
    }

    /// Writes to a buffer, before what is submitted next. The way there takes memory, too, and where the queue finds none
    /// for it the device is lost; so long writes take it here.
    pub(super) fn write(&self, what: &str, buffer: &Buffer, offset: u64, data: &[u8]) -> Result<()> {
        if data.len() < LONG_WRITE {
            self.queue.write_buffer(buffer, offset, data);
            return Ok(());
        }
        let size = data.len() as u64;
        let usage = BufferUsages::MAP_WRITE | BufferUsages::COPY_SRC;
        let descriptor = BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: true };
        let way = self.within_memory(what, size, || self.device.create_buffer(&descriptor))?;
        self.check()?;
        let mut mapped = way.get_mapped_range_mut(..).map_err(|error| self.fail(&error.to_string()))?;
        mapped.copy_from_slice(data);
        drop(mapped);
        way.unmap();
        let mut encoder = self.encoder(what);
        encoder.copy_buffer_to_buffer(&way, 0, buffer, offset, size);
        self.queue.submit([encoder.finish()]);
        Ok(())
    }

    /// The most words that an array of pages holds, as a power of two.
    pub fn array_bits(&self) -> u32 {
        (self.largest_array() / size_of::<u32>() as u64).ilog2().min(u32::BITS - 2)
    }

    /// Values of `override` constants that a kernel takes here.
    pub(super) fn overrides(&self, kernel: Kernel) -> Vec<(&'static str, f64)> {
        if self.software { kernel.overrides_in_software() } else { Vec::new() }
    }

    /// What a kernel binds, as declared: kernels that bind the same have the same layout.
    fn layout(&self, kernel: Kernel) -> BindGroupLayout {
        let new = || {
            let entry = |(binding, Binding { access, .. }): (u32, Binding)| BindGroupLayoutEntry {
                binding,
                visibility: kernel.visibility(),
                ty: BindingType::Buffer {
                    ty: match access {
                        Access::Uniform => BufferBindingType::Uniform,
                        Access::Read | Access::Write => {
                            BufferBindingType::Storage { read_only: access == Access::Read }
                        }
                    },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            };
            let entries: Vec<_> = (0..).zip(kernel.bound()).map(entry).collect();
            let descriptor = BindGroupLayoutDescriptor { label: Some(kernel.file), entries: &entries };
            self.device.create_bind_group_layout(&descriptor)
        };
        let key = (kernel.bindings, kernel.visibility());
        lock(&self.layouts).entry(key).or_insert_with(new).clone()
    }

    /// The module of a kernel and the layout of its pipeline.
    fn module(&self, kernel: Kernel, split: bool) -> (ShaderModule, PipelineLayout) {
        let label = Some(kernel.file);
        let source = ShaderSource::Wgsl(kernel.source(split.then(|| self.array_bits())).into());
        let module = self.device.create_shader_module(ShaderModuleDescriptor { label, source });
        let bind_group_layouts = &[Some(&self.layout(kernel))];
        let descriptor = PipelineLayoutDescriptor { label, bind_group_layouts, immediate_size: 0 };
        (module, self.device.create_pipeline_layout(&descriptor))
    }

    /// The pipeline of a kernel, compiled when first used; `split` where the pages lie in several arrays.
    pub fn pipeline(&self, kernel: Kernel, split: bool) -> ComputePipeline {
        let split = split && kernel.reads_pages();
        let new = || {
            let (module, layout) = self.module(kernel, split);
            let overrides = self.overrides(kernel);
            self.device.create_compute_pipeline(&ComputePipelineDescriptor {
                label: Some(kernel.file),
                layout: Some(&layout),
                module: &module,
                entry_point: Some("main"),
                // Shaders write what they read of it.
                compilation_options: PipelineCompilationOptions {
                    constants: &overrides,
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            })
        };
        lock(&self.pipelines).entry((kernel, split)).or_insert_with(new).clone()
    }

    /// The same of a kernel that draws.
    pub(super) fn draw_pipeline(&self, kernel: Kernel, split: bool) -> RenderPipeline {
        let new = || {
            let (module, layout) = self.module(kernel, split);
            let overrides = self.overrides(kernel);
            let compilation_options =
                PipelineCompilationOptions { constants: &overrides, ..PipelineCompilationOptions::default() };
            let target = ColorTargetState { format: NO_COLOR, blend: None, write_mask: ColorWrites::empty() };
            self.device.create_render_pipeline(&RenderPipelineDescriptor {
                label: Some(kernel.file),
                layout: Some(&layout),
                vertex: VertexState {
                    module: &module,
                    entry_point: Some("corner"),
                    compilation_options: compilation_options.clone(),
                    buffers: &[],
                },
                primitive: PrimitiveState::default(),
                depth_stencil: None,
                multisample: MultisampleState::default(),
                fragment: Some(FragmentState {
                    module: &module,
                    entry_point: Some("pixel"),
                    compilation_options,
                    targets: &[Some(target)],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        lock(&self.draws).entry((kernel, split)).or_insert_with(new).clone()
    }

    /// What a kernel binds, in the order of the numbers.
    pub fn bind(&self, kernel: Kernel, bound: &[BoundBuffer<'_>]) -> BindGroup {
        let resources = bound.iter().map(|bound| BindingResource::from(*bound));
        let entries: Vec<_> =
            (0..).zip(resources).map(|(binding, resource)| BindGroupEntry { binding, resource }).collect();
        let (label, layout) = (Some(kernel.file), self.layout(kernel));
        self.device.create_bind_group(&BindGroupDescriptor { label, layout: &layout, entries: &entries })
    }

    /// Runs a kernel by itself, on a copy of these words for each of its bindings, and returns what these then hold. For
    /// the probe, and for tests of single kernels. An array of fewer than four words has zeros behind it.
    pub fn run(&self, kernel: Kernel, bindings: &[&[u32]], workgroups: u32) -> Result<Vec<Vec<u32>>> {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let mut buffers = Vec::with_capacity(bindings.len());
        for (binding, words) in kernel.bound().zip(bindings) {
            let usage = if binding.access == Access::Uniform { usage | BufferUsages::UNIFORM } else { usage };
            let buffer = self.buffer(kernel.file, size_of_val(*words) as u64, usage)?;
            self.write(kernel.file, &buffer, 0, bytemuck::cast_slice(words))?;
            buffers.push(buffer);
        }
        let bytes = bindings.iter().map(|words| size_of_val(*words) as u64).sum();
        let staging = self.buffer(kernel.file, bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
        let mut encoder = self.encoder(kernel.file);
        {
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
            pass.set_pipeline(&self.pipeline(kernel, false));
            let whole: Vec<_> = buffers.iter().map(BoundBuffer::from).collect();
            pass.set_bind_group(0, &self.bind(kernel, &whole), &[]);
            pass.dispatch_workgroups(workgroups, 1, 1);
        }
        let mut at = 0;
        for (buffer, words) in buffers.iter().zip(bindings) {
            let bytes = size_of_val(*words) as u64;
            encoder.copy_buffer_to_buffer(buffer, 0, &staging, at, bytes);
            at += bytes;
        }
        let mut found = Vec::with_capacity(bindings.len());
        self.submit(encoder, &staging, bytes, |mut staged| {
            for words in bindings {
                let (own, rest) = staged.split_at(size_of_val(*words));
                found.push(bytemuck::pod_collect_to_vec(own));
                staged = rest;
            }
        })?;
        Ok(found)
    }

    /// Submits, waits, and hands over the first `bytes` of `staging`, which the submission wrote.
    pub fn submit(
        &self,
        encoder: CommandEncoder,
        staging: &Buffer,
        bytes: u64,
        read: impl FnOnce(&[u8]),
    ) -> Result<()> {
        let submission = self.start(encoder)?;
        self.read(submission, staging, bytes, read)
    }

    /// Submits.
    pub(super) fn start(&self, encoder: CommandEncoder) -> Result<SubmissionIndex> {
        let submission = self.queue.submit([encoder.finish()]);
        self.check()?;
        Ok(submission)
    }

    /// Waits for a submission, and hands over the first `bytes` of `staging`, which it wrote.
    pub(super) fn read(
        &self,
        submission: SubmissionIndex,
        staging: &Buffer,
        bytes: u64,
        read: impl FnOnce(&[u8]),
    ) -> Result<()> {
        let (sender, receiver) = std::sync::mpsc::channel();
        let slice = staging.slice(..bytes);
        slice.map_async(MapMode::Read, move |result| {
            // The receiver is gone where waiting failed.
            let _ = sender.send(result);
        });
        let wait = PollType::Wait { submission_index: Some(submission), timeout: Some(LONGEST_WAIT) };
        let polled = self.device.poll(wait);
        if polled.is_err() {
            // A lost device says so by a callback, for which somebody has to ask.
            let _ = self.device.poll(PollType::Poll);
        }
        self.check()?;
        polled.map_err(|error| self.fail(&error.to_string()))?;
        // Another thread's wait may have taken the answer along, and be about to call back.
        match receiver.recv_timeout(LONGEST_WAIT) {
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
