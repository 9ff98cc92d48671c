//! Parameters of the radix sort: digits, passes, scratch.

use super::{LaunchSizes, blocks};
use crate::kernels::constants::SORT_BINS;
use crate::kernels::sort::sort_downsweep;
use crate::tuning::SortMethod;
use crate::vk::{KernelInterface, Limits};

/// Subgroups per sorting workgroup. Each has its own histogram in shared memory.
const SORT_SUBGROUPS: u32 = 8;
/// Keys per invocation of a serial sort: enough to amortize the run's own histogram, few enough for the cache.
const SORT_RUN: u32 = 1024;
/// Bits per digit of a serial sort: with ten, the tiles of a small image need one pass.
const SORT_RUN_DIGIT_BITS: u32 = 10;
/// Most pairs times passes that a single subgroup sorts on a processor. Above it, a second core saves more than the
/// dispatches cost. An invocation's loops stay within [`Limits::max_loop_iterations`], even with four lanes.
const SORT_SINGLE_SUBGROUP: u64 = 1 << 18;
/// Most pairs of a sort in a single subgroup, for any number of passes.
const SORT_SINGLE_SUBGROUP_PAIRS: u64 = 1 << 17;
/// Largest buffer alignment within one allocation that a device requires, bytes.
const BUFFER_ALIGNMENT: u64 = 256;

/// Returns the invocations of a sorting workgroup and the keys per invocation. `size` returns a constant's default or its
/// override.
pub(super) fn shape(
    limits: &Limits,
    method: SortMethod,
    elementwise: u32,
    size: impl Fn(&str, &str, u32) -> u32,
) -> (u32, u32) {
    match method {
        SortMethod::Matching => {
            let preferred = size("sort", "WORKGROUP_SIZE", SORT_SUBGROUPS * limits.subgroup_size);
            let workgroup_size = limits.workgroup_size(preferred.min(elementwise));
            let fits = |items: &u32| {
                let spec = sort_downsweep::Spec {
                    workgroup_size,
                    subgroup_size: limits.subgroup_size,
                    items: *items,
                    ..sort_downsweep::Spec::default()
                };
                sort_downsweep::Interface::shared_bytes(&spec) <= limits.shared_memory_bytes
            };
            let wanted = size("sort", "ITEMS", limits.tuning.sort_items);
            let items =
                std::iter::successors(Some(wanted), |items| (*items > 1).then(|| items / 2)).find(fits);
            (workgroup_size, items.unwrap_or(1))
        }
        // Keys are read in fours.
        SortMethod::Serial => (limits.subgroup_size, size("sort", "ITEMS", SORT_RUN).max(4)),
    }
}

impl LaunchSizes {
    /// True if a single subgroup sorts up to `capacity` keys below 2^`key_bits`.
    pub fn sorts_in_single_subgroup(&self, capacity: u64, key_bits: u32) -> bool {
        let passes = u64::from(self.sort_passes(key_bits));
        self.sort_single_subgroup
            && capacity <= SORT_SINGLE_SUBGROUP_PAIRS
            && capacity * passes <= SORT_SINGLE_SUBGROUP
    }

    /// Most bits of a digit.
    pub const fn sort_digit_bits(&self) -> u32 {
        match self.sort_method {
            SortMethod::Matching => SORT_BINS.ilog2(),
            SortMethod::Serial => SORT_RUN_DIGIT_BITS,
        }
    }

    /// Number of passes of a sort of keys below 2^`key_bits`.
    pub const fn sort_passes(&self, key_bits: u32) -> u32 {
        key_bits.div_ceil(self.sort_digit_bits())
    }

    /// Words of a sort's histograms, for `n` keys below 2^`key_bits`: one per block, and one per run of a serial sort.
    pub fn sort_histogram_words(&self, n: u64, key_bits: u32) -> u64 {
        let histograms = match self.sort_method {
            SortMethod::Matching => 1,
            SortMethod::Serial => 1 + u64::from(self.sort_workgroup),
        };
        let padding = BUFFER_ALIGNMENT / 4;
        blocks(n, self.sort.into()).max(1) * histograms * self.sort_digits(key_bits) + padding
    }

    /// Number of digits of a sort of keys below 2^`key_bits`. At least four, because runs are counted in fours.
    pub const fn sort_digits(&self, key_bits: u32) -> u64 {
        let digits = 1 << key_bits.div_ceil(self.sort_passes(key_bits));
        if digits < 4 { 4 } else { digits }
    }

    /// Byte offset of the runs' histograms, after `bytes` bytes of the blocks' histograms.
    pub(crate) const fn sort_runs_offset(bytes: u64) -> u64 {
        bytes.next_multiple_of(BUFFER_ALIGNMENT)
    }
}
