//! What an instance shows, by an identity.

use std::sync::atomic::{AtomicU64, Ordering};

/// Identity of a geometry, given once in a process: devices and pools know what they hold by it. A copy of a geometry is
/// another one, since either may change.
#[derive(Debug)]
pub struct GeometryId(u64);

impl GeometryId {
    /// Its number.
    pub fn number(&self) -> u64 {
        self.0
    }
}

impl Default for GeometryId {
    fn default() -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        Self(NEXT.fetch_add(1, Ordering::Relaxed))
    }
}

impl Clone for GeometryId {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Whoever compares geometries asks what they hold.
impl PartialEq for GeometryId {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}
