//! Stage 5. Clusters with large triangles, or that have to be clipped, → visibility buffer, a workgroup per cluster.
//! Where `raster_hardware` draws, what it leaves. Alpha-tested clusters of any size are drawn here in each form.

use wgpu::Buffer;

use super::kernel::{BindingLists, Bindings, BoundBuffer, Constant, Kernel, bind, bindings};
use super::lists::List;
use super::materials::Buffers;
use super::raster::{OneView, Onto, PageViews, RasterBindings, Words, forms};
use super::recorder::Recorder;

bindings! {
    /// What alpha tests bind behind what all rasterizers do.
    AlphaTest { instance_materials: Read, materials: Read, texels: Read }
}

/// Large clusters → visibility buffer.
pub const fn raster_large(onto: Onto, words: Words) -> Kernel {
    let kernel = Kernel::new("raster_large", onto.bindings());
    let variants = [words.file(), onto.file(), "shared/opaque"];
    kernel.with(variants).constants([words.constant(), alpha_tested(false)])
}

/// Alpha-tested clusters → visibility buffer.
pub const fn raster_alpha_tested(onto: Onto, words: Words) -> Kernel {
    let bindings: BindingLists = match onto {
        Onto::Picture => &[RasterBindings::BINDINGS, OneView::BINDINGS, AlphaTest::BINDINGS],
        Onto::Pages => &[RasterBindings::BINDINGS, PageViews::BINDINGS, AlphaTest::BINDINGS],
    };
    let kernel = Kernel::new("raster_large", bindings);
    let variants = [words.file(), onto.file(), "shared/alpha_test"];
    kernel.with(variants).constants([words.constant(), alpha_tested(true)])
}

const fn alpha_tested(tests: bool) -> Constant {
    Constant::Flag("ALPHA_TESTED", tests)
}

pub(super) fn kernels() -> Vec<Kernel> {
    forms().flat_map(|(onto, words)| [raster_large(onto, words), raster_alpha_tested(onto, words)]).collect()
}

pub(super) fn record<'a>(r: &mut Recorder<'a>, list: List, words: Words, to: &'a Buffer) {
    let bindings = r.raster(to);
    r.run_indirect(raster_large(Onto::Picture, words), &bindings, r.own().draws(), list as u32);
}

/// What alpha tests bind, where any material is tested.
pub(super) fn alpha_test<'a>(
    buffers: Option<&'a Buffers>,
    instance_materials: &'a Buffer,
) -> Option<Vec<BoundBuffer<'a>>> {
    let Some(Buffers { materials, texels, alpha_tested: true }) = buffers else { return None };
    let test =
        bind!(AlphaTest { instance_materials: instance_materials, materials: materials, texels: texels });
    Some(test.buffers())
}

/// Alpha-tested clusters, where any material is.
pub(super) fn record_alpha_tested<'a>(r: &mut Recorder<'a>, words: Words, to: &'a Buffer) {
    let Some(test) = alpha_test(r.materials, &r.instances.instance_materials) else { return };
    let bindings = [r.raster(to), test].concat();
    r.run_indirect(
        raster_alpha_tested(Onto::Picture, words),
        &bindings,
        r.own().draws(),
        List::AlphaTested as u32,
    );
}
