//! What is chosen differently for processors and for GPUs: kernels, sizes and layouts, in one table.
//!
//! A device's [`Tuning`] is a row of this table. The row is set once, when the device is opened
//! ([`Limits::tuning`](crate::vk::Limits::tuning)); no other file asks what kind of device it is. Bounds that a device reports
//! are facts and stand in [`Limits`](crate::vk::Limits); what a driver does against the specification stands in
//! [`Workarounds`](crate::vk::Workarounds).
//!
//! [`ContextOptions::backend`](crate::vk::ContextOptions::backend) overrides the row: a GPU's kernels and layouts then run on a
//! software driver, where they can be tested and debugged without a GPU.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Invocations of an elementwise workgroup, if the device allows it; the heaviest kernels have these.
pub(crate) const ELEMENTWISE_WORKGROUP: u32 = 256;

/// The class of devices that a row of the table is for.
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
    /// Each invocation takes a run of consecutive keys, one after the other, with its own histogram in device memory. For
    /// processors: coalescing and the number of invocations do not count there, every memory access and barrier does.
    Serial,
}

/// Workgroup sizes that follow from the subgroup or from the elementwise workgroup.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorkgroupRule {
    /// One subgroup.
    Subgroup,
    /// As elementwise kernels have.
    Elementwise,
    /// So many invocations, where the device allows it.
    Invocations(u32),
}

/// One row of the table. Numbers are the values before limits and overrides bound them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Tuning {
    /// The class of devices.
    pub backend: Backend,
    /// Size of subgroups, where the device has it and lets it be chosen; None: the device's own.
    pub lanes: Option<u32>,
    /// The same for the kernels with the most registers: the backward pass of the projection.
    pub heavy_lanes: Option<u32>,
    /// Whether the backward pass of blending and the blending of picks and motions are among these.
    pub heavy_blending: bool,
    /// How keys are sorted.
    pub sort_method: SortMethod,
    /// Keys of one invocation of a sort by matching.
    pub sort_items: u32,
    /// Values of one invocation of a prefix sum; read in fours.
    pub scan_items: u32,
    /// Workgroup of a prefix sum.
    pub scan_workgroup: WorkgroupRule,
    /// Workgroup of the scan of a prefix sum's blocks, of which there is one; and block sums of an invocation in a round.
    pub scan_spine_workgroup: WorkgroupRule,
    /// See [`Self::scan_spine_workgroup`].
    pub scan_spine_items: u32,
    /// Instances of one invocation of `duplicate_with_tiles`.
    pub duplicate_items: u32,
    /// The smallest subgroup that blends all regions of a tile, forward and backward; None: one region each.
    pub whole_tiles_from_lanes: Option<u32>,
    /// Pixels of an invocation in a region: regions have 4 to 8 rows, 16 for subgroups of 128.
    pub region_pixels: u32,
    /// Whether Gaussians are handed over a subgroup by broadcasts, in place of shuffles (splat_shuffle.glsl).
    pub broadcasts: bool,
    /// Whether they are handed over in shared memory instead, where a kernel's region is a subgroup's own.
    pub shared_splats: bool,
    /// Pixels of an invocation of a tile that is blended from shared memory: a column of them.
    pub shared_tile_pixels: u32,
    /// Strands of interleaved rows of tiles, a power of two (tile_order.glsl); 1: row by row.
    pub tile_row_interleave: u32,
    /// Whether opacities follow from one another along a column of pixels, in place of an exponential each.
    pub incremental_exp: bool,
    /// Whether loops over groups of SH coefficients stay loops (sh.glsl).
    pub sh_loops: bool,
    /// Workgroup of the loss by blocks.
    pub loss_workgroup: WorkgroupRule,
    /// Pixels in a row of one invocation of the loss by blocks.
    pub loss_strip: u32,
    /// Whether kernels that exist in both forms read texels (buffers.glsl), where buffers have few enough texels.
    pub reads_texels: bool,
    /// Largest subgroup with which pictures between blending and loss lie in strips; None: row by row.
    pub strips_up_to_lanes: Option<u32>,
    /// Whether commands of a recording run one after the other, so that the top of the pipe is the end of all commands before.
    /// On llvmpipe such a timestamp takes 2 µs, one after all commands 30 µs.
    pub runs_in_order: bool,
    /// Whether the device-local heap bounds what can be allocated. A processor's heap is main memory, which can be swapped.
    pub heap_is_bound: bool,
    /// Whether benchmarks have to do with few iterations and invocations.
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
        // Few invocations without barriers.
        scan_items: 256,
        scan_workgroup: WorkgroupRule::Subgroup,
        scan_spine_workgroup: WorkgroupRule::Subgroup,
        scan_spine_items: 1,
        // The search for the first Gaussian is shared by many instances.
        duplicate_items: 16,
        // A processor's pixels lie in memory anyway, and a Gaussian is fetched once in place of once per region. Below 8
        // lanes the code would be too long to compile.
        whole_tiles_from_lanes: Some(8),
        // Registers are memory anyway.
        region_pixels: 16,
        broadcasts: false,
        shared_splats: false,
        // Each column has a chain of opacities.
        shared_tile_pixels: 8,
        tile_row_interleave: 16,
        // exp2 takes some twenty instructions.
        incremental_exp: true,
        // Registers are memory anyway, and a loop's branches take time.
        sh_loops: false,
        loss_workgroup: WorkgroupRule::Invocations(64),
        loss_strip: 4,
        reads_texels: true,
        strips_up_to_lanes: Some(16),
        runs_in_order: true,
        heap_is_bound: false,
        is_slow: true,
    };

    /// By the structure of the kernels and estimates of compilers; by times where an H100 or H200 is named (tools/experiments.md). No other
    /// GPU has been measured.
    pub const GPU: Self = Self {
        backend: Backend::Gpu,
        lanes: None,
        heavy_lanes: None,
        heavy_blending: false,
        sort_method: SortMethod::Matching,
        // Keys and their places are kept in registers, and a block of pairs in shared memory. On an H200 16 make
        // small steps slower by 2 %, and sorts of a million pairs and more faster by 5 to 8 % (tools/experiments.md).
        sort_items: 8,
        scan_items: 4,
        scan_workgroup: WorkgroupRule::Elementwise,
        // Rounds follow one another.
        scan_spine_workgroup: WorkgroupRule::Invocations(1024),
        scan_spine_items: 4,
        duplicate_items: 4,
        whole_tiles_from_lanes: None,
        // Four spill on Intel (tools/gpu_static.md), and small regions cull more.
        region_pixels: 2,
        // Up to a seventh fewer estimated cycles on Intel, the same code on AMD and NVK.
        broadcasts: true,
        shared_splats: false,
        shared_tile_pixels: 1,
        tile_row_interleave: 1,
        // exp2 is one instruction.
        incremental_exp: false,
        // Room for twice as many subgroups where parameters are read and written.
        sh_loops: true,
        loss_workgroup: WorkgroupRule::Invocations(256),
        // Wide enough to fill a workgroup.
        loss_strip: 2,
        reads_texels: false,
        strips_up_to_lanes: None,
        runs_in_order: false,
        heap_is_bound: true,
        is_slow: false,
    };

    /// Its registers hold 16 lanes of most kernels, 32 of few, and 8 of the heaviest (tools/gpu_static.md). Xe2 has twice the
    /// registers and no 8 lanes; at 32 it spills in three kernels, at 16 in none. Two pixels in a row of the loss spill on some.
    pub const INTEL: Self =
        Self { lanes: Some(16), heavy_lanes: Some(8), heavy_blending: true, loss_strip: 1, ..Self::GPU };

    /// 64 lanes, the driver's size, take fewer estimated cycles per Gaussian in most kernels of RDNA. In the heaviest they take 1.2
    /// to 1.9 times as many as 32, per pixel or Gaussian (tools/gpu_static.md). GCN has 64 only.
    pub const AMD: Self = Self { heavy_lanes: Some(32), heavy_blending: true, ..Self::GPU };

    /// Measured on an H100 and an H200 (tools/experiments.md).
    pub const NVIDIA: Self =
        Self { shared_splats: true, loss_workgroup: WorkgroupRule::Invocations(128), ..Self::GPU };

    /// The row of a device that is no processor, by the PCI id of its vendor.
    pub(crate) const fn of_vendor(vendor: u32) -> &'static Self {
        match vendor {
            0x1002 => &Self::AMD,
            0x8086 => &Self::INTEL,
            0x10DE => &Self::NVIDIA,
            _ => &Self::GPU,
        }
    }

    /// The size of subgroups, and that of the heaviest kernels, on a device with its own size, those that may be required (None:
    /// none may be), and so many subgroups of a workgroup at most.
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

    /// The row of a class of devices.
    pub const fn of(backend: Backend) -> &'static Self {
        match backend {
            Backend::Processor => &Self::PROCESSOR,
            Backend::Gpu => &Self::GPU,
        }
    }
}
