//! Stage 4. Clusters of small triangles → visibility buffer, a workgroup per cluster.

use wgpu::Buffer;

use super::kernel::{Bindings, Kernel};
use super::lists::List;
use super::raster::{RasterBindings, Words};
use super::recorder::Recorder;

/// Small clusters → visibility buffer.
pub const fn raster_small(words: Words) -> Kernel {
    let kernel = Kernel::new("raster_small", &[RasterBindings::BINDINGS]);
    kernel.with([words.file()]).constants([words.constant()])
}

pub(super) fn kernels() -> Vec<Kernel> {
    Words::ALL.into_iter().map(raster_small).collect()
}

pub(super) fn record<'a>(r: &mut Recorder<'a>, words: Words, to: &'a Buffer) {
    let bindings = r.raster(to);
    r.run_indirect(raster_small(words), &bindings.buffers(), r.own().draws(), List::Small as u32);
}
