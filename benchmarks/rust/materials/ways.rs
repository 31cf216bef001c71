//! Three ways to shade a picture of many materials, of one visibility buffer, on one device and by one clock: the
//! product's, one dispatch that looks each pixel's material up; a pass over the picture for each material, told apart by
//! depth; and a dispatch for each material over the tiles in which it occurs. All three run the product's shading.

use std::time::Instant;

use nanite_rs::config::Output;
use nanite_rs::gpu::kernels::{BoundBuffer, Kernel, MAX_WORKGROUPS, WIDTH};
use nanite_rs::gpu::wgpu::{
    self, BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout, BindGroupLayoutDescriptor,
    BindGroupLayoutEntry, BindingResource, BindingType, Buffer, BufferBinding, BufferBindingType,
    BufferUsages, Color, ColorTargetState, ColorWrites, CommandEncoder, CommandEncoderDescriptor,
    CompareFunction, ComputePassDescriptor, ComputePassTimestampWrites, ComputePipeline,
    ComputePipelineDescriptor, DepthStencilState, Extent3d, FragmentState, LoadOp, MultisampleState,
    Operations, PipelineCompilationOptions, PipelineLayout, PipelineLayoutDescriptor, PrimitiveState,
    QuerySet, QuerySetDescriptor, QueryType, RenderPassColorAttachment, RenderPassDepthStencilAttachment,
    RenderPassDescriptor, RenderPassTimestampWrites, RenderPipeline, RenderPipelineDescriptor, ShaderModule,
    ShaderModuleDescriptor, ShaderSource, ShaderStages, StorageTextureAccess, StoreOp, TextureDescriptor,
    TextureDimension, TextureFormat, TextureSampleType, TextureUsages, TextureView, TextureViewDescriptor,
    TextureViewDimension, VertexState,
};
use nanite_rs::gpu::{Context, DeviceRenderer};
use nanite_rs::{Error, Result};

/// Side of a tile, pixels.
pub const TILE: u32 = 64;
/// Side of what a workgroup shades of it.
const BLOCK: u32 = 8;
/// Lanes that look at a tile.
const LANES: u32 = 256;
/// What bits of workgroup memory there are for, and what depths tell apart.
pub const MOST_MATERIALS: u32 = 2048;
/// Where the product's kernels write.
const OUT: u32 = 10;
const NUMBERS: TextureFormat = TextureFormat::R32Uint;
const DEPTH: TextureFormat = TextureFormat::Depth32Float;
/// Bytes between the records of materials, as all devices allow it.
const STRIDE: u64 = 256;
/// Words of an indirect dispatch.
const CALL: u32 = 3;

/// Ways to shade.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// The product's.
    Whole,
    /// A triangle over the picture for each material, at its depth.
    Depth,
    /// An indirect dispatch for each material, over its tiles.
    Tiles,
}

/// All of them, in the order of a round.
pub const WAYS: [Way; 3] = [Way::Whole, Way::Depth, Way::Tiles];

impl Way {
    /// For tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Whole => "one dispatch",
            Self::Depth => "material depth",
            Self::Tiles => "tiles",
        }
    }
}

/// The steps of a way between two timestamps each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IndirectEntry {
    /// Each pixel's material; none where each is looked up when it is shaded.
    Sort,
    /// What shades.
    Shade,
    /// Pixels of a word each → three bytes each.
    Pack,
}

/// How many there are.
pub const INDIRECT_ENTRIES: usize = 3;

/// What a way found, and how long it took.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Three bytes per pixel.
    pub colors: Vec<u8>,
    /// Milliseconds of each step on the device; NaN where it takes no time.
    pub ms: [f64; INDIRECT_ENTRIES],
    /// From the first command recorded to the answer.
    pub wall: f64,
    /// Of tiles: pairs of a material and a tile in which it occurs.
    pub pairs: u32,
}

macro_rules! own {
    ($name:literal) => {
        (concat!($name, ".wgsl"), include_str!(concat!($name, ".wgsl")))
    };
}

/// Files of the benchmark's own: which each of its modules is made of, besides the first.
pub const OWN: [(&str, &str); 4] =
    [own!("material_depth"), own!("classify"), own!("shade_tiles"), own!("pack")];

/// The source of a module: the product's shading, with a material for each pass instead of one for each pixel.
pub fn source(kernel: Kernel, array_bits: Option<u32>, own: &str) -> Result<String> {
    let product = kernel.source(array_bits);
    let (there, here) = ("fn material_of(", "fn own_material(");
    if product.matches(there).count() != 1 {
        return Err(Error::Invariant("the product finds materials in another way".to_owned()));
    }
    let constants = [("TILE", TILE), ("BLOCK", BLOCK), ("LANES", LANES), ("MOST_MATERIALS", MOST_MATERIALS)];
    let constants = constants.map(|(name, value)| format!("const {name}: u32 = {value}u;\n"));
    let shared = include_str!("material.wgsl");
    Ok([&constants.concat(), &product.replace(there, here), shared, own].join("\n"))
}

/// What is compiled once for all pictures.
#[derive(Debug)]
pub struct Shaders {
    kernel: Kernel,
    split: bool,
    surface: BindGroupLayout,
    turns: BindGroupLayout,
    classified: BindGroupLayout,
    tiled: BindGroupLayout,
    packed: BindGroupLayout,
    write_depth: RenderPipeline,
    shade_pixel: RenderPipeline,
    classify: ComputePipeline,
    shade_tiles: ComputePipeline,
    pack: ComputePipeline,
}

fn buffer_type(ty: BufferBindingType, has_dynamic_offset: bool) -> BindingType {
    BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None }
}

fn layout(
    context: &Context,
    types: impl IntoIterator<Item = BindingType>,
    visibility: impl Fn(u32) -> ShaderStages,
) -> BindGroupLayout {
    let entry =
        |(binding, ty)| BindGroupLayoutEntry { binding, visibility: visibility(binding), ty, count: None };
    let entries: Vec<_> = (0..).zip(types).map(entry).collect();
    let descriptor = BindGroupLayoutDescriptor { label: None, entries: &entries };
    context.device().create_bind_group_layout(&descriptor)
}

impl Shaders {
    /// For frames like the last one of this renderer.
    pub fn new(renderer: &DeviceRenderer) -> Result<Self> {
        let context = renderer.context();
        let (kernel, bindings, split) = shading(renderer)?;
        let types = (0..).zip(&bindings).map(|(number, binding)| {
            let ty = match binding.buffer.usage().contains(BufferUsages::UNIFORM) {
                true => BufferBindingType::Uniform,
                false => BufferBindingType::Storage { read_only: number != OUT },
            };
            buffer_type(ty, false)
        });
        let surface = layout(context, types, |number| match number {
            OUT => ShaderStages::COMPUTE,
            _ => ShaderStages::COMPUTE | ShaderStages::FRAGMENT,
        });
        let turn = buffer_type(BufferBindingType::Uniform, true);
        let read = buffer_type(BufferBindingType::Storage { read_only: true }, false);
        let write = buffer_type(BufferBindingType::Storage { read_only: false }, false);
        let view_dimension = TextureViewDimension::D2;
        let access = StorageTextureAccess::WriteOnly;
        let picture = BindingType::StorageTexture { access, format: NUMBERS, view_dimension };
        let sampled = BindingType::Texture {
            sample_type: TextureSampleType::Uint,
            view_dimension,
            multisampled: false,
        };
        let turns = layout(context, [turn], |_| ShaderStages::VERTEX_FRAGMENT);
        let of_compute = |types: &[BindingType]| layout(context, types.to_vec(), |_| ShaderStages::COMPUTE);
        let classified = of_compute(&[turn, write, write, write, picture]);
        let tiled = of_compute(&[turn, read, read, picture]);
        let packed = of_compute(&[turn, sampled]);
        let bits = split.then(|| context.array_bits());
        let [depth, classify, tiles, pack] = OWN.map(|(label, own)| {
            let source = ShaderSource::Wgsl(source(kernel, bits, own)?.into());
            let descriptor = ShaderModuleDescriptor { label: Some(label), source };
            Ok::<_, Error>(context.device().create_shader_module(descriptor))
        });
        let (depth, classify, tiles, pack) = (depth?, classify?, tiles?, pack?);
        let with = |own: &BindGroupLayout| {
            let groups = [Some(&surface), Some(own)];
            let descriptor =
                PipelineLayoutDescriptor { label: None, bind_group_layouts: &groups, immediate_size: 0 };
            context.device().create_pipeline_layout(&descriptor)
        };
        let drawn = with(&turns);
        Ok(Self {
            write_depth: render(context, &drawn, &depth, "write_depth"),
            shade_pixel: render(context, &drawn, &depth, "shade_pixel"),
            classify: compute(context, &with(&classified), &classify, "classify"),
            shade_tiles: compute(context, &with(&tiled), &tiles, "shade_tiles"),
            pack: compute(context, &with(&packed), &pack, "pack"),
            kernel,
            split,
            surface,
            turns,
            classified,
            tiled,
            packed,
        })
    }
}

fn shading(renderer: &DeviceRenderer) -> Result<(Kernel, Vec<BoundBuffer<'_>>, bool)> {
    // `Renderer::render` has one view, of number 0.
    let shading = renderer.shading(0, Output::Color);
    shading.ok_or_else(|| Error::Invariant("the device shaded no colours".to_owned()))
}

/// Draws over the picture: one that shades pixels of one depth, or one that writes depths.
fn render(
    context: &Context,
    layout: &PipelineLayout,
    module: &ShaderModule,
    entry_point: &str,
) -> RenderPipeline {
    let shades = entry_point == "shade_pixel";
    let target = ColorTargetState { format: NUMBERS, blend: None, write_mask: ColorWrites::ALL };
    let targets = [Some(target)];
    let compare = if shades { CompareFunction::Equal } else { CompareFunction::Always };
    context.device().create_render_pipeline(&RenderPipelineDescriptor {
        label: Some(entry_point),
        layout: Some(layout),
        vertex: VertexState {
            module,
            entry_point: Some("corner"),
            compilation_options: PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: PrimitiveState::default(),
        depth_stencil: Some(DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(!shades),
            depth_compare: Some(compare),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: MultisampleState::default(),
        fragment: Some(FragmentState {
            module,
            entry_point: Some(entry_point),
            compilation_options: PipelineCompilationOptions::default(),
            targets: if shades { &targets } else { &[] },
        }),
        multiview_mask: None,
        cache: None,
    })
}

fn compute(
    context: &Context,
    layout: &PipelineLayout,
    module: &ShaderModule,
    entry_point: &str,
) -> ComputePipeline {
    context.device().create_compute_pipeline(&ComputePipelineDescriptor {
        label: Some(entry_point),
        layout: Some(layout),
        module,
        entry_point: Some(entry_point),
        compilation_options: PipelineCompilationOptions {
            zero_initialize_workgroup_memory: false,
            ..PipelineCompilationOptions::default()
        },
        cache: None,
    })
}

/// A picture that was drawn, ready to be shaded in every way.
#[derive(Debug)]
pub struct Picture<'a> {
    shaders: &'a Shaders,
    context: &'a Context,
    size: (u32, u32),
    /// Materials, and one for all instances without a place in the table where there are any.
    materials: u32,
    tiles: (u32, u32),
    whole: BindGroup,
    surface: BindGroup,
    turns: BindGroup,
    classified: BindGroup,
    tiled: BindGroup,
    packed: BindGroup,
    out: Buffer,
    depth: TextureView,
    picture: TextureView,
    draw_args: Buffer,
    /// What [`Self::draw_args`] starts as.
    no_calls: Buffer,
    times: Option<(QuerySet, Buffer)>,
    staging: Buffer,
}

impl<'a> Picture<'a> {
    /// The last frame of a renderer, of so many pixels, with so many materials in its table; `plain` where there are instances
    /// without a place there.
    pub fn new(
        shaders: &'a Shaders,
        renderer: &'a DeviceRenderer,
        size: (u32, u32),
        materials: u32,
        plain: bool,
    ) -> Result<Self> {
        let context = renderer.context();
        let materials = materials + u32::from(plain);
        if materials > MOST_MATERIALS {
            return Err(Error::TooLarge(format!("{materials} materials, the most is {MOST_MATERIALS}")));
        }
        let (kernel, bindings, split) = shading(renderer)?;
        if (kernel, split) != (shaders.kernel, shaders.split) {
            return Err(Error::Invariant(format!("{:?} was compiled, {kernel:?} shaded", shaders.kernel)));
        }
        let out = bindings[OUT as usize].buffer.clone();
        let tiles = (size.0.div_ceil(TILE), size.1.div_ceil(TILE));
        let count = tiles.0 * tiles.1;
        let word = size_of::<u32>() as u64;
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let records = context.buffer(
            "materials",
            STRIDE * u64::from(materials),
            BufferUsages::UNIFORM | BufferUsages::COPY_DST,
        )?;
        for material in 0..materials {
            let record = [material, materials, tiles.0, count];
            context.queue().write_buffer(
                &records,
                STRIDE * u64::from(material),
                bytemuck::cast_slice(&record),
            );
        }
        let numbers = context.buffer("numbers", word * u64::from(size.0 * size.1), storage)?;
        let lists = context.buffer("lists", word * u64::from(materials * count), storage)?;
        let bytes = word * u64::from(CALL * materials);
        let draw_args = storage | BufferUsages::INDIRECT | BufferUsages::COPY_SRC;
        let draw_args = context.buffer("draw_args", bytes, draw_args)?;
        let no_calls = context.buffer("draw_args", bytes, BufferUsages::COPY_DST | BufferUsages::COPY_SRC)?;
        let none = [(TILE / BLOCK).pow(2), 0, 1].repeat(materials as usize);
        context.queue().write_buffer(&no_calls, 0, bytemuck::cast_slice(&none));
        let texture = |format, usage| {
            let (width, height) = size;
            let texture = context.device().create_texture(&TextureDescriptor {
                label: None,
                size: Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format,
                usage: usage | TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            });
            texture.create_view(&TextureViewDescriptor::default())
        };
        let depth = texture(DEPTH, TextureUsages::empty());
        let picture = texture(NUMBERS, TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING);
        let times = context.tick().map(|_| {
            let count = 2 * INDIRECT_ENTRIES as u32;
            let descriptor = QuerySetDescriptor { label: None, ty: QueryType::Timestamp, count };
            let usage = BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC;
            let ticks = context.buffer("times", u64::from(count) * size_of::<u64>() as u64, usage)?;
            Ok::<_, Error>((context.device().create_query_set(&descriptor), ticks))
        });
        let times = times.transpose()?;
        let total = out.size() + draw_args.size() + times.as_ref().map_or(0, |(_, ticks)| ticks.size());
        let bind = |layout: &BindGroupLayout, resources: Vec<BindingResource<'_>>| {
            let entry = |(binding, resource)| BindGroupEntry { binding, resource };
            let entries: Vec<_> = (0..).zip(resources).map(entry).collect();
            let descriptor = BindGroupDescriptor { label: None, layout, entries: &entries };
            context.device().create_bind_group(&descriptor)
        };
        let turn = || {
            let size = std::num::NonZeroU64::new(4 * word);
            BindingResource::Buffer(BufferBinding { buffer: &records, offset: 0, size })
        };
        let (numbers, lists) = (|| numbers.as_entire_binding(), || lists.as_entire_binding());
        let texels = || BindingResource::TextureView(&picture);
        let called = draw_args.as_entire_binding();
        let Shaders { turns, classified, tiled, packed, surface, .. } = shaders;
        Ok(Self {
            whole: context.bind(kernel, &bindings),
            surface: bind(surface, bindings.into_iter().map(BindingResource::from).collect()),
            turns: bind(turns, vec![turn()]),
            classified: bind(classified, vec![turn(), numbers(), lists(), called, texels()]),
            tiled: bind(tiled, vec![turn(), numbers(), lists(), texels()]),
            packed: bind(packed, vec![turn(), texels()]),
            staging: context.buffer("staging", total, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?,
            shaders,
            context,
            size,
            materials,
            tiles,
            out,
            depth,
            picture,
            draw_args,
            no_calls,
            times,
        })
    }
}

impl Picture<'_> {
    /// Shades it once.
    pub fn shade(&self, way: Way) -> Result<Found> {
        let start = Instant::now();
        let mut encoder = self.context.device().create_command_encoder(&CommandEncoderDescriptor::default());
        encoder.clear_buffer(&self.out, 0, None);
        match way {
            Way::Whole => self.shade_whole(&mut encoder),
            Way::Depth => self.shade_by_depth(&mut encoder),
            Way::Tiles => self.shade_by_tiles(&mut encoder),
        }
        if way != Way::Whole {
            let mut pass = self.dispatches(&mut encoder, IndirectEntry::Pack);
            pass.set_pipeline(&self.shaders.pack);
            pass.set_bind_group(0, &self.surface, &[]);
            pass.set_bind_group(1, &self.packed, &[0]);
            self.dispatch_whole(&mut pass);
        }
        if let Some((set, ticks)) = &self.times {
            encoder.resolve_query_set(set, 0..2 * INDIRECT_ENTRIES as u32, ticks, 0);
        }
        let mut parts = vec![&self.out, &self.draw_args];
        parts.extend(self.times.as_ref().map(|(_, ticks)| ticks));
        let mut end = 0;
        for part in parts {
            encoder.copy_buffer_to_buffer(part, 0, &self.staging, end, part.size());
            end += part.size();
        }
        let mut found = Found::default();
        self.context.submit(encoder, &self.staging, end, |staged| {
            found.wall = start.elapsed().as_secs_f64() * 1e3;
            let (colors, rest) = staged.split_at(self.out.size() as usize);
            let (draw_args, ticks) = rest.split_at(self.draw_args.size() as usize);
            found.colors = colors[..3 * (self.size.0 * self.size.1) as usize].to_vec();
            found.ms = self.milliseconds(way, ticks);
            if way == Way::Tiles {
                let draw_args: Vec<u32> = bytemuck::pod_collect_to_vec(draw_args);
                let draw_args = draw_args.chunks_exact(CALL as usize).take(self.materials as usize);
                found.pairs = draw_args.map(|call| call[1]).sum();
            }
        })?;
        Ok(found)
    }

    fn milliseconds(&self, way: Way, ticks: &[u8]) -> [f64; INDIRECT_ENTRIES] {
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(ticks);
        std::array::from_fn(|k| match (way, self.context.tick()) {
            (Way::Whole, Some(_)) if k != IndirectEntry::Shade as usize => 0.0,
            (_, Some(tick)) => ticks[2 * k + 1].saturating_sub(ticks[2 * k]) as f64 * tick,
            (_, None) => f64::NAN,
        })
    }

    fn times(&self, step: IndirectEntry) -> Option<ComputePassTimestampWrites<'_>> {
        let number = 2 * step as u32;
        self.times.as_ref().map(|(query_set, _)| ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(number),
            end_of_pass_write_index: Some(number + 1),
        })
    }

    fn dispatches<'e>(&self, encoder: &'e mut CommandEncoder, step: IndirectEntry) -> wgpu::ComputePass<'e> {
        encoder.begin_compute_pass(&ComputePassDescriptor { label: None, timestamp_writes: self.times(step) })
    }

    /// As many workgroups as lanes that take four pixels each fill.
    fn dispatch_whole(&self, pass: &mut wgpu::ComputePass<'_>) {
        let workgroups = (self.size.0 * self.size.1).div_ceil(4 * WIDTH);
        pass.dispatch_workgroups(workgroups.min(MAX_WORKGROUPS), workgroups.div_ceil(MAX_WORKGROUPS), 1);
    }

    fn shade_whole(&self, encoder: &mut CommandEncoder) {
        let mut pass = self.dispatches(encoder, IndirectEntry::Shade);
        pass.set_pipeline(&self.context.pipeline(self.shaders.kernel, self.shaders.split));
        pass.set_bind_group(0, &self.whole, &[]);
        self.dispatch_whole(&mut pass);
    }

    /// Where the record of a material starts.
    fn offset(material: u32) -> u32 {
        material * STRIDE as u32
    }

    fn shade_by_depth(&self, encoder: &mut CommandEncoder) {
        for step in [IndirectEntry::Sort, IndirectEntry::Shade] {
            let shades = step == IndirectEntry::Shade;
            let ops = Operations { load: LoadOp::Clear(0.0), store: StoreOp::Store };
            // No material is that of what shows none.
            let nothing = Color { r: f64::from(u32::MAX), ..Color::TRANSPARENT };
            let picture = RenderPassColorAttachment {
                view: &self.picture,
                depth_slice: None,
                resolve_target: None,
                ops: Operations { load: LoadOp::Clear(nothing), store: StoreOp::Store },
            };
            let pictures = [Some(picture)];
            let times = self.times(step).map(|times| RenderPassTimestampWrites {
                query_set: times.query_set,
                beginning_of_pass_write_index: times.beginning_of_pass_write_index,
                end_of_pass_write_index: times.end_of_pass_write_index,
            });
            let mut pass = encoder.begin_render_pass(&RenderPassDescriptor {
                color_attachments: if shades { &pictures } else { &[] },
                depth_stencil_attachment: Some(RenderPassDepthStencilAttachment {
                    view: &self.depth,
                    // Read only where there are none.
                    depth_ops: (!shades).then_some(ops),
                    stencil_ops: None,
                }),
                timestamp_writes: times,
                ..RenderPassDescriptor::default()
            });
            let Shaders { write_depth, shade_pixel, .. } = self.shaders;
            pass.set_pipeline(if shades { shade_pixel } else { write_depth });
            pass.set_bind_group(0, &self.surface, &[]);
            for material in 0..if shades { self.materials } else { 1 } {
                pass.set_bind_group(1, &self.turns, &[Self::offset(material)]);
                pass.draw(0..3, 0..1);
            }
        }
    }

    fn shade_by_tiles(&self, encoder: &mut CommandEncoder) {
        encoder.copy_buffer_to_buffer(&self.no_calls, 0, &self.draw_args, 0, self.draw_args.size());
        let mut pass = self.dispatches(encoder, IndirectEntry::Sort);
        pass.set_pipeline(&self.shaders.classify);
        pass.set_bind_group(0, &self.surface, &[]);
        pass.set_bind_group(1, &self.classified, &[0]);
        pass.dispatch_workgroups(self.tiles.0, self.tiles.1, 1);
        drop(pass);
        let mut pass = self.dispatches(encoder, IndirectEntry::Shade);
        pass.set_pipeline(&self.shaders.shade_tiles);
        pass.set_bind_group(0, &self.surface, &[]);
        for material in 0..self.materials {
            pass.set_bind_group(1, &self.tiled, &[Self::offset(material)]);
            let call = CALL * material * size_of::<u32>() as u32;
            pass.dispatch_workgroups_indirect(&self.draw_args, u64::from(call));
        }
    }
}
