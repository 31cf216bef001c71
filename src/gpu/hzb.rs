//! Stage 6. Visibility buffer → depth pyramid, where it is needed: after the first pass for what it deferred, and at the
//! end of the frame for the next one.

use super::bindings::{Bindings, bindings};
use super::recorder::Recorder;
use super::shaders::{IndirectEntry, Kernel, PYRAMID_DISPATCHES};

bindings! {
    /// What `hzb` binds.
    Hzb { view, words, pyramid, counters }
}

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own) = (r.buffers, r.own());
    let bindings =
        Hzb { view: &b.view, words: &b.words, pyramid: r.pyramids.own(), counters: &own.counters }.buffers();
    for dispatch in 0..PYRAMID_DISPATCHES {
        let entry = IndirectEntry::Pyramid(dispatch).number();
        r.run_indirect(Kernel::Hzb(dispatch), &bindings, &own.indirect, entry);
    }
}
