//! Stage 5. Clusters with large triangles, or that have to be clipped, → visibility buffer, a workgroup per cluster.
//! Where `raster_hardware` draws, what it leaves.

use wgpu::Buffer;

use super::frame::Recorder;
use super::shaders::{Kernel, List, Words};

pub(super) fn record<'a>(r: &mut Recorder<'a>, list: List, words: Words, to: &'a Buffer) {
    let bindings = r.raster_bindings(to);
    r.run_indirect(Kernel::RasterLarge(words), &bindings, &r.own().draws, list as u32);
}
