//! Stage 1. Instances of the scene → as seen from the view, and the roots of those on the screen, now or in the second
//! pass.

use super::recorder::Recorder;
use super::shaders::{Kernel, WIDTH};

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own, [occluded_queue, occluded_dispatch]) = (r.buffers, r.own(), r.occluded_queue());
    let bindings = [
        &b.view,
        &r.instances.transforms,
        r.seen,
        &own.starts,
        &own.levels[0],
        r.pyramid(),
        occluded_queue,
        occluded_dispatch,
    ];
    r.run(Kernel::InstanceCull, &bindings, r.slots.div_ceil(WIDTH));
}
