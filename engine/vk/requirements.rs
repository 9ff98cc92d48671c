//! Required device properties and features as values: the one list for choosing and opening a device of our
//! own, and for checking a host's device.

use super::binding_numbers::BUFFERS;
use ash::vk;
use std::ffi::CStr;
use std::fmt;

/// The relevant device features, by their Vulkan names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Features {
    /// scalarBlockLayout, Vulkan 1.2.
    pub scalar_block_layout: bool,
    /// synchronization2, Vulkan 1.3.
    pub synchronization2: bool,
    /// maintenance4, Vulkan 1.3: the workgroup sizes are specialization constants.
    pub maintenance4: bool,
    /// subgroupSizeControl, Vulkan 1.3.
    pub subgroup_size_control: bool,
    /// computeFullSubgroups, Vulkan 1.3.
    pub compute_full_subgroups: bool,
}

impl Features {
    /// Features that every device must have.
    pub const REQUIRED: Self = Self {
        scalar_block_layout: true,
        synchronization2: true,
        maintenance4: true,
        subgroup_size_control: true,
        compute_full_subgroups: true,
    };

    /// Reads the features' structs of a device (or of its creation).
    pub fn of(
        v12: &vk::PhysicalDeviceVulkan12Features<'_>,
        v13: &vk::PhysicalDeviceVulkan13Features<'_>,
    ) -> Self {
        Self {
            scalar_block_layout: v12.scalar_block_layout != 0,
            synchronization2: v13.synchronization2 != 0,
            maintenance4: v13.maintenance4 != 0,
            subgroup_size_control: v13.subgroup_size_control != 0,
            compute_full_subgroups: v13.compute_full_subgroups != 0,
        }
    }

    /// Turns on these features in the structs for the creation of a device, and does not change the others.
    ///
    /// A host that chains the structs of single features instead sets the fields of the same names there.
    pub fn merge_into(
        &self,
        v12: &mut vk::PhysicalDeviceVulkan12Features<'_>,
        v13: &mut vk::PhysicalDeviceVulkan13Features<'_>,
    ) {
        let add = |to: &mut vk::Bool32, wanted: bool| *to |= vk::Bool32::from(wanted);
        add(&mut v12.scalar_block_layout, self.scalar_block_layout);
        add(&mut v13.synchronization2, self.synchronization2);
        add(&mut v13.maintenance4, self.maintenance4);
        add(&mut v13.subgroup_size_control, self.subgroup_size_control);
        add(&mut v13.compute_full_subgroups, self.compute_full_subgroups);
    }

    /// Names and values.
    pub fn all(&self) -> [(&'static str, bool); 5] {
        [
            ("scalarBlockLayout", self.scalar_block_layout),
            ("synchronization2", self.synchronization2),
            ("maintenance4", self.maintenance4),
            ("subgroupSizeControl", self.subgroup_size_control),
            ("computeFullSubgroups", self.compute_full_subgroups),
        ]
    }

    /// All features of [`Features::REQUIRED`] that are not set.
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

/// Least values of limits.
pub(super) const LEAST_LIMITS: [(&str, u64); 4] = [
    ("maxComputeWorkGroupInvocations", 128),
    ("maxComputeSharedMemorySize", 16_384),
    ("maxPushConstantsSize", 128),
    ("maxPerStageDescriptorStorageBuffers", BUFFERS as u64),
];

/// The largest subgroups that need no more than the least workgroup.
const FEW_LANES: u32 = 32;

/// All of [`LEAST_LIMITS`] that a device with subgroups of this size does not reach.
pub(super) fn low_limits(l: &vk::PhysicalDeviceLimits, subgroup_size: u32) -> impl Iterator<Item = String> {
    let invocations = u64::from(Requirements::workgroup_invocations(subgroup_size));
    let least = LEAST_LIMITS.map(|(name, least)| match name == LEAST_LIMITS[0].0 {
        true => (name, least.max(invocations)),
        false => (name, least),
    });
    let has = [
        l.max_compute_work_group_invocations,
        l.max_compute_shared_memory_size,
        l.max_push_constants_size,
        l.max_per_stage_descriptor_storage_buffers,
    ];
    let low = least.into_iter().zip(has).filter(|((_, least), has)| u64::from(*has) < *least);
    low.map(|((name, least), has)| format!("{name} of {least} (it has {has})"))
}

/// An extension that is used if it is enabled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OptionalExtension {
    /// Its name.
    pub name: &'static CStr,
    /// The substitute without it.
    pub without: &'static str,
}

/// Required and optional properties of a host's device. The `Display` is a readable list.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Requirements {
    /// Version of instance and device, as in `vk::API_VERSION_1_3`.
    pub api_version: u32,
    /// The queue that frames are submitted to.
    pub queue: vk::QueueFlags,
    /// Features to enable: see [`Features::merge_into`].
    pub features: Features,
    /// Required device extensions: none at present.
    pub extensions: Vec<&'static CStr>,
    /// Device extensions that are used if enabled.
    pub optional_extensions: Vec<OptionalExtension>,
    /// Instance extensions that are used if enabled.
    pub optional_instance_extensions: Vec<OptionalExtension>,
    /// Subgroup operations in compute shaders.
    pub subgroup_operations: vk::SubgroupFeatureFlags,
    /// Least values of limits, by their Vulkan names.
    pub limits: Vec<(&'static str, u64)>,
}

impl Requirements {
    /// The maxComputeWorkGroupInvocations that kernels with subgroups of this size need: several subgroups share a workgroup,
    /// two of them at least where they are large.
    pub fn workgroup_invocations(subgroup_size: u32) -> u32 {
        if subgroup_size > FEW_LANES { 256 } else { 128 }
    }

    /// Of every device.
    pub(super) fn of_all() -> Self {
        let operations = SUBGROUP_OPERATIONS.iter().map(|(flag, _)| *flag);
        Self {
            api_version: vk::API_VERSION_1_3,
            queue: vk::QueueFlags::COMPUTE,
            features: Features::REQUIRED,
            extensions: Vec::new(),
            optional_extensions: vec![OptionalExtension {
                name: ash::khr::push_descriptor::NAME,
                without: "descriptor sets from pools, allocated ahead",
            }],
            optional_instance_extensions: vec![OptionalExtension {
                name: ash::ext::debug_utils::NAME,
                without: "no names and labels in debuggers",
            }],
            subgroup_operations: operations.fold(vk::SubgroupFeatureFlags::empty(), |all, flag| all | flag),
            limits: LEAST_LIMITS.to_vec(),
        }
    }
}

impl fmt::Display for Requirements {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let version = self.api_version;
        let (major, minor) = (vk::api_version_major(version), vk::api_version_minor(version));
        writeln!(f, "Vulkan               {major}.{minor}, instance and device")?;
        writeln!(f, "queue                compute (graphics is not needed)")?;
        let extensions: Vec<_> = self.extensions.iter().map(|name| name.to_string_lossy()).collect();
        let extensions = if extensions.is_empty() { "none".into() } else { extensions.join(", ") };
        writeln!(f, "device extensions    {extensions}")?;
        let mut head = "features";
        for (name, required) in self.features.all() {
            if required {
                writeln!(f, "{head:20} {name}")?;
                head = "";
            }
        }
        let names: Vec<_> = SUBGROUP_OPERATIONS.iter().map(|(_, name)| *name).collect();
        writeln!(f, "subgroup operations  {} (compute)", names.join(", "))?;
        let mut head = "limits";
        for (name, least) in &self.limits {
            writeln!(f, "{head:20} {name} >= {least}")?;
            head = "";
        }
        let (lanes, most) = (FEW_LANES, Self::workgroup_invocations(FEW_LANES + 1));
        writeln!(f, "{head:20} {} >= {most} with subgroups of more than {lanes}", LEAST_LIMITS[0].0)?;
        let mut head = "optional";
        for optional in self.optional_extensions.iter().chain(&self.optional_instance_extensions) {
            writeln!(f, "{head:20} {} (without: {})", optional.name.to_string_lossy(), optional.without)?;
            head = "";
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
        assert_eq!(Features::default().missing().len(), Features::REQUIRED.all().len());
        let low = vk::PhysicalDeviceLimits { max_compute_work_group_invocations: 128, ..Default::default() };
        assert_eq!(low_limits(&low, 32).count(), LEAST_LIMITS.len() - 1);
        let said: Vec<_> = low_limits(&low, 64).filter(|said| said.contains("Invocations")).collect();
        assert_eq!(said, ["maxComputeWorkGroupInvocations of 256 (it has 128)"]);
    }

    #[test]
    fn features_are_added_to_a_hosts_own() {
        let mut v12 = vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true);
        let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
        Features::REQUIRED.merge_into(&mut v12, &mut v13);
        assert_eq!(Features::of(&v12, &v13), Features::REQUIRED);
        assert_eq!(v12.timeline_semaphore, vk::TRUE);
    }
}
