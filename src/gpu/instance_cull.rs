//! Stage 1. Instances of the scene → as seen from the view, and the roots of those on the screen, now or in the second
//! pass.

use super::bindings::{Bindings, bindings};
use super::recorder::Recorder;
use super::shaders::{Kernel, WIDTH};

bindings! {
    /// What `instance_cull` binds.
    InstanceCull { view, transforms, instances, items_out, next, pyramid, occluded_queue, occluded_dispatch }
}

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own, [occluded_queue, occluded_dispatch]) = (r.buffers, r.own(), r.occluded_queue());
    let bindings = InstanceCull {
        view: &b.view,
        transforms: &r.instances.transforms,
        instances: r.seen,
        items_out: &own.starts,
        next: &own.levels[0],
        pyramid: r.pyramid(),
        occluded_queue,
        occluded_dispatch,
    };
    r.run(Kernel::InstanceCull, &bindings.buffers(), r.slots.div_ceil(WIDTH));
}
