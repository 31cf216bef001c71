//! Stage 4. Clusters of small triangles → visibility buffer, a workgroup per cluster.

use wgpu::Buffer;

use super::kernel::Kernel;
use super::lists::List;
use super::raster::{Onto, Words, forms};
use super::recorder::Recorder;

/// Small clusters → visibility buffer.
pub const fn raster_small(onto: Onto, words: Words) -> Kernel {
    let kernel = Kernel::new("raster_small", onto.bindings());
    kernel.with([words.file(), onto.file()]).constants([words.constant()])
}

pub(super) fn kernels() -> Vec<Kernel> {
    forms().map(|(onto, words)| raster_small(onto, words)).collect()
}

pub(super) fn record<'a>(r: &mut Recorder<'a>, words: Words, to: &'a Buffer) {
    let bindings = r.raster(to);
    r.run_indirect(raster_small(Onto::Picture, words), &bindings, r.own().draws(), List::Small as u32);
}
