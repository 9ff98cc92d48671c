//! Exclusive prefix sum of u32 values on the device, usable by itself.
//!
//! Reduce-then-scan in three dispatches: the sum of each block, a single workgroup's scan of those sums, and the scan within
//! each block. It assumes no forward progress between workgroups, unlike a decoupled look-back, whose sums are wrong on devices
//! without it. It works for any subgroup size from 4 to 128.

use crate::error::Result;
use crate::frame::{LaunchSizes, blocks};
use crate::kernels::scan::{scan_apply, scan_reduce, scan_spine};
use crate::vk::{Buffer, Context, Kernel, KernelInterface, Recorder};

/// Kernels of a prefix sum.
pub struct Scan {
    reduce: Kernel<scan_reduce::Interface>,
    spine: Kernel<scan_spine::Interface>,
    apply: Kernel<scan_apply::Interface>,
    block: u32,
}

/// Buffers of a prefix sum.
#[derive(Clone, Copy)]
pub struct ScanBuffers<'a> {
    /// Counts: the number of values is read from `counts[count_index]`, and the total is written to `counts[total_index]`. A
    /// total above 32 bits becomes `u32::MAX`, provided that no block's sum exceeds 32 bits.
    pub counts: &'a Buffer,
    /// Index of the number of values in `counts`.
    pub count_index: u32,
    /// Index of the total in `counts`.
    pub total_index: u32,
    /// Values, u32.
    pub values: &'a Buffer,
    /// Output of the prefix sums; must not be `values`.
    pub prefix: &'a Buffer,
    /// Scratch: [`Scan::block_words`] words.
    pub block_sums: &'a Buffer,
}

/// How a stage over elements that the device counts is dispatched: for the host's upper bound, or by arguments of the device.
#[derive(Clone, Copy)]
pub enum Workgroups<'a> {
    /// Enough workgroups for this number of elements, an upper bound.
    Elements(u64),
    /// Indirect arguments, 12 bytes.
    Indirect(&'a Buffer),
}

impl Workgroups<'_> {
    /// Records a dispatch of a stage whose workgroups have `block` elements each.
    pub(crate) fn dispatch<K: KernelInterface>(
        self,
        recorder: &mut Recorder,
        kernel: &Kernel<K>,
        bind: &K::Bind<'_>,
        push: &K::Push,
        block: u32,
    ) {
        match self {
            Self::Elements(n) => recorder.dispatch(kernel, bind, push, blocks(n, block.into())),
            Self::Indirect(at) => recorder.dispatch_indirect(kernel, bind, push, at),
        }
    }
}

impl Scan {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let limits = context.limits();
        let sizes = LaunchSizes::new(limits);
        let subgroup_size = limits.subgroup_size;
        let (workgroup_size, items) = (sizes.scan_workgroup, sizes.scan_items);
        let reduce = scan_reduce::Spec { workgroup_size, subgroup_size, items };
        let apply = scan_apply::Spec { workgroup_size, subgroup_size, items };
        let spine = scan_spine::Spec {
            workgroup_size: sizes.scan_spine_workgroup,
            subgroup_size,
            items: limits.tuning.scan_spine_items,
        };
        Ok(Self {
            reduce: Kernel::new(context, &reduce)?,
            spine: Kernel::new(context, &spine)?,
            apply: Kernel::new(context, &apply)?,
            block: sizes.scan,
        })
    }

    /// Number of scratch words for `n` values.
    pub fn block_words(&self, n: u64) -> u64 {
        blocks(n, self.block.into()).max(1)
    }

    /// Records the prefix sum. The caller places a barrier before and after.
    pub fn record(&self, recorder: &mut Recorder, buffers: &ScanBuffers, workgroups: Workgroups) {
        let b = buffers;
        let reduce = scan_reduce::Bind { counts: b.counts, values: b.values, block_sums: b.block_sums };
        let push = scan_reduce::Push { count_index: b.count_index };
        workgroups.dispatch(recorder, &self.reduce, &reduce, &push, self.block);
        recorder.barrier();
        self.record_from_block_sums(recorder, buffers, workgroups);
    }

    /// Records the prefix sum of values with sums per block of `Scan::block` already in `block_sums`. The caller places a
    /// barrier before and after.
    pub fn record_from_block_sums(
        &self,
        recorder: &mut Recorder,
        buffers: &ScanBuffers,
        workgroups: Workgroups,
    ) {
        let b = buffers;
        let bind = scan_spine::Bind { block_sums: b.block_sums, totals: b.counts };
        let push = scan_spine::Push {
            count: b.count_index,
            from_totals: 1,
            block_size: self.block,
            total_index: b.total_index,
            first_sum: 0,
        };
        recorder.dispatch(&self.spine, &bind, &push, 1);
        recorder.barrier();
        let apply = scan_apply::Bind {
            counts: b.counts,
            values: b.values,
            block_offsets: b.block_sums,
            prefix: b.prefix,
        };
        let push = scan_apply::Push { count_index: b.count_index };
        workgroups.dispatch(recorder, &self.apply, &apply, &push, self.block);
    }

    /// Records only the scan of `row.1` block sums, in place, from word `row.0` on. `totals[total_index]` receives their total.
    pub fn record_block_sums(
        &self,
        recorder: &mut Recorder,
        block_sums: &Buffer,
        row: (u32, u32),
        totals: &Buffer,
        total_index: u32,
    ) {
        let (first_sum, count) = row;
        let push = scan_spine::Push { count, from_totals: 0, block_size: 1, total_index, first_sum };
        recorder.dispatch(&self.spine, &scan_spine::Bind { block_sums, totals }, &push, 1);
    }
}
