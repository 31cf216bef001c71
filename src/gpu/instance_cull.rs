//! Stage 1. Instances of the scene → the roots of those on the screen.

use super::frame::Recorder;
use super::shaders::{Kernel, WIDTH};

pub(super) fn record(r: &mut Recorder<'_>) {
    let b = r.buffers;
    let bindings = [&b.view, &b.instances, &b.roots, &b.levels[0]];
    r.run(Kernel::InstanceCull, &bindings, b.shape.instances.div_ceil(WIDTH));
}
