//! Exclusive prefix sum of u32 values on the device, usable by itself.
//!
//! Reduce-then-scan in three dispatches: the sum of each block, a single workgroup's scan of those sums, and the scan within
//! each block. It assumes no forward progress between workgroups, unlike a decoupled look-back, whose sums are wrong on devices
//! without it. It works for any subgroup size from 4 to 128.

use crate::error::Result;
use crate::frame::{FrameBuffers, LaunchSizes, blocks};
use crate::kernels::constants::STATE_VISIBLE;
use crate::kernels::scan::{scan_apply, scan_reduce, scan_spine};
use crate::vk::{Buffer, Context, Kernel, KernelInterface, Recorder};

/// Kernels of a prefix sum.
pub struct Scan {
    reduce: Kernel<scan_reduce::Interface>,
    spine: Kernel<scan_spine::Interface>,
    /// Also writes arguments.
    counting_spine: Kernel<scan_spine::Interface>,
    apply: Kernel<scan_apply::Interface>,
    block: u32,
    /// Push constants of both spines that are always the same.
    push: scan_spine::Push,
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

/// A count of a frame that only the device knows, and its capacity. The scan clamps it, and writes the arguments of the indirect
/// dispatches over it.
#[derive(Clone, Copy)]
pub(crate) struct DeviceCount<'a> {
    pub frame: &'a FrameBuffers,
    /// Index of the count in the frame's state (STATE_*). The clamped one follows.
    pub count: u32,
    /// Largest number that the buffers hold.
    pub capacity: u32,
    /// Index of the first of three arguments (ARGUMENTS_*): elementwise, of the sort, of the caller (scan or duplicate).
    pub first_argument: u32,
    /// Elements per workgroup of the caller's dispatch.
    pub caller_block: u32,
    /// False: a frame's first count, that of the visible Gaussians, clears `STATE_OVERFLOW`, too.
    pub keeps_overflow: bool,
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
        let spine = |arguments| {
            let (workgroup_size, items) = (sizes.scan_spine_workgroup, limits.tuning.scan_spine_items);
            Kernel::new(context, &scan_spine::Spec { workgroup_size, subgroup_size, items, arguments })
        };
        Ok(Self {
            reduce: Kernel::new(context, &reduce)?,
            spine: spine(false)?,
            counting_spine: spine(true)?,
            apply: Kernel::new(context, &apply)?,
            block: sizes.scan_block,
            push: scan_spine::Push {
                block_elementwise: sizes.elementwise_workgroup,
                block_sort: sizes.sort_block,
                max_workgroups_per_axis: limits.max_workgroups_per_axis,
                ..scan_spine::Push::default()
            },
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
        let push = scan_spine::Push {
            count: b.count_index,
            from_totals: 1,
            block_size: self.block,
            total_index: b.total_index,
            ..self.push
        };
        self.record_spine(recorder, b.block_sums, b.counts, push, None);
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

    fn record_spine(
        &self,
        r: &mut Recorder,
        block_sums: &Buffer,
        totals: &Buffer,
        push: scan_spine::Push,
        counted: Option<DeviceCount>,
    ) {
        let Some(DeviceCount { frame, capacity, first_argument, caller_block, keeps_overflow, .. }) = counted
        else {
            // The plain kernel does not write this binding.
            let bind = scan_spine::Bind { block_sums, totals, arguments: totals };
            return r.dispatch(&self.spine, &bind, &push, 1);
        };
        let bind = scan_spine::Bind { block_sums, totals, arguments: &frame.arguments };
        let keeps_overflow = keeps_overflow.into();
        let push = scan_spine::Push { capacity, first_argument, caller_block, keeps_overflow, ..push };
        r.dispatch(&self.counting_spine, &bind, &push, 1);
    }

    /// Records only the scan of a frame's first `blocks` block sums, in place. Their total is the count. None: a sum for each
    /// [`LaunchSizes::scan_block`] visible Gaussians.
    pub(crate) fn record_counted_sums(
        &self,
        r: &mut Recorder,
        block_sums: &Buffer,
        blocks: Option<u32>,
        counted: DeviceCount,
    ) {
        let (count, from_totals, block_size) = match blocks {
            Some(blocks) => (blocks, 0, 1),
            None => (STATE_VISIBLE, 1, self.block),
        };
        let total_index = counted.count;
        let push = scan_spine::Push { count, from_totals, block_size, total_index, ..self.push };
        self.record_spine(r, block_sums, &counted.frame.state, push, Some(counted));
    }

    /// Records only the scan of `count` block sums, in place, from word `first_sum` on. `totals[total_index]` receives their total.
    pub fn record_block_sums(
        &self,
        recorder: &mut Recorder,
        block_sums: &Buffer,
        first_sum: u32,
        count: u32,
        totals: &Buffer,
        total_index: u32,
    ) {
        let push = scan_spine::Push { count, block_size: 1, total_index, first_sum, ..self.push };
        self.record_spine(recorder, block_sums, totals, push, None);
    }
}
