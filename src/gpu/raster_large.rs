//! Stage 5. Clusters with large triangles, or that have to be clipped, → visibility buffer, a workgroup per cluster.
//! Where `raster_hardware` draws, what it leaves.

use super::frame::Recorder;
use super::shaders::{Kernel, List, Words};

pub(super) fn record(r: &mut Recorder<'_>, list: List, words: Words) {
    let bindings = r.raster_bindings();
    r.run_indirect(Kernel::RasterLarge(words), &bindings, &r.own().draws, list as u32);
}
