//! Stage 6. Visibility buffer → depth pyramid, where it is needed: after the first pass for what it deferred, and at the
//! end of the frame for the next one.

use super::recorder::Recorder;
use super::shaders::{IndirectEntry, Kernel, PYRAMID_DISPATCHES};

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own) = (r.buffers, r.own());
    for round in 0..PYRAMID_DISPATCHES {
        let bindings = [&b.view, &b.words, r.pyramids.own(), &own.counters];
        r.run_indirect(Kernel::Hzb(round), &bindings, &own.indirect, IndirectEntry::Pyramid(round).number());
    }
}
