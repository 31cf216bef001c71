//! Stage 5. Clusters with large triangles, or that have to be clipped, → visibility buffer, a workgroup per cluster.

use super::frame::Recorder;
use super::shaders::{Kernel, Words};

pub(super) fn record(r: &mut Recorder<'_>, words: Words) {
    let bindings = r.raster_bindings();
    r.run_indirect(Kernel::RasterLarge(words), &bindings, &r.own().draws, 1);
}
