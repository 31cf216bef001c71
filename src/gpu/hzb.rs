//! Stage 6. Visibility buffer → depth pyramid, where it is needed: after the first pass for what it deferred, and at the
//! end of the frame for the next one.

use super::kernel::{Bindings, Constant, Kernel, bind, bindings};
use super::lists::{IndirectEntry, PYRAMID_DISPATCHES};
use super::recorder::Recorder;

bindings! {
    /// What `hzb` binds.
    Hzb { view: Uniform, words: Read, pyramid: Write, counters: Write }
}

/// Visibility buffer → some levels of the depth pyramid, by the number of the dispatch.
pub const fn hzb(dispatch: u32) -> Kernel {
    Kernel::new("hzb", &[Hzb::BINDINGS]).constants([Constant::Number("PYRAMID_DISPATCH", dispatch)])
}

pub(super) fn kernels() -> Vec<Kernel> {
    (0..PYRAMID_DISPATCHES).map(hzb).collect()
}

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own) = (r.buffers, r.own());
    let bindings =
        bind!(Hzb { view: &b.view, words: &b.words, pyramid: r.pyramids.own(), counters: &own.counters });
    for dispatch in 0..PYRAMID_DISPATCHES {
        let entry = IndirectEntry::Pyramid(dispatch).number();
        r.run_indirect(hzb(dispatch), &bindings.buffers(), &own.indirect, entry);
    }
}
