//! Stage 5. Clusters with large triangles, or that have to be clipped, → visibility buffer, a workgroup per cluster.
//! Where `raster_hardware` draws, what it leaves. Alpha-tested clusters of any size are drawn here in each form.

use wgpu::Buffer;

use super::bindings::{Bindings, bindings};
use super::materials::Buffers;
use super::recorder::Recorder;
use super::shaders::{Kernel, List, Words};

bindings! {
    /// What alpha tests bind behind what all rasterizers do.
    AlphaTest { instance_materials, materials, texels }
}

pub(super) fn record<'a>(r: &mut Recorder<'a>, list: List, words: Words, to: &'a Buffer) {
    let bindings = r.raster(to);
    r.run_indirect(Kernel::RasterLarge(words), &bindings.buffers(), &r.own().draws, list as u32);
}

/// Alpha-tested clusters, where any material is.
pub(super) fn record_alpha_tested<'a>(r: &mut Recorder<'a>, words: Words, to: &'a Buffer) {
    let Some(Buffers { materials, texels, alpha_tested: true }) = r.materials else { return };
    let test = AlphaTest { instance_materials: &r.instances.instance_materials, materials, texels };
    let bindings = [r.raster(to).buffers(), test.buffers()].concat();
    r.run_indirect(Kernel::RasterAlphaTested(words), &bindings, &r.own().draws, List::AlphaTested as u32);
}
