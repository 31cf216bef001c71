//! Stage 4. Clusters of small triangles → visibility buffer, a workgroup per cluster.

use wgpu::Buffer;

use super::recorder::Recorder;
use super::shaders::{Kernel, List, Words};

pub(super) fn record<'a>(r: &mut Recorder<'a>, words: Words, to: &'a Buffer) {
    let bindings = r.raster_bindings(to);
    r.run_indirect(Kernel::RasterSmall(words), &bindings, &r.own().draws, List::Small as u32);
}
