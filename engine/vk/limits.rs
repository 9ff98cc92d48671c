//! The limits of a device, read once.

use super::texels::TexelFormat;
use super::workarounds::Workarounds;
use crate::tuning::Tuning;

/// Limits of a device, and the subgroup sizes of the kernels.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Limits {
    /// Invocations of a subgroup in every kernel with a `subgroup_size` constant, but for the heaviest.
    pub subgroup_size: u32,
    /// The same in the kernels with the most registers ([`Tuning::heavy_lanes`]).
    pub heavy_subgroup_size: u32,
    /// subgroupSize: what the driver chooses where nothing is required.
    pub own_subgroup_size: u32,
    /// Smallest subgroup size that may be chosen.
    pub min_subgroup_size: u32,
    /// Largest subgroup size that may be chosen.
    pub max_subgroup_size: u32,
    /// Whether a pipeline's subgroup size may be required; otherwise it is `subgroup_size` in all of them.
    pub subgroup_size_selectable: bool,
    /// maxComputeWorkGroupInvocations.
    pub max_workgroup_invocations: u32,
    /// maxComputeWorkGroupSize, for each axis.
    pub max_workgroup_size: [u32; 3],
    /// maxComputeWorkgroupSubgroups.
    pub max_workgroup_subgroups: u32,
    /// The smallest of maxComputeWorkGroupCount.
    pub max_workgroups_per_axis: u32,
    /// maxComputeSharedMemorySize.
    pub shared_memory_bytes: u32,
    /// maxStorageBufferRange: a single buffer never has more bytes.
    pub max_storage_buffer_range: u64,
    /// The smaller of maxMemoryAllocationSize and maxBufferSize.
    pub max_allocation_bytes: u64,
    /// Size of the largest device-local heap.
    pub heap_bytes: u64,
    /// maxTexelBufferElements; 0 if the kernels that read texels cannot run.
    pub max_texels: u64,
    /// The larger of minTexelBufferOffsetAlignment and the size of the largest texel.
    pub texel_alignment: u64,
    /// minStorageBufferOffsetAlignment.
    pub storage_alignment: u64,
    /// maxImageDimension2D.
    pub max_image_side: u32,
    /// maxUniformBufferRange.
    pub max_uniform_range: u32,
    /// minUniformBufferOffsetAlignment.
    pub uniform_alignment: u64,
    /// maxPushConstantsSize.
    pub push_constant_bytes: u32,
    /// maxPushDescriptors; without VK_KHR_push_descriptor, the descriptors of one of our sets.
    pub max_push_descriptors: u32,
    /// Nanoseconds of a timestamp tick; 0 where the queue has no timestamps.
    pub timestamp_period_ns: f64,
    /// Which kernels, sizes and layouts the device gets.
    pub tuning: &'static Tuning,
    /// Whether kernels hand values over by broadcasts from a lane that is known at run time only: where the tuning says so and
    /// subgroupBroadcastDynamicId is on, as hosts say of theirs.
    pub broadcasts: bool,
    /// What its driver does against the specification.
    pub workarounds: Workarounds,
    /// (tile, Gaussian) instances per dispatch of blending, not counting the rest of its last tile. A limit
    /// of ours, so that no desktop's watchdog resets the device during a long dispatch.
    pub instances_per_dispatch: u32,
    /// Overrides of specialization constants, from the context's options.
    pub overrides: Vec<SpecOverride>,
}

/// An override of a specialization constant, to measure its effect on a kernel's speed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpecOverride {
    /// The kernel, "backward/project_backward", or a folder of kernels, "sort"; empty: all.
    pub kernel: String,
    /// The constant's name in GLSL.
    pub constant: String,
    /// Its value's 32 bits.
    pub bits: u32,
}

/// Whether a kernel has this name, "sort/sort_spine", or lies in the folder with this name, "sort".
pub fn is_kernel_of(kernel: &str, named: &str) -> bool {
    kernel.strip_prefix(named).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// Whether this is the kernel, or its folder, that measures the device's arithmetic rate. Overrides do not
/// apply to it, because its operations are counted with its own constants.
pub fn is_yardstick(kernel: &str) -> bool {
    is_kernel_of(kernel, "arithmetic")
}

/// Constants that the host uses to count workgroups and to choose kernels. It sets them itself (from
/// [`Limits::overridden`]), so that shader and host cannot differ.
pub(super) const CHOSEN_BY_HOST: [&str; 13] = [
    "WORKGROUP_SIZE",
    "SUBGROUP_SIZE",
    "ITEMS",
    "STRIP",
    "STRIPS",
    "REGIONS_PER_SUBGROUP",
    "REGION_HEIGHT",
    "BLOCK",
    "FOR_BACKWARD",
    "SIZE",
    "STRIDE",
    "ROWS",
    "WHOLE_ROWS",
];

impl Limits {
    /// With this row of the table, and the subgroup size that it asks for where the device lets it be required.
    pub(super) fn tuned(mut self, tuning: &'static Tuning) -> Self {
        let sizes = self.min_subgroup_size..=self.max_subgroup_size;
        let sizes = self.subgroup_size_selectable.then_some(sizes);
        [self.subgroup_size, self.heavy_subgroup_size] =
            tuning.subgroup_sizes(self.own_subgroup_size, sizes, self.max_workgroup_subgroups);
        self.tuning = tuning;
        self
    }

    /// Which forms of the kernels run: their backend and the sizes of subgroups, "gpu, subgroups of 16, of 8 in the heaviest".
    /// With other ones the bits of a result differ.
    pub fn kernel_forms(&self) -> String {
        let Self { subgroup_size, heavy_subgroup_size, .. } = self;
        let heaviest = match heavy_subgroup_size == subgroup_size {
            true => String::new(),
            false => format!(", of {heavy_subgroup_size} in the heaviest"),
        };
        format!("{}, subgroups of {subgroup_size}{heaviest}", self.tuning.backend)
    }

    /// The largest workgroup size up to `preferred` on this device: a multiple of the subgroup size, within
    /// the limits of invocations and subgroups, and at least one subgroup.
    pub fn workgroup_size(&self, preferred: u32) -> u32 {
        let most = preferred
            .min(self.max_workgroup_invocations)
            .min(self.max_workgroup_size[0])
            .min(self.max_workgroup_subgroups.saturating_mul(self.subgroup_size));
        (most / self.subgroup_size * self.subgroup_size).max(self.subgroup_size)
    }

    /// Most loop iterations of one invocation, all loops together, before the loops stop silently; None: no limit.
    pub fn max_loop_iterations(&self) -> Option<u32> {
        self.workarounds.contains(Workarounds::LOOPS_STOP_AT_65535).then_some(65_535)
    }

    /// Whether kernels that exist in both forms read texels (see [`super::TexelFormat`]): where the tuning says so and no
    /// buffer that can be bound has more texels than may be read.
    pub fn prefers_texels(&self) -> bool {
        self.tuning.reads_texels
            && self.max_storage_buffer_range / TexelFormat::R32Uint.bytes() <= self.max_texels
    }

    /// The value in [`Limits::overrides`] for a constant of a kernel or of a folder of kernels; the last one
    /// counts. The measurement of the arithmetic rate, [`crate::arithmetic`], has no overrides.
    pub fn overridden(&self, kernel: &str, constant: &str) -> Option<u32> {
        let meant = |o: &&SpecOverride| {
            o.constant == constant && (o.kernel.is_empty() || is_kernel_of(kernel, &o.kernel))
        };
        if is_yardstick(kernel) {
            return None;
        }
        self.overrides.iter().rev().find(meant).map(|o| o.bits)
    }

    /// Turns a count of workgroups into a grid: one row if it fits, otherwise rows of the largest width, the
    /// last one partly unused. Kernels number workgroups as `gl_WorkGroupID.y * gl_NumWorkGroups.x +
    /// gl_WorkGroupID.x` and ignore those past the end.
    ///
    /// # Panics
    /// If the count exceeds the square of [`Limits::max_workgroups_per_axis`].
    pub fn grid(&self, workgroups: u64) -> [u32; 3] {
        let limit = u64::from(self.max_workgroups_per_axis);
        let (x, y) = if workgroups <= limit { (workgroups, 1) } else { (limit, workgroups.div_ceil(limit)) };
        assert!(y <= limit, "{workgroups} workgroups exceed {limit} x {limit}");
        [x as u32, y as u32, 1]
    }
}
