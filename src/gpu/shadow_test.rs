//! Visibility buffer and pages of shadow maps → how much of each light reaches each pixel.

use super::kernel::{Bindings, Constant, Kernel};
use super::shadow_table::ShadowBindings;
use super::surface::SurfaceBindings;

/// The array of shares: a number for each light of a pixel, all lights of the first pixel first. A lane
/// takes four pixels.
pub const SHADOW_TEST: Kernel =
    Kernel::new("shadow_test", &[SurfaceBindings::BINDINGS, ShadowBindings::BINDINGS])
        .constants([Constant::Number("SHADOW_BINDING", SurfaceBindings::BINDINGS.len() as u32)]);
