//! Reads the device's clock at a known time of the host's clock.

use ash::vk;
use std::ffi::CStr;

/// Extension that provides calibrated timestamps.
#[derive(Clone, Copy)]
pub(super) enum Calibrated {
    Khr,
    Ext,
}

impl Calibrated {
    /// Returns the older extension if a device has both: validation layers of 2023 warn about the newer one.
    pub(super) fn find(has: impl Fn(&CStr) -> bool) -> Option<Self> {
        [Self::Ext, Self::Khr].into_iter().find(|kind| has(kind.extension()))
    }

    pub(super) fn extension(self) -> &'static CStr {
        match self {
            Self::Khr => ash::khr::calibrated_timestamps::NAME,
            Self::Ext => ash::ext::calibrated_timestamps::NAME,
        }
    }
}

/// Functions of the enabled extension.
pub(super) enum Clock {
    Khr(ash::khr::calibrated_timestamps::Device),
    Ext(ash::ext::calibrated_timestamps::Device),
}

impl Clock {
    pub(super) fn new(
        instance: &ash::Instance,
        device: &ash::Device,
        kind: Option<Calibrated>,
    ) -> Option<Self> {
        Some(match kind? {
            Calibrated::Khr => Self::Khr(ash::khr::calibrated_timestamps::Device::new(instance, device)),
            Calibrated::Ext => Self::Ext(ash::ext::calibrated_timestamps::Device::new(instance, device)),
        })
    }

    /// Returns the device's current clock, ticks; None if the driver fails.
    pub(super) fn ticks(&self) -> Option<u64> {
        let info = [vk::CalibratedTimestampInfoKHR::default().time_domain(vk::TimeDomainKHR::DEVICE)];
        // SAFETY: the extension is enabled, and every implementation of it has the device's time domain.
        let read = unsafe {
            match self {
                Self::Khr(clock) => clock.get_calibrated_timestamps(&info),
                Self::Ext(clock) => clock.get_calibrated_timestamps(&info),
            }
        };
        read.ok()?.0.first().copied()
    }
}
