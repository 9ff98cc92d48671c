//! Table of the kernels, sizes and layouts that differ between processors and GPUs.
//!
//! A device's [`Tuning`] is a row of this table. The row is set once, when the device is opened
//! ([`Limits::tuning`](crate::vk::Limits::tuning)); no other file asks what kind of device it is.
//! [`Limits`](crate::vk::Limits) holds the bounds that a device reports.
//!
//! [`ContextOptions::backend`](crate::vk::ContextOptions::backend) overrides the row: a GPU's kernels and layouts then run on a
//! software driver, where they can be tested and debugged without a GPU.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Default number of invocations of an elementwise workgroup; the device's limits may lower it.
pub(crate) const ELEMENTWISE_WORKGROUP: u32 = 256;

/// Class of devices, which selects a row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Backend {
    /// A driver that runs shaders on the processor, such as Mesa's llvmpipe.
    Processor,
    /// Everything else.
    Gpu,
}

impl FromStr for Backend {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "processor" => Ok(Self::Processor),
            "gpu" => Ok(Self::Gpu),
            _ => Err(format!("is '{text}'; give gpu or processor")),
        }
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Processor => "processor",
            Self::Gpu => "gpu",
        })
    }
}

/// How a radix sort ranks keys of equal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SortMethod {
    /// A subgroup takes consecutive keys side by side and matches their digits. Accesses are coalesced, histograms lie in
    /// shared memory.
    Matching,
    /// Each invocation takes a run of consecutive keys, one after the other, with its own histogram in device memory. Suits
    /// processors: they gain nothing from coalescing or more invocations, and every memory access and barrier costs time.
    Serial,
}

/// Rule for the size of a workgroup.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorkgroupRule {
    /// One subgroup.
    Subgroup,
    /// Same as elementwise kernels.
    Elementwise,
    /// This number of invocations, if the device allows it.
    Invocations(u32),
}

/// One row of the table. Values before limits and overrides bound them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Tuning {
    /// Class of devices.
    pub backend: Backend,
    /// Subgroup size, if the device has it and lets it be chosen. None: the device's default.
    pub lanes: Option<u32>,
    /// Same as [`Self::lanes`], but for the kernels with the most registers, such as the backward projection.
    pub heavy_lanes: Option<u32>,
    /// True if blending with outputs besides the picture, and backward blending, use [`Self::heavy_lanes`].
    pub heavy_blending: bool,
    /// How keys are sorted.
    pub sort_method: SortMethod,
    /// Keys per invocation of a sort by matching.
    pub sort_items: u32,
    /// Values per invocation of a prefix sum, which reads them in fours.
    pub scan_items: u32,
    /// Workgroup of a prefix sum.
    pub scan_workgroup: WorkgroupRule,
    /// Workgroup of the single scan over the block sums of a prefix sum.
    pub scan_spine_workgroup: WorkgroupRule,
    /// Block sums per invocation and round of that scan.
    pub scan_spine_items: u32,
    /// Instances per invocation of `duplicate_with_tiles`.
    pub duplicate_items: u32,
    /// Smallest subgroup that blends all regions of a tile, forward and backward. None: one region per subgroup.
    pub whole_tiles_from_lanes: Option<u32>,
    /// Pixels per invocation in a region. Regions have 4 to 8 rows, 16 for subgroups of 128.
    pub region_pixels: u32,
    /// True if subgroups share Gaussians by broadcasts, not by shuffles (splat_shuffle.glsl).
    pub broadcasts: bool,
    /// True if Gaussians are shared in shared memory instead, in kernels whose region belongs to one subgroup.
    pub shared_splats: bool,
    /// Pixels per invocation, in a column, when a tile is blended from shared memory.
    pub shared_tile_pixels: u32,
    /// Number of interleaved strands of tile rows, a power of two (tile_order.glsl). 1: row by row.
    pub tile_row_interleave: u32,
    /// True if opacities along a column of pixels follow from one another, without an exponential each.
    pub incremental_exp: bool,
    /// True if loops over groups of SH coefficients are not unrolled (sh.glsl).
    pub sh_loops: bool,
    /// Workgroup of the loss by blocks.
    pub loss_workgroup: WorkgroupRule,
    /// Pixels per invocation, in a row, of the loss by blocks.
    pub loss_strip: u32,
    /// True if kernels with both forms read texels (buffers.glsl), if the buffer has few enough texels.
    pub reads_texels: bool,
    /// Largest subgroup with which pictures between blending and loss are stored in strips. None: row by row.
    pub strips_up_to_lanes: Option<u32>,
    /// True if the commands of a recording run one after the other, so that a top-of-pipe timestamp marks the end of all
    /// earlier commands. On llvmpipe such a timestamp takes 2 µs, a timestamp after all commands 30 µs.
    pub runs_in_order: bool,
    /// True if the device-local heap bounds allocations. A processor's heap is main memory, which can be swapped.
    pub heap_is_bound: bool,
    /// True if benchmarks must use few iterations and invocations.
    pub is_slow: bool,
}

impl Tuning {
    /// Measured on Mesa llvmpipe with 4, 8 and 16 lanes (tools/experiments.md).
    pub const PROCESSOR: Self = Self {
        backend: Backend::Processor,
        lanes: None,
        heavy_lanes: None,
        heavy_blending: false,
        sort_method: SortMethod::Serial,
        sort_items: 16,
        // Few invocations need no barriers.
        scan_items: 256,
        scan_workgroup: WorkgroupRule::Subgroup,
        scan_spine_workgroup: WorkgroupRule::Subgroup,
        scan_spine_items: 1,
        // Many instances share the search for the first Gaussian.
        duplicate_items: 16,
        // A processor's pixels are in memory anyway, and each Gaussian is fetched once, not once per region. Below 8 lanes
        // the code would be too long to compile.
        whole_tiles_from_lanes: Some(8),
        // Registers are memory on a processor.
        region_pixels: 16,
        broadcasts: false,
        shared_splats: false,
        // Each column has its own chain of opacities.
        shared_tile_pixels: 8,
        tile_row_interleave: 16,
        // exp2 takes about twenty instructions.
        incremental_exp: true,
        // Registers are memory on a processor, and a loop's branches take time.
        sh_loops: false,
        loss_workgroup: WorkgroupRule::Invocations(64),
        loss_strip: 4,
        reads_texels: true,
        strips_up_to_lanes: Some(16),
        runs_in_order: true,
        heap_is_bound: false,
        is_slow: true,
    };

    /// From the kernels' structure and compilers' estimates. Where an H100 or H200 is named, from measured times
    /// (tools/experiments.md). No other GPU has been measured.
    pub const GPU: Self = Self {
        backend: Backend::Gpu,
        lanes: None,
        heavy_lanes: None,
        heavy_blending: false,
        sort_method: SortMethod::Matching,
        // Keys and their ranks stay in registers, a block of pairs in shared memory. On an H200, 16 items slow small steps
        // by 2 % and speed up sorts of a million pairs and more by 5 to 8 % (tools/experiments.md).
        sort_items: 8,
        scan_items: 4,
        scan_workgroup: WorkgroupRule::Elementwise,
        // Few rounds: they run one after the other.
        scan_spine_workgroup: WorkgroupRule::Invocations(1024),
        scan_spine_items: 4,
        duplicate_items: 4,
        whole_tiles_from_lanes: None,
        // Four pixels spill on Intel (tools/gpu_static.md), and small regions cull more.
        region_pixels: 2,
        // Up to a seventh fewer estimated cycles on Intel; the same code on AMD and NVK.
        broadcasts: true,
        shared_splats: false,
        shared_tile_pixels: 1,
        tile_row_interleave: 1,
        // exp2 is one instruction.
        incremental_exp: false,
        // Twice as many subgroups fit where parameters are read and written.
        sh_loops: true,
        loss_workgroup: WorkgroupRule::Invocations(256),
        // Narrow enough to fill a workgroup.
        loss_strip: 2,
        reads_texels: false,
        strips_up_to_lanes: None,
        runs_in_order: false,
        heap_is_bound: true,
        is_slow: false,
    };

    /// Registers hold 16 lanes of most kernels, 32 of few, and 8 of the heaviest (tools/gpu_static.md). Xe2 has twice the
    /// registers and no subgroups of 8. It spills in three kernels at 32 lanes, in none at 16. Two loss pixels per
    /// invocation spill on some devices.
    pub const INTEL: Self =
        Self { lanes: Some(16), heavy_lanes: Some(8), heavy_blending: true, loss_strip: 1, ..Self::GPU };

    /// 64 lanes, the driver's default, take fewer estimated cycles per Gaussian in most kernels of RDNA. In the heaviest
    /// they take 1.2 to 1.9 times as many as 32 lanes, per pixel or Gaussian (tools/gpu_static.md). GCN has only 64.
    pub const AMD: Self = Self { heavy_lanes: Some(32), heavy_blending: true, ..Self::GPU };

    /// Measured on an H100 and an H200 (tools/experiments.md).
    pub const NVIDIA: Self =
        Self { shared_splats: true, loss_workgroup: WorkgroupRule::Invocations(128), ..Self::GPU };

    /// Returns the row of a GPU, by the PCI id of its vendor.
    pub(crate) const fn of_vendor(vendor: u32) -> &'static Self {
        match vendor {
            0x1002 => &Self::AMD,
            0x8086 => &Self::INTEL,
            0x10DE => &Self::NVIDIA,
            _ => &Self::GPU,
        }
    }

    /// Returns the subgroup sizes of usual and of the heaviest kernels. `own` is the device's default. `selectable` are the
    /// sizes that a pipeline may require, None if it may require none. `max_workgroup_subgroups` bounds the subgroups of a
    /// workgroup.
    pub fn subgroup_sizes(
        &self,
        own: u32,
        selectable: Option<RangeInclusive<u32>>,
        max_workgroup_subgroups: u32,
    ) -> [u32; 2] {
        let required = |lanes: &u32| selectable.as_ref().is_some_and(|sizes| sizes.contains(lanes));
        let usual = self.lanes.filter(required).unwrap_or(own);
        let fits = |lanes: &u32| ELEMENTWISE_WORKGROUP / lanes <= max_workgroup_subgroups;
        [usual, self.heavy_lanes.filter(required).filter(fits).unwrap_or(usual)]
    }

    /// Returns the row of a class of devices.
    pub const fn of(backend: Backend) -> &'static Self {
        match backend {
            Backend::Processor => &Self::PROCESSOR,
            Backend::Gpu => &Self::GPU,
        }
    }
}
