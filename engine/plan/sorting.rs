//! What a radix sort needs: digits, passes, scratch.

use super::{LaunchSizes, blocks};
use crate::kernels::constants::SORT_BINS;
use crate::tuning::SortMethod;
use crate::vk::Limits;

/// Subgroups of a sorting workgroup: each holds its own histogram in shared memory.
const SORT_SUBGROUPS: u32 = 8;
/// Keys of one invocation of a sort by matching.
const SORT_ITEMS: u32 = 16;
/// Keys of one invocation of a sort by runs: many enough that the run's own histogram costs little beside them, few
/// enough that the cache holds what a subgroup writes.
const SORT_RUN: u32 = 1024;
/// Bits of a digit of a sort by runs: with ten, the tiles of a small image need one pass.
const SORT_RUN_DIGIT_BITS: u32 = 10;
/// Pairs times passes that a single workgroup sorts on a processor: beyond, a second core gains more than dispatches
/// cost. (An invocation's loops stay within what [`Limits::max_loop_iterations`] allows, at four lanes as well.)
const SORT_SINGLE_SUBGROUP: u64 = 1 << 18;
/// And pairs, in however few passes.
const SORT_SINGLE_SUBGROUP_PAIRS: u64 = 1 << 17;
/// No device asks for more between the beginnings of two buffers in one allocation, bytes.
const BUFFER_ALIGNMENT: u64 = 256;

/// Invocations of a sorting workgroup, and keys of each. `size` is the usual value of a constant, or another one that was
/// asked for.
pub(super) fn shape(
    limits: &Limits,
    method: SortMethod,
    elementwise: u32,
    size: impl Fn(&str, &str, u32) -> u32,
) -> (u32, u32) {
    match method {
        SortMethod::Matching => {
            let preferred = size("sort", "WORKGROUP_SIZE", SORT_SUBGROUPS * limits.subgroup_size);
            (limits.workgroup_size(preferred.min(elementwise)), size("sort", "ITEMS", SORT_ITEMS))
        }
        // Keys are read in fours.
        SortMethod::Serial => (limits.subgroup_size, size("sort", "ITEMS", SORT_RUN).max(4)),
    }
}

impl LaunchSizes {
    /// Whether a single workgroup sorts up to `capacity` keys below 2^`key_bits`.
    pub fn sorts_in_single_subgroup(&self, capacity: u64, key_bits: u32) -> bool {
        let passes = u64::from(self.sort_passes(key_bits));
        self.sort_single_subgroup
            && capacity <= SORT_SINGLE_SUBGROUP_PAIRS
            && capacity * passes <= SORT_SINGLE_SUBGROUP
    }

    /// Bits of a sort's digit at most.
    pub const fn sort_digit_bits(&self) -> u32 {
        match self.sort_method {
            SortMethod::Matching => SORT_BINS.ilog2(),
            SortMethod::Serial => SORT_RUN_DIGIT_BITS,
        }
    }

    /// Passes of a sort of keys below 2^`key_bits`.
    pub const fn sort_passes(&self, key_bits: u32) -> u32 {
        key_bits.div_ceil(self.sort_digit_bits())
    }

    /// Words of a sort's histograms, for `n` keys below 2^`key_bits`: of the blocks, and of their runs.
    pub fn sort_histogram_words(&self, n: u64, key_bits: u32) -> u64 {
        let histograms = match self.sort_method {
            SortMethod::Matching => 1,
            SortMethod::Serial => 1 + u64::from(self.sort_workgroup),
        };
        let padding = BUFFER_ALIGNMENT / 4;
        blocks(n, self.sort.into()).max(1) * histograms * self.sort_digits(key_bits) + padding
    }

    /// Digits of a sort of keys below 2^`key_bits`. Never less than four, as runs count in fours.
    pub const fn sort_digits(&self, key_bits: u32) -> u64 {
        let digits = 1 << key_bits.div_ceil(self.sort_passes(key_bits));
        if digits < 4 { 4 } else { digits }
    }

    /// Where, in a sort's histograms, those of runs begin, bytes: after `bytes` bytes of blocks' histograms.
    pub(crate) const fn sort_runs_offset(bytes: u64) -> u64 {
        bytes.next_multiple_of(BUFFER_ALIGNMENT)
    }
}
