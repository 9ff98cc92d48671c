//! Faults of drivers against the specification, one flag each, by driver and version.

use ash::vk;
use std::ops::{BitOr, BitOrAssign};

/// Set of flags; see the constants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Workarounds(u32);

impl Workarounds {
    /// An invocation's loops stop silently after 65,535 iterations, all loops together. llvmpipe of Mesa before 25
    /// (LP_MAX_TGSI_LOOP_ITERATIONS in gallivm's lp_bld_limits.h). Blending then processes fewer entries of a tile per
    /// dispatch.
    pub const LOOPS_STOP_AT_65535: Self = Self(1 << 0);

    /// Returns the flags of a driver, by its id and its `driverInfo`, such as `Mesa 22.3.6`. (llvmpipe's `driverVersion` is
    /// 1 in all versions.)
    pub fn of_driver(id: vk::DriverId, info: &str) -> Self {
        let mut all = Self::default();
        let version = info.strip_prefix("Mesa ").and_then(|rest| rest.split('.').next()?.parse::<u32>().ok());
        if id == vk::DriverId::MESA_LLVMPIPE && version.is_none_or(|major| major < 25) {
            all |= Self::LOOPS_STOP_AT_65535;
        }
        all
    }

    /// True if all flags of another set are set.
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
        let of_llvmpipe = |info| Workarounds::of_driver(vk::DriverId::MESA_LLVMPIPE, info);
        let llvmpipe = of_llvmpipe("Mesa 22.3.6 (LLVM 15.0.6)");
        assert!(llvmpipe.contains(Workarounds::LOOPS_STOP_AT_65535));
        assert_eq!([of_llvmpipe("Mesa 24.99.0"), of_llvmpipe("unknown")], [llvmpipe; 2]);
        assert_eq!(of_llvmpipe("Mesa 25.0.7-2+deb13u1 (LLVM 19.1.7)"), Workarounds::default());
        let other = Workarounds::of_driver(vk::DriverId::MESA_RADV, "Mesa 22.3.6");
        assert!(!other.contains(Workarounds::LOOPS_STOP_AT_65535));
        assert!((other | llvmpipe).contains(llvmpipe) && other == Workarounds::default());
    }
}
