//! Stage 5. Clusters with large triangles, or that have to be clipped, → visibility buffer, a workgroup per cluster.

use wgpu::Buffer;

use super::frame::Recorder;
use super::shaders::{Kernel, Words};

pub(super) fn record<'a>(r: &mut Recorder<'a>, words: Words, to: &'a Buffer) {
    let bindings = r.raster_bindings(to);
    r.run_indirect(Kernel::RasterLarge(words), &bindings, &r.own().draws, 1);
}
