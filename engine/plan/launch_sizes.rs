//! Sizes of workgroups and blocks on a device.

use super::sorting;
use super::strips::Strips;
use crate::kernels::constants::TILE_SIZE;
use crate::tuning::{ELEMENTWISE_WORKGROUP, SortMethod, Tuning, WorkgroupRule};
use crate::vk::Limits;

/// Most entries of a tile per blending dispatch, on any device. It bounds the time of a dispatch, so that a desktop's
/// watchdog does not reset the device. One invocation blends this many entries; every other dispatch touches each Gaussian,
/// instance or pixel a constant number of times.
const MAX_ENTRIES_PER_PASS: u32 = 1 << 18;

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
    /// Invocations of an elementwise workgroup, and size of a block in culling and densification.
    pub elementwise_workgroup: u32,
    /// How keys are sorted.
    pub sort_method: SortMethod,
    /// Invocations of a sorting workgroup.
    pub sort_workgroup: u32,
    /// Keys per invocation of a sort.
    pub sort_items: u32,
    /// Keys per block of a sort.
    pub sort: u32,
    /// True if a single subgroup sorts few pairs: see [`LaunchSizes::sorts_in_single_subgroup`].
    pub sort_single_subgroup: bool,
    /// Invocations of a scan's workgroup.
    pub scan_workgroup: u32,
    /// Invocations of the single workgroup that scans the block sums.
    pub scan_spine_workgroup: u32,
    /// Values per invocation of a scan.
    pub scan_items: u32,
    /// Values per block of a scan.
    pub scan: u32,
    /// Instances per invocation of duplicate_with_tiles.
    pub duplicate_items: u32,
    /// Regions of forward blending.
    pub blend: BlendShape,
    /// Regions of blending that also writes picks or motions.
    pub blend_auxiliary: BlendShape,
    /// Regions of backward blending.
    pub blend_backward: BlendShape,
    /// Regions of a tile per subgroup in forward blending.
    pub regions_per_subgroup: u32,
    /// True if one subgroup blends all regions of a tile in the backward pass.
    pub blend_backward_subgroup_per_tile: bool,
    /// Invocations of a tile's workgroup in blend_shared: at most one per pixel, or per column of pixels.
    pub tile_shared: u32,
    /// Interleaving of the rows of tiles over consecutive workgroups (tile_order.glsl); a power of two.
    pub tile_row_interleave: u32,
    /// True if opacities along a column of pixels use the incremental exponential.
    pub incremental_exp: bool,
    /// True if loops over groups of SH coefficients are not unrolled.
    pub sh_loops: bool,
    /// Invocations of a workgroup of the loss.
    pub loss: u32,
    /// Pixels per invocation, in a row, of the loss.
    pub loss_strip: u32,
    /// Invocations of a workgroup of the sweeping loss, which uses no shared memory.
    pub loss_sweep: u32,
    /// True if blending, the loss and the backward pass exchange pictures in strips ([`Strips`]).
    pub strips: bool,
    /// Largest size of a buffer, bytes.
    pub max_binding_bytes: u64,
    /// Most entries of a tile per blending pass.
    pub entries_per_pass: u32,
    /// Instances of all tiles per blending dispatch; it may exceed this to complete its last tile.
    pub instances_per_dispatch: u32,
}

/// Returns the rows of a tile's regions, 8 pixels wide, that subgroups of this size blend.
pub fn region_height(tuning: &Tuning, subgroup_size: u32) -> u32 {
    // Fewest rows of a subgroup.
    let least = (subgroup_size / 8).max(4);
    (tuning.region_pixels * subgroup_size / 8).clamp(least, least.max(8))
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
            let asked = limits.overridden(folder, constant).unwrap_or(usual).max(1);
            1 << asked.ilog2()
        };
        let elementwise = limits
            .workgroup_size(size("", "WORKGROUP_SIZE", ELEMENTWISE_WORKGROUP).min(ELEMENTWISE_WORKGROUP));
        let (sort_workgroup, sort_items) = sorting::shape(limits, sort_method, elementwise, size);
        let invocations = |rule| match rule {
            WorkgroupRule::Subgroup => limits.subgroup_size,
            WorkgroupRule::Elementwise => elementwise,
            WorkgroupRule::Invocations(count) => count,
        };
        let scan_items = size("scan", "ITEMS", tuning.scan_items).max(4);
        let scan_workgroup =
            limits.workgroup_size(size("scan", "WORKGROUP_SIZE", invocations(tuning.scan_workgroup)));
        let blend = BlendShape::new(tuning, limits.subgroup_size);
        let heaviest = match tuning.heavy_blending {
            true => BlendShape::new(tuning, limits.heavy_subgroup_size),
            false => blend,
        };
        let regions = blend.tile / blend.lanes;
        let whole_tiles = tuning.whole_tiles_from_lanes.is_some_and(|lanes| limits.subgroup_size >= lanes);
        let usual_regions = if whole_tiles { regions } else { 1 };
        let regions_per_subgroup = size("forward", "REGIONS_PER_SUBGROUP", usual_regions).min(regions.min(4));
        Self {
            elementwise_workgroup: elementwise,
            sort_method,
            sort_workgroup,
            sort_items,
            sort: sort_workgroup * sort_items,
            sort_single_subgroup: sort_method == SortMethod::Serial,
            scan_workgroup,
            scan_spine_workgroup: limits.workgroup_size(invocations(tuning.scan_spine_workgroup)),
            scan_items,
            scan: scan_workgroup * scan_items,
            duplicate_items: tuning.duplicate_items,
            blend,
            blend_auxiliary: heaviest,
            blend_backward: heaviest,
            regions_per_subgroup,
            blend_backward_subgroup_per_tile: whole_tiles,
            // A power of two divides the tile's pixels; subgroup sizes and limits are powers of two.
            tile_shared: elementwise.min(TILE_SIZE * TILE_SIZE / tuning.shared_tile_pixels),
            tile_row_interleave: tuning.tile_row_interleave,
            incremental_exp: tuning.incremental_exp,
            sh_loops: tuning.sh_loops,
            loss: limits.workgroup_size(size("loss", "WORKGROUP_SIZE", invocations(tuning.loss_workgroup))),
            loss_strip: size("loss", "STRIP", tuning.loss_strip).min(TILE_SIZE),
            // There are few, long invocations: small workgroups spread them evenly.
            loss_sweep: limits.workgroup_size(size("loss", "WORKGROUP_SIZE", limits.subgroup_size)),
            strips: Strips::suit(limits),
            max_binding_bytes: limits.max_storage_buffer_range.min(limits.max_allocation_bytes),
            // Some drivers limit the loop iterations of an invocation. An entry costs one iteration in each region of its
            // subgroup. It also costs a fraction of an iteration for its batch, at any subgroup size from 4.
            entries_per_pass: limits
                .max_loop_iterations()
                .map_or(MAX_ENTRIES_PER_PASS, |n| n / (regions_per_subgroup + 1))
                .min(MAX_ENTRIES_PER_PASS),
            instances_per_dispatch: limits.instances_per_dispatch.max(1),
        }
    }
}

impl LaunchSizes {
    /// Number of dispatches of blending, forward or backward, for frames with up to `instances` instances.
    pub fn blend_dispatches(&self, instances: u32, passes: u32) -> u32 {
        instances.div_ceil(self.instances_per_dispatch).max(1).saturating_mul(passes)
    }

    /// Elements of the smallest block of any dispatch.
    pub(super) fn smallest(&self) -> u32 {
        self.elementwise_workgroup.min(self.sort).min(self.scan)
    }
}
