//! What kernels share that make an array of a finished visibility buffer.

use super::kernel::{Constant, bindings};
use crate::config::Output;

bindings! {
    /// What they bind.
    SurfaceBindings {
        view: Uniform, instances: Read, page_offsets: Read, pages: Read, pages_1: Read, pages_2: Read, pages_3: Read,
        visible: Read, instance_materials: Read, words: Read, out: Write,
    }
}

/// Which array they make.
pub(super) fn output_constants(output: Output) -> [Constant; 3] {
    [
        Constant::Number("OUTPUT", output as u32),
        Constant::Flag("OUTPUT_RGB", output.rgb()),
        Constant::Flag("OUTPUT_SURFACE", output.surface()),
    ]
}
