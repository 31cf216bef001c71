//! Stage 5. Clusters with large triangles, or that have to be clipped, → visibility buffer, a workgroup per cluster.
//! Where `raster_hardware` draws, what it leaves. Clusters that may have holes, of any size, are drawn here in each form.

use wgpu::Buffer;

use super::frame::Recorder;
use super::materials::Buffers;
use super::shaders::{Kernel, List, Words};

pub(super) fn record<'a>(r: &mut Recorder<'a>, list: List, words: Words, to: &'a Buffer) {
    let bindings = r.raster_bindings(to);
    r.run_indirect(Kernel::RasterLarge(words), &bindings, &r.own().draws, list as u32);
}

/// Clusters that may have holes, where any material has them.
pub(super) fn record_masked<'a>(r: &mut Recorder<'a>, words: Words, to: &'a Buffer) {
    let Some(Buffers { materials, texels, masked: true }) = r.materials else { return };
    let bindings = r.raster_bindings(to);
    let bindings = [&bindings[..], &[&r.instances.looks, materials, texels]].concat();
    r.run_indirect(Kernel::RasterMasked(words), &bindings, &r.own().draws, List::Masked as u32);
}
