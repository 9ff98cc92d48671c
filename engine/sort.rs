//! Stable radix sort of (u32 key, u32 value) pairs on the device, usable alone.
//!
//! Least significant digit first, 8 bits at most per pass, three dispatches each: a histogram per block, the scan of
//! each digit's row, a stable scatter. Reduce-then-scan, so no forward progress between workgroups is assumed, and any
//! subgroup size from 4 to 128 does. Only as many bits as the keys have are sorted.

use crate::error::Result;
use crate::kernels::constants::SORT_BINS;
use crate::kernels::sort::{sort_count, sort_scan, sort_scatter};
use crate::plan::{Blocks, blocks};
use crate::scan::Workgroups;
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Bits of a digit at most.
const DIGIT_BITS: u32 = SORT_BINS.ilog2();

/// The kernels of a sort.
pub struct RadixSort {
    count: Kernel<sort_count::Interface>,
    scan: Kernel<sort_scan::Interface>,
    scatter: Kernel<sort_scatter::Interface>,
    scatter_identity: Kernel<sort_scatter::Interface>,
    block: u32,
    /// Digits of one workgroup of the histogram's scan.
    rows: u32,
}

/// What a sort works on. Keys start in `keys[0]`; where they end depends on the number of passes, see
/// [`RadixSort::passes`].
#[derive(Clone, Copy)]
pub struct SortBuffers<'a> {
    /// The number of pairs is `counts[count_index]`.
    pub counts: &'a Buffer,
    /// See `counts`.
    pub count_index: u32,
    /// Keys, u32: two buffers that passes alternate between.
    pub keys: [&'a Buffer; 2],
    /// Values, u32, likewise.
    pub values: [&'a Buffer; 2],
    /// Scratch: [`RadixSort::histogram_words`] words.
    pub histogram: &'a Buffer,
    /// Scratch: 256 words.
    pub digit_totals: &'a Buffer,
}

/// Where the values come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Values {
    /// `values[0]`.
    Given,
    /// The keys' positions 0, 1, 2, …; `values[0]` need not be written.
    Positions,
}

impl RadixSort {
    /// Builds the kernels.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context) -> Result<Self> {
        let limits = context.limits();
        let sizes = Blocks::new(limits);
        let subgroup_size = limits.subgroup_size;
        let workgroup_size = sizes.sort_workgroup;
        let scatter = sort_scatter::Spec {
            workgroup_size,
            subgroup_size,
            items: sizes.sort_items,
            identity_values: false,
        };
        Ok(Self {
            count: Kernel::new(context, &sort_count::Spec { workgroup_size, items: sizes.sort_items })?,
            scan: Kernel::new(context, &sort_scan::Spec { workgroup_size: sizes.stream, subgroup_size })?,
            scatter: Kernel::new(context, &scatter)?,
            scatter_identity: Kernel::new(context, &sort_scatter::Spec { identity_values: true, ..scatter })?,
            block: sizes.sort,
            rows: sizes.stream / subgroup_size,
        })
    }

    /// Words of scratch for `n` pairs.
    pub fn histogram_words(&self, n: u64) -> u64 {
        u64::from(SORT_BINS) * blocks(n, self.block.into()).max(1)
    }

    /// Pairs of one block.
    pub fn block(&self) -> u32 {
        self.block
    }

    /// Passes for keys below 2^`key_bits`: the result lies in buffers `passes % 2`.
    pub const fn passes(key_bits: u32) -> u32 {
        key_bits.div_ceil(DIGIT_BITS)
    }

    /// Records the sort of keys below 2^`key_bits`; the caller places a barrier before and after. Returns which of the
    /// two buffers hold the result.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        buffers: &SortBuffers,
        values: Values,
        key_bits: u32,
        workgroups: Workgroups,
    ) -> usize {
        let passes = Self::passes(key_bits);
        let digit_bits = key_bits.div_ceil(passes);
        for pass in 0..passes {
            if pass > 0 {
                recorder.barrier();
            }
            let shift = pass * digit_bits;
            let digit = Digit { shift, bits: digit_bits.min(key_bits - shift), from: (pass % 2) as usize };
            let identity = pass == 0 && values == Values::Positions;
            self.record_pass(recorder, buffers, digit, identity, workgroups);
        }
        (passes % 2) as usize
    }

    fn record_pass(
        &self,
        recorder: &mut Recorder,
        b: &SortBuffers,
        digit: Digit,
        identity: bool,
        workgroups: Workgroups,
    ) {
        let Digit { shift, bits, from } = digit;
        let count_index = b.count_index;
        let count = sort_count::Bind { counts: b.counts, keys: b.keys[from], histogram: b.histogram };
        let push = sort_count::Push { count_index, shift, bits };
        match workgroups {
            Workgroups::Elements(n) => {
                recorder.dispatch(&self.count, &count, &push, blocks(n, self.block.into()))
            }
            Workgroups::Indirect(at) => recorder.dispatch_indirect(&self.count, &count, &push, at),
        }
        recorder.barrier();
        let digits = 1 << bits;
        recorder.dispatch(
            &self.scan,
            &sort_scan::Bind { counts: b.counts, histogram: b.histogram, digit_totals: b.digit_totals },
            &sort_scan::Push { count_index, block_size: self.block, digits },
            blocks(digits.into(), self.rows.into()),
        );
        recorder.barrier();
        let scatter = sort_scatter::Bind {
            counts: b.counts,
            keys: b.keys[from],
            values: b.values[from],
            histogram: b.histogram,
            digit_totals: b.digit_totals,
            sorted_keys: b.keys[1 - from],
            sorted_values: b.values[1 - from],
        };
        let kernel = if identity { &self.scatter_identity } else { &self.scatter };
        let push = sort_scatter::Push { count_index, shift, bits };
        match workgroups {
            Workgroups::Elements(n) => {
                recorder.dispatch(kernel, &scatter, &push, blocks(n, self.block.into()))
            }
            Workgroups::Indirect(at) => recorder.dispatch_indirect(kernel, &scatter, &push, at),
        }
    }
}

#[derive(Clone, Copy)]
struct Digit {
    shift: u32,
    bits: u32,
    from: usize,
}
