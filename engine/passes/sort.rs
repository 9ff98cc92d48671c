//! Stable radix sort of (u32 key, u32 value) pairs on the device, usable by itself.
//!
//! Least significant digit first, two dispatches per digit: a histogram per block with prefix sums over the blocks, and a stable
//! scatter. The serial sort has a third dispatch for the sums. No workgroup waits for another, so no forward progress is
//! assumed, and any subgroup size from 4 to 128 works. Only the given number of key bits is sorted. Counting and scattering
//! have two forms, see [`SortMethod`]. If [`LaunchSizes::sorts_in_single_subgroup`] is true, a single subgroup sorts the pairs
//! in one dispatch.

use crate::error::Result;
use crate::frame::{LaunchSizes, SortMethod, blocks};
use crate::kernels::sort::{
    sort_downsweep, sort_downsweep_serial, sort_single_subgroup, sort_spine, sort_upsweep,
    sort_upsweep_serial,
};
use crate::passes::scan::Workgroups;
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Kernels of a sort.
pub struct RadixSort {
    /// Sizes of its blocks and buffers.
    pub sizes: LaunchSizes,
    kernels: Kernels,
    /// Sort in a single subgroup: with given values, and with the keys' indices as values.
    single_subgroup: Option<[Kernel<sort_single_subgroup::Interface>; 2]>,
}

/// Kernels that count, and that scatter with given values and with the keys' indices.
enum Kernels {
    Matching {
        upsweep: Kernel<sort_upsweep::Interface>,
        downsweep: [Kernel<sort_downsweep::Interface>; 2],
    },
    Serial {
        upsweep: Kernel<sort_upsweep_serial::Interface>,
        spine: Kernel<sort_spine::Interface>,
        /// Number of digits per workgroup of the spine.
        rows: u32,
        downsweep: [Kernel<sort_downsweep_serial::Interface>; 2],
    },
}

/// Buffers of a sort. Keys start in `keys[0]` and end in those of [`LaunchSizes::sorted_side`].
#[derive(Clone, Copy)]
pub struct SortBuffers<'a> {
    /// The number of pairs is `counts[count_index]`.
    pub counts: &'a Buffer,
    /// Index of the number of pairs in `counts`.
    pub count_index: u32,
    /// Keys, u32: two buffers between which the passes alternate.
    pub keys: [&'a Buffer; 2],
    /// Values, u32: two buffers between which the passes alternate.
    pub values: [&'a Buffer; 2],
    /// Scratch: [`LaunchSizes::sort_histogram_words`] words.
    pub histogram: &'a Buffer,
    /// Scratch: [`RadixSort::digit_total_words`] words.
    pub digit_totals: &'a Buffer,
    /// [`SORT_ARRIVAL_BYTES`](crate::frame::SORT_ARRIVAL_BYTES) of zeros, which the sort leaves as zeros.
    pub arrivals: &'a Buffer,
}

impl SortBuffers<'_> {
    /// Capacity in pairs.
    fn capacity(&self) -> u64 {
        self.keys[0].bytes() / 4
    }
}

/// Source of the values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Values {
    /// Reads them from `values[0]`.
    Given,
    /// Uses the keys' indices 0, 1, 2, …; `values[0]` need not be written.
    Positions,
}

impl RadixSort {
    /// Builds the kernels of the method for the device.
    pub fn new(context: &Context) -> Result<Self> {
        Self::with_sizes(context, LaunchSizes::new(context.limits()))
    }

    /// Builds the kernels for the sizes of [`LaunchSizes::with_sort_method`].
    pub fn with_sizes(context: &Context, sizes: LaunchSizes) -> Result<Self> {
        let subgroup_size = context.limits().subgroup_size;
        let single = |identity_values| {
            let spec =
                sort_single_subgroup::Spec { workgroup_size: subgroup_size, subgroup_size, identity_values };
            Kernel::new(context, &spec)
        };
        Ok(Self {
            kernels: Kernels::new(context, &sizes)?,
            single_subgroup: if sizes.sort_single_subgroup {
                Some([single(false)?, single(true)?])
            } else {
                None
            },
            sizes,
        })
    }

    /// Number of scratch words for any number of pairs.
    pub fn digit_total_words(&self) -> u64 {
        1 << self.sizes.sort_digit_bits()
    }

    /// Records the sort of keys below 2^`key_bits`. Returns the index of the buffers with the result. The caller places a
    /// barrier before and after.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        buffers: &SortBuffers,
        values: Values,
        key_bits: u32,
        workgroups: Workgroups,
    ) -> usize {
        let passes = self.sizes.sort_passes(key_bits);
        let digit_bits = key_bits.div_ceil(passes);
        if let Some(kernels) = &self.single_subgroup
            && self.sizes.sorts_in_single_subgroup(buffers.capacity(), key_bits)
        {
            let kernel = &kernels[usize::from(values == Values::Positions)];
            let bytes = u64::from(self.sizes.sort_workgroup) * self.sizes.sort_digits(key_bits) * 4;
            let bind = sort_single_subgroup::Bind {
                counts: buffers.counts,
                keys_a: buffers.keys[0],
                values_a: buffers.values[0],
                keys_b: buffers.keys[1],
                values_b: buffers.values[1],
                run_counts: &buffers.histogram.range(0, bytes),
            };
            let push = sort_single_subgroup::Push { count_index: buffers.count_index, digit_bits, passes };
            recorder.dispatch(kernel, &bind, &push, 1);
            return self.sizes.sorted_side(key_bits);
        }
        for pass in 0..passes {
            if pass > 0 {
                recorder.barrier();
            }
            let shift = pass * digit_bits;
            let digit = Digit {
                shift,
                bits: digit_bits.min(key_bits - shift),
                from: (pass % 2) as usize,
                identity: pass == 0 && values == Values::Positions,
            };
            self.record_pass(recorder, buffers, digit, workgroups);
        }
        self.sizes.sorted_side(key_bits)
    }

    fn record_pass(&self, recorder: &mut Recorder, b: &SortBuffers, digit: Digit, workgroups: Workgroups) {
        let Digit { shift, bits, from, identity } = digit;
        let (counts, count_index, block) = (b.counts, b.count_index, self.sizes.sort_block);
        let (keys, values, to) = (b.keys[from], b.values[from], 1 - from);
        // The blocks' histograms come first, then those of their runs.
        let blocks = blocks(b.capacity(), block.into()).max(1);
        let of_blocks = (blocks << bits) * 4;
        let of_runs = blocks * u64::from(self.sizes.sort_workgroup) * (1 << bits).max(4) * 4;
        match &self.kernels {
            Kernels::Matching { upsweep, downsweep } => {
                let (histogram, arrivals) = (b.histogram, b.arrivals);
                let bind = sort_upsweep::Bind { counts, keys, histogram, arrivals };
                let push = sort_upsweep::Push { count_index, shift, bits };
                workgroups.dispatch(recorder, upsweep, &bind, &push, block);
                recorder.barrier();
                let bind = sort_downsweep::Bind {
                    counts,
                    keys,
                    values,
                    histogram,
                    sorted_keys: b.keys[to],
                    sorted_values: b.values[to],
                };
                let push = sort_downsweep::Push { count_index, shift, bits };
                workgroups.dispatch(recorder, &downsweep[usize::from(identity)], &bind, &push, block);
            }
            Kernels::Serial { upsweep, spine, rows, downsweep } => {
                let histogram = &b.histogram.range(0, of_blocks);
                let run_counts = &b.histogram.range(LaunchSizes::sort_runs_offset(of_blocks), of_runs);
                let bind = sort_upsweep_serial::Bind { counts, keys, histogram, run_counts };
                let push = sort_upsweep_serial::Push { count_index, shift, bits };
                workgroups.dispatch(recorder, upsweep, &bind, &push, block);
                recorder.barrier();
                let digits = 1 << bits;
                let bind = sort_spine::Bind { counts, histogram, digit_totals: b.digit_totals };
                let push = sort_spine::Push { count_index, block_size: block, digits };
                recorder.dispatch(spine, &bind, &push, digits.div_ceil(*rows).into());
                recorder.barrier();
                let bind = sort_downsweep_serial::Bind {
                    counts,
                    keys,
                    values,
                    histogram,
                    digit_totals: b.digit_totals,
                    run_counts,
                    sorted_keys: b.keys[to],
                    sorted_values: b.values[to],
                };
                let push = sort_downsweep_serial::Push { count_index, shift, bits };
                workgroups.dispatch(recorder, &downsweep[usize::from(identity)], &bind, &push, block);
            }
        }
    }
}

impl Kernels {
    fn new(context: &Context, sizes: &LaunchSizes) -> Result<Self> {
        let (workgroup_size, items) = (sizes.sort_workgroup, sizes.sort_items);
        let subgroup_size = context.limits().subgroup_size;
        match sizes.sort_method {
            SortMethod::Matching => {
                let downsweep = |identity_values| {
                    let spec = sort_downsweep::Spec { workgroup_size, subgroup_size, items, identity_values };
                    Kernel::new(context, &spec)
                };
                let upsweep = sort_upsweep::Spec { workgroup_size, items };
                let (upsweep, downsweep) =
                    (Kernel::new(context, &upsweep)?, [downsweep(false)?, downsweep(true)?]);
                Ok(Self::Matching { upsweep, downsweep })
            }
            SortMethod::Serial => {
                let downsweep = |identity_values| {
                    let spec =
                        sort_downsweep_serial::Spec { workgroup_size, subgroup_size, items, identity_values };
                    Kernel::new(context, &spec)
                };
                let upsweep = sort_upsweep_serial::Spec { workgroup_size, subgroup_size, items };
                let spine_workgroup = sizes.elementwise_workgroup;
                let spine = sort_spine::Spec { workgroup_size: spine_workgroup, subgroup_size };
                Ok(Self::Serial {
                    upsweep: Kernel::new(context, &upsweep)?,
                    spine: Kernel::new(context, &spine)?,
                    rows: spine_workgroup / subgroup_size,
                    downsweep: [downsweep(false)?, downsweep(true)?],
                })
            }
        }
    }
}

#[derive(Clone, Copy)]
struct Digit {
    shift: u32,
    bits: u32,
    from: usize,
    identity: bool,
}
