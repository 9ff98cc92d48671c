//! Limits of a device, read once, and faults of its driver.

use super::format::TexelFormat;
use crate::frame::tuning::Tuning;
use ash::vk;

/// Limits of a device, and the subgroup sizes of the kernels.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Limits {
    /// Invocations of a subgroup in every kernel with a `subgroup_size` constant, except for the heaviest.
    pub subgroup_size: u32,
    /// Same as [`Self::subgroup_size`], but for the kernels with the most registers ([`Tuning::heavy_lanes`]).
    pub heavy_subgroup_size: u32,
    /// subgroupSize: the driver's choice when a pipeline requires none.
    pub own_subgroup_size: u32,
    /// Smallest subgroup size that a pipeline may require.
    pub min_subgroup_size: u32,
    /// Largest subgroup size that a pipeline may require.
    pub max_subgroup_size: u32,
    /// True if pipelines may require a subgroup size; otherwise all have `subgroup_size`.
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
    /// maxStorageBufferRange, also the most bytes of a single buffer.
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
    /// Nanoseconds per timestamp tick; 0 if the queue has no timestamps.
    pub timestamp_period_ns: f64,
    /// Kernels, sizes and layouts for the device.
    pub tuning: &'static Tuning,
    /// True if kernels broadcast from a lane that is known only at run time. The tuning must choose it and
    /// subgroupBroadcastDynamicId must be on; a host reports its device's.
    pub broadcasts: bool,
    /// Most loop iterations of an invocation, all loops together, before its loops stop silently. None: no limit.
    pub max_loop_iterations: Option<u32>,
    /// (tile, Gaussian) instances per dispatch of blending; it may exceed this to complete its last tile. This limit is
    /// ours: it prevents a desktop's watchdog from resetting the device during a long dispatch.
    pub instances_per_dispatch: u32,
    /// Overrides of specialization constants, from the context's options.
    pub overrides: Vec<SpecOverride>,
}

/// An override of a specialization constant, to measure its effect on a kernel's speed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpecOverride {
    /// A kernel, "backward/project_backward", or a folder of kernels, "sort"; empty: all.
    pub kernel: String,
    /// The constant's name in GLSL.
    pub constant: String,
    /// The value's 32 bits.
    pub bits: u32,
}

/// True if a kernel has this name, "sort/sort_spine", or is in the folder with this name, "sort".
pub fn is_kernel_of(kernel: &str, named: &str) -> bool {
    kernel.strip_prefix(named).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// True for the kernels, or their folder, that measure the device's arithmetic rate. Overrides do not apply to them,
/// because their operations are counted with their own constants.
pub fn is_yardstick(kernel: &str) -> bool {
    is_kernel_of(kernel, "arithmetic")
}

/// Constants with which the host counts workgroups and chooses kernels. It sets them itself, from [`Limits::overridden`],
/// so that shader and host cannot differ.
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
    /// Returns the limits with this row of the table, and the row's subgroup sizes if the device lets them be required.
    pub(super) fn tuned(mut self, tuning: &'static Tuning) -> Self {
        let sizes = self.min_subgroup_size..=self.max_subgroup_size;
        let sizes = self.subgroup_size_selectable.then_some(sizes);
        [self.subgroup_size, self.heavy_subgroup_size] =
            tuning.subgroup_sizes(self.own_subgroup_size, sizes, self.max_workgroup_subgroups);
        self.tuning = tuning;
        self
    }

    /// Names what the bits of results depend on, the backend and the subgroup sizes, as in "gpu, subgroups of 16, of 8 in the
    /// heaviest".
    pub fn kernel_forms(&self) -> String {
        let Self { subgroup_size, heavy_subgroup_size, .. } = self;
        let heaviest = match heavy_subgroup_size == subgroup_size {
            true => String::new(),
            false => format!(", of {heavy_subgroup_size} in the heaviest"),
        };
        format!("{}, subgroups of {subgroup_size}{heaviest}", self.tuning.backend)
    }

    /// Returns the largest workgroup size up to `preferred` on this device: a multiple of the subgroup size, within the
    /// limits of invocations and subgroups, and at least one subgroup.
    pub fn workgroup_size(&self, preferred: u32) -> u32 {
        let max = preferred
            .min(self.max_workgroup_invocations)
            .min(self.max_workgroup_size[0])
            .min(self.max_workgroup_subgroups.saturating_mul(self.subgroup_size));
        (max / self.subgroup_size * self.subgroup_size).max(self.subgroup_size)
    }

    /// True if kernels with both forms read texels (see [`super::TexelFormat`]). The tuning must choose it, and every
    /// bindable buffer must have few enough texels.
    pub fn prefers_texels(&self) -> bool {
        self.tuning.reads_texels
            && self.max_storage_buffer_range / TexelFormat::R32Uint.bytes() <= self.max_texels
    }

    /// Returns the value in [`Limits::overrides`] for a constant of a kernel or of a folder of kernels; the last match
    /// counts. The measurement of the arithmetic rate, [`crate::passes::arithmetic`], has no overrides.
    pub fn overridden(&self, kernel: &str, constant: &str) -> Option<u32> {
        if is_yardstick(kernel) {
            return None;
        }
        let is_of = |named: &str| named.is_empty() || is_kernel_of(kernel, named);
        let meant = |o: &&SpecOverride| o.constant == constant && is_of(&o.kernel);
        self.overrides.iter().rev().find(meant).map(|o| o.bits)
    }

    /// Converts a count of workgroups to a grid: one row if it fits, otherwise rows of the largest width, the last one
    /// partly unused. Kernels number workgroups as `gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x` and ignore
    /// those past the end.
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

/// Defines [`LimitsOverride`] and [`Limits::lowered`] for these limits.
#[cfg(feature = "testing")]
macro_rules! overrides {
    ($($limit:ident: $type:ty,)*) => {
        /// For tests: stricter limits than the device's; `None` keeps the device's.
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct LimitsOverride {
            $(
                #[doc = concat!("For [`Limits::", stringify!($limit), "`].")]
                pub $limit: Option<$type>,
            )*
            /// For [`Limits::subgroup_size`]: emulates a device with this size that does not let it be required.
            pub fixed_subgroup_size: Option<u32>,
        }

        impl Limits {
            /// Lowers each limit to the override's value. An override never raises a limit, except the fixed subgroup size.
            pub fn lowered(mut self, to: &LimitsOverride) -> Self {
                $(self.$limit = to.$limit.map_or(self.$limit, |lower| lower.min(self.$limit));)*
                if let Some(size) = to.fixed_subgroup_size {
                    [self.subgroup_size, self.heavy_subgroup_size, self.own_subgroup_size] = [size; 3];
                    self.subgroup_size_selectable = false;
                }
                self
            }
        }
    };
}

#[cfg(feature = "testing")]
overrides! {
    max_storage_buffer_range: u64,
    max_allocation_bytes: u64,
    max_workgroups_per_axis: u32,
    max_workgroup_invocations: u32,
    shared_memory_bytes: u32,
    push_constant_bytes: u32,
    max_workgroup_subgroups: u32,
    max_push_descriptors: u32,
    max_texels: u64,
    instances_per_dispatch: u32,
}

/// Returns [`Limits::max_loop_iterations`] by the driver's id and its `driverInfo`, such as `Mesa 22.3.6`. (llvmpipe's
/// `driverVersion` is 1 in all versions.) llvmpipe of Mesa before 25 has a limit, against the specification:
/// LP_MAX_TGSI_LOOP_ITERATIONS in gallivm's lp_bld_limits.h. Blending then processes fewer entries of a tile per dispatch.
pub(super) fn max_loop_iterations(id: vk::DriverId, info: &str) -> Option<u32> {
    let version = info.strip_prefix("Mesa ").and_then(|rest| rest.split('.').next()?.parse::<u32>().ok());
    (id == vk::DriverId::MESA_LLVMPIPE && version.is_none_or(|major| major < 25)).then_some(65_535)
}

#[cfg(test)]
mod tests {
    use super::max_loop_iterations;
    use ash::vk;

    #[test]
    fn loops_are_limited_by_the_driver() {
        for (id, info, limit) in [
            (vk::DriverId::MESA_LLVMPIPE, "Mesa 22.3.6 (LLVM 15.0.6)", Some(65_535)),
            (vk::DriverId::MESA_LLVMPIPE, "Mesa 24.99.0", Some(65_535)),
            (vk::DriverId::MESA_LLVMPIPE, "unknown", Some(65_535)),
            (vk::DriverId::MESA_LLVMPIPE, "Mesa 25.0.7-2+deb13u1 (LLVM 19.1.7)", None),
            (vk::DriverId::MESA_RADV, "Mesa 22.3.6", None),
        ] {
            assert_eq!(max_loop_iterations(id, info), limit, "{info}");
        }
    }
}
