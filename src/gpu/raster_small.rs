//! Stage 4. Clusters of small triangles → visibility buffer, a workgroup per cluster.

use super::frame::Recorder;
use super::shaders::{Kernel, List, Words};

pub(super) fn record(r: &mut Recorder<'_>, words: Words) {
    let bindings = r.raster_bindings();
    r.run_indirect(Kernel::RasterSmall(words), &bindings, &r.own().draws, List::Small as u32);
}
