//! Stage 4. Clusters of small triangles → visibility buffer, a workgroup per cluster.

use wgpu::Buffer;

use super::bindings::Bindings;
use super::recorder::Recorder;
use super::shaders::{Kernel, List, Words};

pub(super) fn record<'a>(r: &mut Recorder<'a>, words: Words, to: &'a Buffer) {
    let bindings = r.raster(to);
    r.run_indirect(Kernel::RasterSmall(words), &bindings.buffers(), &r.own().draws, List::Small as u32);
}
