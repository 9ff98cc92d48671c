//! Required device properties and features, in one list: for choosing and opening a device of our own, and for checking a
//! host's device.

use super::binding_numbers::BUFFERS;
use ash::vk;
use std::ffi::CStr;
use std::fmt;

/// Defines [`Features`] by a table: field, Vulkan name, whether every device must have it, and the struct of Vulkan's core
/// that holds it, if it is not of an extension.
macro_rules! features {
    ($v12:ident, $v13:ident; $($(#[$doc:meta])* $field:ident: $name:literal, $required:literal $(, $core:ident)?;)*) => {
        /// Relevant device features, by their Vulkan names.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct Features {
            $($(#[$doc])* pub $field: bool,)*
        }

        impl Features {
            /// Features that every device must have; the optional ones are false.
            pub const REQUIRED: Self = Self { $($field: $required,)* };

            /// Reads the feature structs of a device, or of its creation. They contain no features of extensions, which become
            /// false.
            pub fn of(
                $v12: &vk::PhysicalDeviceVulkan12Features<'_>,
                $v13: &vk::PhysicalDeviceVulkan13Features<'_>,
            ) -> Self {
                Self { $($($field: $core.$field != 0,)?)* ..Self::default() }
            }

            /// Turns on these features in the structs for the creation of a device, and leaves the others unchanged.
            ///
            /// A host that chains structs of single features sets the fields of the same names in those. Features of extensions
            /// are always set that way.
            pub fn merge_into(
                &self,
                $v12: &mut vk::PhysicalDeviceVulkan12Features<'_>,
                $v13: &mut vk::PhysicalDeviceVulkan13Features<'_>,
            ) {
                $($($core.$field |= vk::Bool32::from(self.$field);)?)*
            }

            /// Returns names and values.
            pub fn all(&self) -> [(&'static str, bool); 8] {
                [$(($name, self.$field),)*]
            }
        }
    };
}

features! {
    v12, v13;
    /// scalarBlockLayout, Vulkan 1.2.
    scalar_block_layout: "scalarBlockLayout", true, v12;
    /// synchronization2, Vulkan 1.3.
    synchronization2: "synchronization2", true, v13;
    /// maintenance4, Vulkan 1.3: the workgroup sizes are specialization constants.
    maintenance4: "maintenance4", true, v13;
    /// subgroupSizeControl, Vulkan 1.3.
    subgroup_size_control: "subgroupSizeControl", true, v13;
    /// computeFullSubgroups, Vulkan 1.3.
    compute_full_subgroups: "computeFullSubgroups", true, v13;
    /// subgroupBroadcastDynamicId, Vulkan 1.2. Optional: kernels share values by broadcasts where that is faster.
    subgroup_broadcast_dynamic_id: "subgroupBroadcastDynamicId", false, v12;
    /// shaderMaximalReconvergence of VK_KHR_shader_maximal_reconvergence. Optional: a subgroup's invocations reconverge
    /// after a branch, as kernels assume.
    shader_maximal_reconvergence: "shaderMaximalReconvergence", false;
    /// shaderSubgroupUniformControlFlow of VK_KHR_shader_subgroup_uniform_control_flow. Optional: invocations reconverge if
    /// the whole subgroup was converged before. Used if shaderMaximalReconvergence is missing.
    shader_subgroup_uniform_control_flow: "shaderSubgroupUniformControlFlow", false;
}

impl Features {
    /// Returns all features of [`Features::REQUIRED`] that are not set.
    pub fn missing(&self) -> Vec<&'static str> {
        let required = Self::REQUIRED.all().into_iter().zip(self.all());
        let missing = required.filter(|((_, required), (_, has))| *required && !has);
        missing.map(|(_, (name, _))| name).collect()
    }
}

/// Subgroup operations that the kernels use.
pub(super) const SUBGROUP_OPERATIONS: [(vk::SubgroupFeatureFlags, &str); 6] = [
    (vk::SubgroupFeatureFlags::BASIC, "basic"),
    (vk::SubgroupFeatureFlags::VOTE, "vote"),
    (vk::SubgroupFeatureFlags::ARITHMETIC, "arithmetic"),
    (vk::SubgroupFeatureFlags::BALLOT, "ballot"),
    (vk::SubgroupFeatureFlags::SHUFFLE, "shuffle"),
    (vk::SubgroupFeatureFlags::SHUFFLE_RELATIVE, "shuffle relative"),
];

/// Smallest allowed values of limits.
pub(super) const MIN_LIMITS: [(&str, u64); 4] = [
    ("maxComputeWorkGroupInvocations", 128),
    ("maxComputeSharedMemorySize", Requirements::MIN_SHARED_MEMORY as u64),
    ("maxPushConstantsSize", 128),
    ("maxPerStageDescriptorStorageBuffers", BUFFERS as u64),
];

/// Largest subgroup size for which the smallest allowed workgroup suffices.
const FEW_LANES: u32 = 32;

/// Returns all of [`MIN_LIMITS`] that a device with subgroups of this size does not meet.
pub(super) fn low_limits(l: &vk::PhysicalDeviceLimits, subgroup_size: u32) -> impl Iterator<Item = String> {
    let invocations = u64::from(Requirements::workgroup_invocations(subgroup_size));
    let mut required = MIN_LIMITS;
    required[0].1 = invocations.max(required[0].1);
    let has = [
        l.max_compute_work_group_invocations,
        l.max_compute_shared_memory_size,
        l.max_push_constants_size,
        l.max_per_stage_descriptor_storage_buffers,
    ];
    let low = required.into_iter().zip(has).filter(|((_, min), has)| u64::from(*has) < *min);
    low.map(|((name, min), has)| format!("{name} of {min} (it has {has})"))
}

/// A feature or an extension that is used if it is enabled. A feature of an extension also needs the extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Optional<N> {
    /// Vulkan name.
    pub name: N,
    /// Substitute if it is not enabled.
    pub without: &'static str,
}

const OPTIONAL_FEATURES: [Optional<&str>; 3] = [
    Optional { name: "subgroupBroadcastDynamicId", without: "shuffles in place of broadcasts" },
    Optional { name: "shaderMaximalReconvergence", without: "shaderSubgroupUniformControlFlow" },
    Optional {
        name: "shaderSubgroupUniformControlFlow",
        without: "the driver is trusted to bring subgroups together again after a branch",
    },
];

/// Required and optional properties of a host's device. `Display` formats a readable list.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Requirements {
    /// Version of instance and device, for example `vk::API_VERSION_1_3`.
    pub api_version: u32,
    /// Capabilities of the queue to which frames are submitted.
    pub queue: vk::QueueFlags,
    /// Features to enable: see [`Features::merge_into`].
    pub features: Features,
    /// Required device extensions: none at present.
    pub extensions: Vec<&'static CStr>,
    /// Optional features, by their names in [`Features::all`].
    pub optional_features: Vec<Optional<&'static str>>,
    /// Optional device extensions.
    pub optional_extensions: Vec<Optional<&'static CStr>>,
    /// Optional instance extensions.
    pub optional_instance_extensions: Vec<Optional<&'static CStr>>,
    /// Smallest allowed values of limits, by their Vulkan names.
    pub limits: Vec<(&'static str, u64)>,
}

impl Requirements {
    /// Smallest allowed maxComputeSharedMemorySize, bytes.
    pub const MIN_SHARED_MEMORY: u32 = 16_384;

    /// Returns the maxComputeWorkGroupInvocations that kernels with subgroups of this size need. Several subgroups share a
    /// workgroup, at least two if they are large.
    pub fn workgroup_invocations(subgroup_size: u32) -> u32 {
        if subgroup_size > FEW_LANES { 256 } else { 128 }
    }

    pub(super) fn of_all() -> Self {
        let optional = |name, without| Optional { name, without };
        let uniform = ash::khr::shader_subgroup_uniform_control_flow::NAME;
        Self {
            api_version: vk::API_VERSION_1_3,
            queue: vk::QueueFlags::COMPUTE,
            features: Features::REQUIRED,
            extensions: Vec::new(),
            optional_features: OPTIONAL_FEATURES.to_vec(),
            optional_extensions: vec![
                optional(ash::khr::push_descriptor::NAME, "descriptor sets from pools, allocated ahead"),
                optional(ash::khr::shader_maximal_reconvergence::NAME, "no shaderMaximalReconvergence"),
                optional(uniform, "no shaderSubgroupUniformControlFlow"),
            ],
            optional_instance_extensions: vec![optional(
                ash::ext::debug_utils::NAME,
                "no names and labels in debuggers",
            )],
            limits: MIN_LIMITS.to_vec(),
        }
    }
}

impl fmt::Display for Requirements {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (major, minor) =
            (vk::api_version_major(self.api_version), vk::api_version_minor(self.api_version));
        let extensions: Vec<_> = self.extensions.iter().map(|name| name.to_string_lossy()).collect();
        let extensions = if extensions.is_empty() { "none".into() } else { extensions.join(", ") };
        let operations: Vec<_> = SUBGROUP_OPERATIONS.iter().map(|(_, name)| *name).collect();
        let mut rows = vec![
            ("Vulkan", format!("{major}.{minor}, instance and device")),
            ("queue", "compute (graphics is not needed)".to_owned()),
            ("device extensions", extensions),
        ];
        let required = self.features.all().into_iter().filter(|(_, required)| *required);
        rows.extend(required.map(|(name, _)| ("features", name.to_owned())));
        rows.push(("subgroup operations", format!("{} (compute)", operations.join(", "))));
        rows.extend(self.limits.iter().map(|(name, min)| ("limits", format!("{name} >= {min}"))));
        let (name, max) = (MIN_LIMITS[0].0, Self::workgroup_invocations(FEW_LANES + 1));
        let large = format!("{name} >= {max} with subgroups of more than {FEW_LANES}");
        rows.push(("limits", large));
        let without = |name: &str, without: &str| ("optional", format!("{name} (without: {without})"));
        rows.extend(self.optional_features.iter().map(|feature| without(feature.name, feature.without)));
        let counts = "a host that records single stages sees to their counts";
        rows.push(without("robustBufferAccess", counts));
        let extensions = self.optional_extensions.iter().chain(&self.optional_instance_extensions);
        rows.extend(
            extensions.map(|extension| without(&extension.name.to_string_lossy(), extension.without)),
        );
        let mut before = "";
        for (head, text) in rows {
            writeln!(f, "{:20} {text}", if head == before { "" } else { head })?;
            before = head;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_missing_features_are_named() {
        assert!(Features::REQUIRED.missing().is_empty());
        let lacking = Features { maintenance4: false, subgroup_size_control: false, ..Features::REQUIRED };
        assert_eq!(lacking.missing(), ["maintenance4", "subgroupSizeControl"]);
        let required = Features::REQUIRED.all().into_iter().filter(|(_, required)| *required).count();
        assert_eq!(Features::default().missing().len(), required);
        let names =
            Features::REQUIRED.all().into_iter().filter(|(_, required)| !required).map(|(name, _)| name);
        assert!(names.eq(OPTIONAL_FEATURES.iter().map(|feature| feature.name)));
        let low = vk::PhysicalDeviceLimits { max_compute_work_group_invocations: 128, ..Default::default() };
        assert_eq!(low_limits(&low, 32).count(), MIN_LIMITS.len() - 1);
        let limits: Vec<_> = low_limits(&low, 64).filter(|limits| limits.contains("Invocations")).collect();
        assert_eq!(limits, ["maxComputeWorkGroupInvocations of 256 (it has 128)"]);
    }
}
