//! Stage 1. Instances of the scene → as seen from the view, and the roots of those on the screen, now or in the second
//! pass.

use super::kernel::{Bindings, CullPass, Kernel, WIDTH, bind, bindings};
use super::recorder::Recorder;

bindings! {
    /// What `instance_cull` binds.
    InstanceCull {
        view: Uniform, transforms: Read, instances: Write, items_out: Write, next: Write, pyramid: Read,
        occluded_queue: Write, occluded_dispatch: Write,
    }
}

/// Instances → roots to look at.
pub const INSTANCE_CULL: Kernel = Kernel::new("instance_cull", &[InstanceCull::BINDINGS]).of(CullPass::First);

pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own, [occluded_queue, occluded_dispatch]) = (r.buffers, r.own(), r.occluded_queue());
    let bindings = bind!(InstanceCull {
        view: &b.view,
        transforms: &r.instances.transforms,
        instances: r.seen,
        items_out: &own.starts,
        next: own.levels.level(0),
        pyramid: r.pyramid(),
        occluded_queue: occluded_queue,
        occluded_dispatch: occluded_dispatch,
    });
    r.run(INSTANCE_CULL, &bindings.buffers(), r.slots.div_ceil(WIDTH));
}
