//! Functions of a device, ours or a host's.

#[cfg(feature = "testing")]
use super::faults::Faults;
use std::ops::Deref;

/// A device's functions. Destroys the device when dropped, if it is ours.
pub(super) struct RawDevice {
    pub(super) raw: ash::Device,
    ours: bool,
    /// For tests: calls that fail on demand.
    #[cfg(feature = "testing")]
    pub(super) faults: Option<Faults>,
}

impl RawDevice {
    /// Wraps a device that we created, and that nothing else destroys.
    pub(super) fn ours(raw: ash::Device) -> Self {
        let mut device = Self::of_host(raw);
        device.ours = true;
        device
    }

    /// Wraps a host's device, which the host destroys.
    pub(super) fn of_host(raw: ash::Device) -> Self {
        Self {
            raw,
            ours: false,
            #[cfg(feature = "testing")]
            faults: None,
        }
    }
}

impl Deref for RawDevice {
    type Target = ash::Device;

    fn deref(&self) -> &ash::Device {
        &self.raw
    }
}

impl Drop for RawDevice {
    fn drop(&mut self) {
        if self.ours {
            // SAFETY: whoever owns this value has destroyed all that was made from the device, which is idle.
            unsafe { self.raw.destroy_device(None) }
        }
    }
}
