//! The two passes of occlusion culling: the depth pyramids of this frame and of an earlier one, and what is decided between
//! the passes.
//!
//! The first pass takes what the frame before drew, less what the pyramid of that frame hides where instances were then;
//! the second looks at everything, with the pyramid of what the first one drew (Greene, Kass and Miller, "Hierarchical
//! Z-Buffer Visibility", 1993; Haar and Aaltonen, "GPU-Driven Rendering Pipelines", 2015). Without a list of what was drawn,
//! or after a cut, the first pass traverses the scene and defers what the pyramid occludes; of what no earlier frame showed, it
//! draws what is near. Whatever is known of earlier frames, the picture is the same: it decides which pass draws a
//! cluster, and not whether one does.

use super::recorder::Recorder;
use super::shaders::{CullPass, IndirectEntry, Kernel};

/// After the culling of a pass: decides what comes next, and gives what the first pass drew the numbers that it has
/// in the list of both.
pub(super) fn record(r: &mut Recorder<'_>) {
    let (b, own) = (r.buffers, r.own());
    let [first, second] = &b.cull_passes[..] else { return };
    let other = if r.cull_pass == CullPass::First { second } else { first };
    let bindings = [&b.view, &second.levels[0], &own.draws, &own.counters, &other.counters, &own.indirect];
    r.run(Kernel::PrepareIndirect(r.cull_pass), &bindings, 1);
    // Keys say no number.
    if r.cull_pass == CullPass::Second && !b.shape.depth_only {
        let number = IndirectEntry::Pixels.number();
        let bindings = [&b.view, &b.renumbered, &*b.words, &first.counters];
        r.run_indirect(Kernel::Renumber, &bindings, &own.indirect, number);
    }
}
