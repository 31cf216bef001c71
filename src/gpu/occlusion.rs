//! The two passes of occlusion culling: the depth pyramids of this frame and of an earlier one, and what is decided between
//! the passes.
//!
//! The first pass takes what the frame before drew, less what the pyramid of that frame hides where instances were then;
//! the second looks at everything, with the pyramid of what the first one drew (Greene, Kass and Miller, "Hierarchical
//! Z-Buffer Visibility", 1993; Haar and Aaltonen, "GPU-Driven Rendering Pipelines", 2015). Without a list of what was drawn,
//! or after a cut, the first pass traverses the scene and defers what the pyramid occludes; of what no earlier frame showed, it
//! draws what is near. Whatever is known of earlier frames, the picture is the same: it decides which pass draws a
//! cluster, and not whether one does.

use super::bindings::{Bindings, bindings};
use super::recorder::Recorder;
use super::shaders::{CullPass, IndirectEntry, Kernel};

bindings! {
    /// What `prepare_indirect` binds.
    PrepareIndirect { view, occluded_dispatch, draws, counters, other_counters, indirect }
}

bindings! {
    /// What `renumber` binds.
    Renumber { view, renumbered, words, counters }
}

/// After the culling of a pass: decides what comes next, and gives what the first pass drew the numbers that it has
/// in the list of both.
pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own) = (r.buffers, r.own());
    let [first, second] = &b.cull_passes[..] else { return };
    let other = if r.cull_pass == CullPass::First { second } else { first };
    let bindings = PrepareIndirect {
        view: &b.view,
        occluded_dispatch: &second.levels[0],
        draws: &own.draws,
        counters: &own.counters,
        other_counters: &other.counters,
        indirect: &own.indirect,
    };
    r.run(Kernel::PrepareIndirect(r.cull_pass), &bindings.buffers(), 1);
    // Keys say no number.
    if r.cull_pass == CullPass::Second && !b.shape.depth_only {
        let number = IndirectEntry::Pixels.number();
        let bindings =
            Renumber { view: &b.view, renumbered: &b.renumbered, words: &b.words, counters: &first.counters };
        r.run_indirect(Kernel::Renumber, &bindings.buffers(), &own.indirect, number);
    }
}
