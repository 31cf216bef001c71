//! What is in the way of each light of a frame, wherever that lies.

#[cfg(feature = "gpu")]
use super::device_shadows::DeviceShadows;
use crate::cpu::shadow_pages::Shadows;
use crate::error::Result;

/// See the module's documentation.
#[derive(Debug)]
pub(super) enum FrameShadows {
    /// In this memory.
    Host(Shadows),
    /// On a device.
    #[cfg(feature = "gpu")]
    Device(DeviceShadows),
}

impl FrameShadows {
    /// Whether they lie on a device alone.
    pub(super) fn is_on_device(&self) -> bool {
        match self {
            Self::Host(_) => false,
            #[cfg(feature = "gpu")]
            Self::Device(shadows) => shadows.is_on_device(),
        }
    }

    /// In this memory.
    pub(super) fn host(&self) -> Result<&Shadows> {
        match self {
            Self::Host(shadows) => Ok(shadows),
            #[cfg(feature = "gpu")]
            Self::Device(shadows) => shadows.host(),
        }
    }
}
