//! Exclusive prefix sum of u32 values on the device, usable alone.
//!
//! Reduce-then-scan in three dispatches: the sum of each block, a single workgroup's scan of those sums, and the scan
//! within each block. It assumes no forward progress between workgroups (a decoupled look-back gives wrong sums on
//! devices without it) and holds for any subgroup size from 4 to 128.

use crate::error::Result;
use crate::kernels::scan::{scan_apply, scan_reduce, scan_spine};
use crate::plan::{LaunchSizes, blocks};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// The kernels of a prefix sum.
pub struct Scan {
    reduce: Kernel<scan_reduce::Interface>,
    spine: Kernel<scan_spine::Interface>,
    apply: Kernel<scan_apply::Interface>,
    block: u32,
}

/// What a prefix sum works on.
#[derive(Clone, Copy)]
pub struct ScanBuffers<'a> {
    /// Where counts are: the number of values is `counts[count_index]`, the total goes to `counts[total_index]`
    /// (`u32::MAX` where it needs more bits, provided the sum of each block does not).
    pub counts: &'a Buffer,
    /// See `counts`.
    pub count_index: u32,
    /// See `counts`.
    pub total_index: u32,
    /// The values, u32.
    pub values: &'a Buffer,
    /// Where the prefix sums go; not the same as `values`.
    pub prefix: &'a Buffer,
    /// Scratch: [`Scan::block_words`] words.
    pub block_sums: &'a Buffer,
}

/// How many workgroups a stage over device-counted elements gets.
#[derive(Clone, Copy)]
pub enum Workgroups<'a> {
    /// Enough for this many elements, known to the host.
    Elements(u64),
    /// As many as these 12 bytes say.
    Indirect(&'a Buffer),
}

impl Scan {
    /// Builds the kernels.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context) -> Result<Self> {
        let limits = context.limits();
        let sizes = LaunchSizes::new(limits);
        let subgroup_size = limits.subgroup_size;
        let (workgroup_size, items) = (sizes.scan_workgroup, sizes.scan_items);
        let reduce = scan_reduce::Spec { workgroup_size, subgroup_size, items };
        let apply = scan_apply::Spec { workgroup_size, subgroup_size, items };
        Ok(Self {
            reduce: Kernel::new(context, &reduce)?,
            spine: Kernel::new(context, &scan_spine::Spec { workgroup_size, subgroup_size })?,
            apply: Kernel::new(context, &apply)?,
            block: sizes.scan,
        })
    }

    /// Words of scratch for `n` values.
    pub fn block_words(&self, n: u64) -> u64 {
        blocks(n, self.block.into()).max(1)
    }

    /// Records the prefix sum; the caller places a barrier before and after.
    pub fn record(&self, recorder: &mut Recorder, buffers: &ScanBuffers, workgroups: Workgroups) {
        let b = buffers;
        let reduce = scan_reduce::Bind { counts: b.counts, values: b.values, block_sums: b.block_sums };
        let push = scan_reduce::Push { count_index: b.count_index };
        match workgroups {
            Workgroups::Elements(n) => {
                recorder.dispatch(&self.reduce, &reduce, &push, blocks(n, self.block.into()))
            }
            Workgroups::Indirect(at) => recorder.dispatch_indirect(&self.reduce, &reduce, &push, at),
        }
        recorder.barrier();
        self.record_from_block_sums(recorder, buffers, workgroups);
    }

    /// Records the prefix sum of values whose sums per block of `Scan::block` lie in `block_sums` already; the caller
    /// places a barrier before and after.
    pub fn record_from_block_sums(
        &self,
        recorder: &mut Recorder,
        buffers: &ScanBuffers,
        workgroups: Workgroups,
    ) {
        let b = buffers;
        self.record_spine(recorder, b);
        recorder.barrier();
        let apply = scan_apply::Bind {
            counts: b.counts,
            values: b.values,
            block_offsets: b.block_sums,
            prefix: b.prefix,
        };
        let push = scan_apply::Push { count_index: b.count_index };
        match workgroups {
            Workgroups::Elements(n) => {
                recorder.dispatch(&self.apply, &apply, &push, blocks(n, self.block.into()))
            }
            Workgroups::Indirect(at) => recorder.dispatch_indirect(&self.apply, &apply, &push, at),
        }
    }

    fn record_spine(&self, recorder: &mut Recorder, b: &ScanBuffers) {
        recorder.dispatch(
            &self.spine,
            &scan_spine::Bind { block_sums: b.block_sums, totals: b.counts },
            &scan_spine::Push {
                count: b.count_index,
                from_totals: 1,
                block_size: self.block,
                total_index: b.total_index,
                first_sum: 0,
            },
            1,
        );
    }

    /// Records the scan of `row.1` block sums alone, in place, from word `row.0` on; their total goes to
    /// `totals[total_index]`.
    pub fn record_block_sums(
        &self,
        recorder: &mut Recorder,
        block_sums: &Buffer,
        row: (u32, u32),
        totals: &Buffer,
        total_index: u32,
    ) {
        let (first_sum, count) = row;
        recorder.dispatch(
            &self.spine,
            &scan_spine::Bind { block_sums, totals },
            &scan_spine::Push { count, from_totals: 0, block_size: 1, total_index, first_sum },
            1,
        );
    }
}
