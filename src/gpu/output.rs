//! Stage 8. Visibility buffer → the arrays that a caller asks for.

use wgpu::Buffer;

use super::frame::Recorder;
use super::shaders::{Kernel, List, Words};
use super::{raster_large, raster_small};
use crate::config::Output;

/// An array of the finished picture: any but colour, which is the stage before, and overdraw.
pub(super) fn record<'a>(r: &mut Recorder<'a>, output: Output, out: &'a Buffer) {
    let bindings = r.surface_bindings(out);
    r.run(Kernel::Output(output), &bindings, r.picture_workgroups());
}

/// Overdraw: what a phase drew, drawn again; where everything is drawn in compute.
pub(super) fn count<'a>(r: &mut Recorder<'a>, counts: &'a Buffer) {
    raster_small::record(r, Words::Count, counts);
    raster_large::record(r, List::Large, Words::Count, counts);
}
