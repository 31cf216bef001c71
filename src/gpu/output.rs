//! Stage 8. Visibility buffer → the arrays that a caller asks for.

use super::kernel::{Bindings, Kernel, WIDTH, bind, bindings};
use super::lists::List;
use super::raster::Words;
use super::recorder::Recorder;
use super::shaders::PIXELS_PER_LANE;
use super::surface::{SurfaceBindings, output_constants};
use super::{raster_large, raster_small};
use crate::config::{OUTPUTS, Output};

bindings! {
    /// What `count_covered` binds.
    CountCovered { view: Uniform, words: Read, counters: Write }
}

/// Visibility buffer → how many pixels show anything.
pub const COUNT_COVERED: Kernel = Kernel::new("count_covered", &[CountCovered::BINDINGS]);

/// Visibility buffer → an array; what is shaded and overdraw are made otherwise.
pub fn output(output: Output) -> Kernel {
    Kernel::new("output", &[SurfaceBindings::BINDINGS]).constants(output_constants(output))
}

/// Whether [`output`] makes it.
fn makes(output: Output) -> bool {
    !output.shaded() && output != Output::Overdraw
}

pub(super) fn kernels() -> Vec<Kernel> {
    let outputs = OUTPUTS.into_iter().filter(|made| makes(*made)).map(output);
    [COUNT_COVERED].into_iter().chain(outputs).collect()
}

/// Of a picture that stays on the device, how much of it is covered.
pub(super) fn record_covered(r: &mut Recorder<'_>) {
    let b = r.buffers;
    if b.shape.stays_on_device {
        let bindings =
            bind!(CountCovered { view: &b.view, words: &b.words, counters: &b.cull_passes[0].counters });
        // As many as a picture has at most fit.
        let workgroups = b.shape.pixels.div_ceil(u64::from(WIDTH * PIXELS_PER_LANE)) as u32;
        r.run(COUNT_COVERED, &bindings.buffers(), workgroups);
    }
}

/// Arrays of the finished picture: all but colour, which is the stage before, and overdraw.
pub(super) fn record(r: &mut Recorder<'_>) {
    for (made, out) in r.buffers.outputs.iter().filter(|(made, _)| makes(*made)) {
        let bindings = r.surface(out).buffers();
        r.run(output(*made), &bindings, r.picture_workgroups());
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
