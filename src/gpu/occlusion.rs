//! The two passes of occlusion culling: the depth pyramids of this frame and of an earlier one, and what is decided between
//! the passes.
//!
//! The first pass takes what the frame before drew, less what the pyramid of that frame hides where instances were then;
//! the second looks at everything, with the pyramid of what the first one drew (Greene, Kass and Miller, "Hierarchical
//! Z-Buffer Visibility", 1993; Haar and Aaltonen, "GPU-Driven Rendering Pipelines", 2015). Without a list of what was drawn,
//! or after a cut, the first pass traverses the scene and defers what the pyramid occludes; of what no earlier frame showed, it
//! draws what is near. Whatever is known of earlier frames, the picture is the same: it decides which pass draws a
//! cluster, and not whether one does.

use super::kernel::{Bindings, CullPass, Kernel, bind, bindings};
use super::lists::IndirectEntry;
use super::recorder::Recorder;

bindings! {
    /// What `prepare_indirect` binds.
    PrepareIndirect {
        view: Uniform, occluded_dispatch: Read, draws: Read, counters: Write, other_counters: Write,
        indirect: Write,
    }
}

bindings! {
    /// What `renumber` binds.
    Renumber { view: Uniform, renumbered: Read, words: Write, counters: Write }
}

/// Counts of a pass → what comes next.
pub const fn prepare_indirect(cull_pass: CullPass) -> Kernel {
    Kernel::new("prepare_indirect", &[PrepareIndirect::BINDINGS]).of(cull_pass)
}

/// Visibility buffer of the first pass → with the numbers of both.
pub const RENUMBER: Kernel = Kernel::new("renumber", &[Renumber::BINDINGS]);

pub(super) fn kernels() -> Vec<Kernel> {
    CullPass::BOTH.into_iter().map(prepare_indirect).chain([RENUMBER]).collect()
}

/// After the culling of a pass: decides what comes next, and gives what the first pass drew the numbers that it has
/// in the list of both.
pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own) = (r.buffers, r.own());
    let [first, second] = &b.cull_passes[..] else { return };
    let other = if r.cull_pass == CullPass::First { second } else { first };
    let bindings = bind!(PrepareIndirect {
        view: &b.view,
        occluded_dispatch: second.levels.level(0),
        draws: own.draws(),
        counters: &own.counters,
        other_counters: &other.counters,
        indirect: &own.indirect,
    });
    r.run(prepare_indirect(r.cull_pass), &bindings.buffers(), 1);
    // Keys say no number.
    if r.cull_pass == CullPass::Second && !b.shape.depth_only {
        let number = IndirectEntry::Pixels.number();
        let bindings = bind!(Renumber {
            view: &b.view,
            renumbered: &b.renumbered,
            words: &b.words,
            counters: &first.counters,
        });
        r.run_indirect(RENUMBER, &bindings.buffers(), &own.indirect, number);
    }
}
