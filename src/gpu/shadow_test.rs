//! Visibility buffer and pages of shadow maps → how much of each light reaches each pixel.

use super::kernel::{Bindings, BoundBuffer, Constant, Kernel};
use super::shadow_table::ShadowBindings;
use super::surface::SurfaceBindings;

/// The array of shares: a number for each light of a pixel, all lights of the first pixel first.
pub const SHADOW_TEST: Kernel =
    Kernel::new("shadow_test", &[SurfaceBindings::BINDINGS, ShadowBindings::BINDINGS])
        .constants([Constant::Number("SHADOW_BINDING", SurfaceBindings::BINDINGS.len() as u32)]);

/// All that it binds; its array goes where `surface` says.
pub(super) fn bound<'a>(surface: &SurfaceBindings<'a>, shadows: &ShadowBindings<'a>) -> Vec<BoundBuffer<'a>> {
    [surface.buffers(), shadows.buffers()].concat()
}
