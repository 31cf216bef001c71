//! Stage 5. Clusters with large triangles, or that have to be clipped, → visibility buffer, a workgroup per cluster.
//! Where `raster_hardware` draws, what it leaves. Alpha-tested clusters of any size are drawn here in each form.

use wgpu::Buffer;

use super::kernel::{Bindings, Constant, Kernel, bind, bindings};
use super::lists::List;
use super::materials::Buffers;
use super::raster::{RasterBindings, Words};
use super::recorder::Recorder;

bindings! {
    /// What alpha tests bind behind what all rasterizers do.
    AlphaTest { instance_materials: Read, materials: Read, texels: Read }
}

/// Large clusters → visibility buffer.
pub const fn raster_large(words: Words) -> Kernel {
    let kernel = Kernel::new("raster_large", &[RasterBindings::BINDINGS]);
    kernel.with([words.file(), "shared/opaque"]).constants([words.constant(), alpha_tested(false)])
}

/// Alpha-tested clusters → visibility buffer.
pub const fn raster_alpha_tested(words: Words) -> Kernel {
    let kernel = Kernel::new("raster_large", &[RasterBindings::BINDINGS, AlphaTest::BINDINGS]);
    kernel.with([words.file(), "shared/alpha_test"]).constants([words.constant(), alpha_tested(true)])
}

const fn alpha_tested(tests: bool) -> Constant {
    Constant::Flag("ALPHA_TESTED", tests)
}

pub(super) fn kernels() -> Vec<Kernel> {
    Words::ALL.into_iter().flat_map(|words| [raster_large(words), raster_alpha_tested(words)]).collect()
}

pub(super) fn record<'a>(r: &mut Recorder<'a>, list: List, words: Words, to: &'a Buffer) {
    let bindings = r.raster(to);
    r.run_indirect(raster_large(words), &bindings.buffers(), r.own().draws(), list as u32);
}

/// Alpha-tested clusters, where any material is.
pub(super) fn record_alpha_tested<'a>(r: &mut Recorder<'a>, words: Words, to: &'a Buffer) {
    let Some(Buffers { materials, texels, alpha_tested: true }) = r.materials else { return };
    let instance_materials = &r.instances.instance_materials;
    let test =
        bind!(AlphaTest { instance_materials: instance_materials, materials: materials, texels: texels });
    let bindings = [r.raster(to).buffers(), test.buffers()].concat();
    r.run_indirect(raster_alpha_tested(words), &bindings, r.own().draws(), List::AlphaTested as u32);
}
