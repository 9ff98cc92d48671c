//! Sizes of workgroups and blocks on a device.

use super::tuning::{ELEMENTWISE_WORKGROUP, SortMethod, Tuning, WorkgroupRule};
use super::{NativeLayout, STRIP_ROWS};
use crate::kernels::constants::{SORT_BINS, SORT_GROUPS, TILE_SIZE};
use crate::kernels::sort::sort_downsweep;
use crate::vk::{KernelInterface, Limits};

/// Most entries of a tile per blending dispatch, on any device. It bounds the time of a dispatch, so that a desktop's
/// watchdog does not reset the device. One invocation blends this many entries; every other dispatch touches each Gaussian,
/// instance or pixel a constant number of times.
const MAX_ENTRIES_PER_PASS: u32 = 1 << 18;

/// `ceil(n / d)`.
pub const fn blocks(n: u64, d: u64) -> u64 {
    n.div_ceil(d)
}

/// Regions of tiles that subgroups blend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlendShape {
    /// Subgroup size.
    pub lanes: u32,
    /// Rows of pixels per region.
    pub region_height: u32,
    /// Invocations per tile: one subgroup per region.
    pub tile: u32,
}

impl BlendShape {
    fn new(tuning: &Tuning, lanes: u32) -> Self {
        let region_height = region_height(tuning, lanes);
        Self { lanes, region_height, tile: lanes * TILE_SIZE / 8 * (TILE_SIZE / region_height) }
    }
}

/// Sizes of workgroups and blocks on a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LaunchSizes {
    /// Choices for the device's class.
    pub tuning: &'static Tuning,
    /// Invocations of an elementwise workgroup, and size of a block in culling and densification.
    pub elementwise_workgroup: u32,
    /// How keys are sorted.
    pub sort_method: SortMethod,
    /// Invocations of a sorting workgroup.
    pub sort_workgroup: u32,
    /// Keys per invocation of a sort.
    pub sort_items: u32,
    /// Keys per block of a sort.
    pub sort_block: u32,
    /// True if a single subgroup sorts few pairs: see [`LaunchSizes::sorts_in_single_subgroup`].
    pub sort_single_subgroup: bool,
    /// Invocations of a scan's workgroup.
    pub scan_workgroup: u32,
    /// Invocations of the single workgroup that scans the block sums.
    pub scan_spine_workgroup: u32,
    /// Values per invocation of a scan.
    pub scan_items: u32,
    /// Values per block of a scan.
    pub scan_block: u32,
    /// Regions of forward blending.
    pub blend: BlendShape,
    /// Regions of backward blending, and of blending with outputs besides the picture.
    pub blend_heavy: BlendShape,
    /// Regions of a tile per subgroup in forward blending.
    pub regions_per_subgroup: u32,
    /// True if one subgroup blends all regions of a tile in the backward pass.
    pub blend_backward_subgroup_per_tile: bool,
    /// Invocations of a tile's workgroup in blend_shared: at most one per pixel, or per column of pixels.
    pub tile_shared: u32,
    /// Invocations of a workgroup of the loss.
    pub loss_workgroup: u32,
    /// Pixels per invocation, in a row, of the loss.
    pub loss_strip: u32,
    /// Invocations of a workgroup of the sweeping loss, which uses no shared memory.
    pub loss_sweep_workgroup: u32,
    /// True if the native layout is [`NativeLayout::Strips`].
    pub strips: bool,
    /// Largest size of a buffer, bytes.
    pub max_binding_bytes: u64,
    /// Most entries of a tile per blending pass.
    pub entries_per_pass: u32,
    /// Instances of a blending dispatch, which ends with the tile of the last one.
    pub instances_per_dispatch: u32,
}

/// Returns the rows of a tile's regions, 8 pixels wide, that subgroups of this size blend.
pub fn region_height(tuning: &Tuning, subgroup_size: u32) -> u32 {
    // Fewest rows of a subgroup.
    let lowest = (subgroup_size / 8).max(4);
    (tuning.region_pixels * subgroup_size / 8).clamp(lowest, lowest.max(8))
}

impl LaunchSizes {
    /// Computes the sizes for a device, with its [`Limits::overrides`].
    pub fn new(limits: &Limits) -> Self {
        Self::with_sort_method(limits, limits.tuning.sort_method)
    }

    /// Same as [`Self::new`], but with a given sorting method.
    pub fn with_sort_method(limits: &Limits, sort_method: SortMethod) -> Self {
        let tuning = limits.tuning;
        // Blocks nest in each other and in tiles, so every size is a power of two.
        let size = |folder: &str, constant: &str, usual: u32| {
            let requested = limits.overridden(folder, constant).unwrap_or(usual).max(1);
            1 << requested.ilog2()
        };
        let elementwise = limits
            .workgroup_size(size("", "WORKGROUP_SIZE", ELEMENTWISE_WORKGROUP).min(ELEMENTWISE_WORKGROUP));
        let (sort_workgroup, sort_items) = sort_shape(limits, sort_method, elementwise, size);
        let invocations = |rule| match rule {
            WorkgroupRule::Subgroup => limits.subgroup_size,
            WorkgroupRule::Elementwise => elementwise,
            WorkgroupRule::Invocations(count) => count,
        };
        let scan_items = size("scan", "ITEMS", tuning.scan_items).max(4);
        let scan_workgroup =
            limits.workgroup_size(size("scan", "WORKGROUP_SIZE", invocations(tuning.scan_workgroup)));
        let blend = BlendShape::new(tuning, limits.subgroup_size);
        let blend_heavy = match tuning.heavy_blending {
            true => BlendShape::new(tuning, limits.heavy_subgroup_size),
            false => blend,
        };
        let regions = blend.tile / blend.lanes;
        let whole_tiles = tuning.whole_tiles_from_lanes.is_some_and(|lanes| limits.subgroup_size >= lanes);
        let usual_regions = if whole_tiles { regions } else { 1 };
        let regions_per_subgroup = size("forward", "REGIONS_PER_SUBGROUP", usual_regions).min(regions.min(4));
        Self {
            tuning,
            elementwise_workgroup: elementwise,
            sort_method,
            sort_workgroup,
            sort_items,
            sort_block: sort_workgroup * sort_items,
            sort_single_subgroup: sort_method == SortMethod::Serial,
            scan_workgroup,
            scan_spine_workgroup: limits.workgroup_size(invocations(tuning.scan_spine_workgroup)),
            scan_items,
            scan_block: scan_workgroup * scan_items,
            blend,
            blend_heavy,
            regions_per_subgroup,
            blend_backward_subgroup_per_tile: whole_tiles,
            // A power of two divides the tile's pixels; subgroup sizes and limits are powers of two.
            tile_shared: elementwise.min(TILE_SIZE * TILE_SIZE / tuning.shared_tile_pixels),
            loss_workgroup: limits.workgroup_size(size(
                "loss",
                "WORKGROUP_SIZE",
                invocations(tuning.loss_workgroup),
            )),
            loss_strip: size("loss", "STRIP", tuning.loss_strip).min(TILE_SIZE),
            // There are few, long invocations: small workgroups spread them evenly.
            loss_sweep_workgroup: limits.workgroup_size(size("loss", "WORKGROUP_SIZE", limits.subgroup_size)),
            strips: NativeLayout::of(limits) == NativeLayout::Strips,
            max_binding_bytes: limits.max_storage_buffer_range.min(limits.max_allocation_bytes),
            // Some drivers limit the loop iterations of an invocation. An entry costs one iteration in each region of its
            // subgroup. It also costs a fraction of an iteration for its batch, at any subgroup size from 4.
            entries_per_pass: limits
                .max_loop_iterations
                .map_or(MAX_ENTRIES_PER_PASS, |n| n / (regions_per_subgroup + 1))
                .min(MAX_ENTRIES_PER_PASS),
            instances_per_dispatch: limits.instances_per_dispatch.max(1),
        }
    }

    /// Number of ranges into which blending, forward or backward, divides up to `instances` instances. Each has a dispatch per pass.
    pub fn blend_ranges(&self, instances: u32) -> u32 {
        instances.div_ceil(self.instances_per_dispatch).max(1)
    }

    /// Workgroups of an elementwise dispatch over `n` elements.
    pub(crate) fn groups(&self, n: impl Into<u64>) -> u64 {
        n.into().div_ceil(self.elementwise_workgroup.into())
    }

    /// Workgroups of an elementwise dispatch over a picture's pixels, including the padding of strips.
    pub(crate) fn picture_groups(&self, width: u32, height: u32) -> u64 {
        let rows = if self.strips { height.next_multiple_of(STRIP_ROWS) } else { height };
        self.groups(u64::from(width) * u64::from(rows))
    }

    /// Elements of the smallest block of any dispatch.
    pub(super) fn smallest(&self) -> u32 {
        self.elementwise_workgroup.min(self.sort_block).min(self.scan_block)
    }
}

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
/// Bytes by which the workgroups of a sort count themselves.
pub const SORT_ARRIVAL_BYTES: u64 = 4 * (SORT_GROUPS as u64 + 1);
/// Largest buffer alignment within one allocation that a device requires, bytes.
const BUFFER_ALIGNMENT: u64 = 256;

/// Returns the invocations of a sorting workgroup and the keys per invocation. `size` returns a constant's default or its
/// override.
fn sort_shape(
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

    /// Index of the pair of buffers, of the two between which a sort's passes alternate, that holds the sorted keys below
    /// 2^`key_bits`.
    pub const fn sorted_side(&self, key_bits: u32) -> usize {
        (self.sort_passes(key_bits) % 2) as usize
    }

    /// Number of passes of a sort of keys below 2^`key_bits`.
    pub const fn sort_passes(&self, key_bits: u32) -> u32 {
        key_bits.div_ceil(self.sort_digit_bits())
    }

    /// Words of a sort's histograms, for `n` keys below 2^`key_bits`: one per block, and one per run of a serial sort.
    pub fn sort_histogram_words(&self, n: u64, key_bits: u32) -> u64 {
        let blocks = blocks(n, self.sort_block.into()).max(1);
        let histograms = match self.sort_method {
            // Also one per group, and one for all.
            SortMethod::Matching => blocks + u64::from(SORT_GROUPS) + 1,
            SortMethod::Serial => blocks * (1 + u64::from(self.sort_workgroup)),
        };
        let padding = BUFFER_ALIGNMENT / 4;
        histograms * self.sort_digits(key_bits) + padding
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
