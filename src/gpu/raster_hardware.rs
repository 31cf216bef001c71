//! Stages 4 and 5 in another form: clusters of a list → visibility buffer by the rasterizer of the device, one indirect
//! draw with an instance per cluster. Triangles that would have to be clipped are not for it: a device rounds what it
//! clips as it likes, and the same edge has to look the same in compute.

use wgpu::{
    BindGroup, Color, CommandEncoder, Extent3d, LoadOp, Operations, RenderPassColorAttachment,
    RenderPassDescriptor, RenderPassTimestampWrites, StoreOp, TextureDescriptor, TextureDimension,
    TextureUsages, TextureView, TextureViewDescriptor,
};

use super::context::{Context, NO_COLOR};
use super::kernel::{BoundBuffer, Constant, Kernel};
use super::lists::List;
use super::raster::{Onto, Words};
use crate::error::Result;
use crate::gpu_types::DrawArgs;
use crate::limits::{GUARD_BAND, MAX_SPAN};

/// Side of the viewport for pictures of a size, a power of two, so that positions on it are exact; none where it leaves
/// no room for small clusters beside the picture. Devices have viewports as large as their largest textures.
pub(super) fn viewport(largest_texture: u32, (width, height): (u32, u32)) -> Option<u32> {
    // Beyond the guard band everything is clipped anyway.
    let most = largest_texture.min((2.0 * GUARD_BAND) as u32);
    let side: u32 = most.checked_ilog2().map_or(0, |bits| 1 << bits);
    let margin = side.saturating_sub(width.max(height)) / 2;
    (margin > u32::from(MAX_SPAN)).then_some(side)
}

/// Where it draws: what a pass has to have.
#[derive(Debug)]
pub(super) struct Target {
    size: (u32, u32),
    viewport: u32,
    view: TextureView,
}

impl Target {
    /// For pictures of a size that [`choose`] found to fit.
    pub(super) fn new(context: &Context, size: (u32, u32)) -> Result<Self> {
        let (width, height) = size;
        let what = "the pixels that nothing is written to";
        let descriptor = TextureDescriptor {
            label: Some(what),
            size: Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: NO_COLOR,
            usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::TRANSIENT_ATTACHMENT,
            view_formats: &[],
        };
        let bytes = u64::from(width) * u64::from(height);
        let texture = context.within_memory(what, bytes, || context.device().create_texture(&descriptor))?;
        let view = texture.create_view(&TextureViewDescriptor::default());
        let viewport = viewport(context.limits().max_texture_dimension_2d, size).unwrap_or(0);
        Ok(Self { size, viewport, view })
    }

    /// Pixels across and down.
    pub(super) fn size(&self) -> (u32, u32) {
        self.size
    }

    /// Side of the viewport.
    pub(super) fn viewport(&self) -> u32 {
        self.viewport
    }
}

/// Clusters of a list → visibility buffer, by the rasterizer of the device.
pub const fn raster_hardware(list: List, words: Words) -> Kernel {
    let kernel = Kernel::new("raster_hardware", Onto::Picture.bindings());
    let list = Constant::Number("LIST", list as u32);
    Kernel { draws: true, ..kernel }
        .with([words.file(), Onto::Picture.file()])
        .constants([words.constant(), list])
}

pub(super) fn kernels() -> Vec<Kernel> {
    let words = Words::ALL.into_iter().filter(|words| *words != Words::Count);
    words.flat_map(|words| [List::Small, List::Large].map(|list| raster_hardware(list, words))).collect()
}

/// Draws a list of clusters.
pub(super) struct Draw<'a> {
    pub(super) list: List,
    pub(super) words: Words,
    pub(super) split: bool,
    pub(super) group: BindGroup,
    pub(super) draw_args: BoundBuffer<'a>,
    pub(super) target: &'a Target,
    pub(super) times: Option<RenderPassTimestampWrites<'a>>,
}

impl Draw<'_> {
    pub(super) fn record(self, context: &Context, encoder: &mut CommandEncoder) {
        let Self { list, words, split, group, draw_args, target, times } = self;
        let kernel = raster_hardware(list, words);
        let pipeline = context.draw_pipeline(kernel, split);
        let mut pass = encoder.begin_render_pass(&RenderPassDescriptor {
            label: Some(kernel.file),
            color_attachments: &[Some(RenderPassColorAttachment {
                view: &target.view,
                depth_slice: None,
                resolve_target: None,
                ops: Operations { load: LoadOp::Clear(Color::TRANSPARENT), store: StoreOp::Discard },
            })],
            timestamp_writes: times,
            ..RenderPassDescriptor::default()
        });
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        let side = target.viewport as f32;
        let first = |pixels: u32| (pixels / 2) as f32 - 0.5 * side;
        pass.set_viewport(first(target.size.0), first(target.size.1), side, side, 0.0, 1.0);
        let offset = draw_args.offset + list as u64 * size_of::<DrawArgs>() as u64;
        pass.draw_indirect(draw_args.buffer, offset);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn viewports_hold_pictures_and_small_clusters_beside_them() {
        assert_eq!(viewport(16_384, (1280, 720)), Some(16_384));
        assert_eq!(viewport(16_384, (8192, 8192)), Some(16_384));
        // No larger than the guard band, and a power of two.
        assert_eq!(viewport(32_768, (1280, 720)), Some(16_384));
        assert_eq!(viewport(10_000, (1280, 720)), Some(8192));
        assert_eq!(viewport(8192, (8192 - 2 * (u32::from(MAX_SPAN) + 1), 1)), Some(8192));
        assert_eq!(viewport(8192, (1, 8192 - 2 * u32::from(MAX_SPAN))), None);
        assert_eq!(viewport(8192, (8192, 8192)), None);
        assert_eq!(viewport(0, (1, 1)), None);
    }
}
