//! What drivers do against the specification, or beyond it, and what is done about it: one flag for each, by driver and version.

use ash::vk;
use std::ops::{BitOr, BitOrAssign};

/// Flags: see the constants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Workarounds(u32);

impl Workarounds {
    /// An invocation's loops stop silently after 65,535 rounds, all loops together. llvmpipe of Mesa before 25
    /// (LP_MAX_TGSI_LOOP_ITERATIONS in gallivm's lp_bld_limits.h). Blending hands fewer entries of a tile to a dispatch.
    pub const LOOPS_STOP_AT_65535: Self = Self(1 << 0);

    /// Of a driver, by its id and its `driverVersion`. Each vendor encodes that in its own way: Mesa's drivers as
    /// Vulkan versions, NVIDIA's in 10, 8, 8 and 6 bits.
    pub fn of_driver(id: vk::DriverId, _version: u32) -> Self {
        let mut all = Self::default();
        // Versions from 25 on have no such limit. They keep the flag until the kernels were measured there.
        if id == vk::DriverId::MESA_LLVMPIPE {
            all |= Self::LOOPS_STOP_AT_65535;
        }
        all
    }

    /// Whether all flags of another set are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl BitOr for Workarounds {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for Workarounds {
    fn bitor_assign(&mut self, other: Self) {
        *self = *self | other;
    }
}

#[cfg(test)]
mod tests {
    use super::Workarounds;
    use ash::vk;

    #[test]
    fn workarounds_go_by_the_driver() {
        let llvmpipe = Workarounds::of_driver(vk::DriverId::MESA_LLVMPIPE, 1);
        assert!(llvmpipe.contains(Workarounds::LOOPS_STOP_AT_65535));
        let other = Workarounds::of_driver(vk::DriverId::MESA_RADV, 1);
        assert!(!other.contains(Workarounds::LOOPS_STOP_AT_65535));
        assert!((other | llvmpipe).contains(llvmpipe) && other == Workarounds::default());
    }
}
