//! Stage 1. Instances of the scene → as seen from the view, and the roots of those on the screen, now or in the second
//! phase.

use super::frame::Recorder;
use super::shaders::{Kernel, WIDTH};

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own, [later, later_level]) = (r.buffers, r.own(), r.later());
    let bindings =
        [&b.view, &r.instances.placed, r.seen, &own.starts, &own.levels[0], r.pyramid(), later, later_level];
    r.run(Kernel::InstanceCull, &bindings, r.slots.div_ceil(WIDTH));
}
