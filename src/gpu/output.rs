//! Stage 8. Visibility buffer → the arrays that a caller asks for.

use super::bindings::{Bindings, bindings};
use super::recorder::Recorder;
use super::shaders::{Kernel, List, PIXELS_PER_LANE, WIDTH, Words};
use super::{raster_large, raster_small};
use crate::config::Output;

bindings! {
    /// What `count_covered` binds.
    CountCovered { view, words, counters }
}

/// Arrays of the finished picture: all but colour, which is the stage before, and overdraw. Of a picture that stays on the
/// device, also how much of it is covered.
pub(super) fn record(r: &mut Recorder<'_>) {
    let b = r.buffers;
    if b.shape.stays_on_device {
        let bindings = CountCovered { view: &b.view, words: &b.words, counters: &b.cull_passes[0].counters };
        // As many as a picture has at most fit.
        let workgroups = b.shape.pixels.div_ceil(u64::from(WIDTH * PIXELS_PER_LANE)) as u32;
        r.run(Kernel::CountCovered, &bindings.buffers(), workgroups);
    }
    for (output, out) in &r.buffers.outputs {
        if !(output.shaded() || *output == Output::Overdraw) {
            let bindings = r.surface(out).buffers();
            r.run(Kernel::Output(*output), &bindings, r.picture_workgroups());
        }
    }
}

/// Overdraw: what a pass drew, drawn again; where everything is drawn in compute.
pub(super) fn count(r: &mut Recorder<'_>) {
    for (_, counts) in r.buffers.outputs.iter().filter(|(output, _)| *output == Output::Overdraw) {
        raster_small::record(r, Words::Count, counts);
        raster_large::record(r, List::Large, Words::Count, counts);
        raster_large::record_alpha_tested(r, Words::Count, counts);
    }
}
