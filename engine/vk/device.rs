//! Enumerates the devices, checks them, and selects one.

use super::clock::Calibrated;
use super::debug::vk_error;
use super::instance::Instance;
use super::limits::Limits;
use super::queues::{ComputeFamilies, compute_families};
use super::requirements::{Features, SUBGROUP_OPERATIONS, low_limits};
use super::workarounds::Workarounds;
use crate::tuning::{Backend, Tuning};
use crate::{Error, Result};
use ash::vk;
use std::ffi::CStr;

/// See [`Limits::instances_per_dispatch`]: 256 pixels per instance, tens of milliseconds on a GPU.
const INSTANCES_PER_DISPATCH: u32 = 1 << 25;

/// Description of a device by [`devices`].
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct DeviceDescription {
    /// Index, for `--device` and `ASHSPLAT_DEVICE`.
    pub index: usize,
    /// The driver's name of the device.
    pub name: String,
    /// "discrete GPU", "integrated GPU", "virtual GPU", "CPU" or "other".
    pub kind: &'static str,
    /// Name and version of the driver.
    pub driver: String,
    /// The Vulkan version that it implements.
    pub api_version: String,
    /// Its limits; None if the device is too old to be queried.
    pub limits: Option<Limits>,
    /// Reason why it cannot be used; None if it can.
    pub problem: Option<String>,
}

/// Lists all devices of this machine, usable or not.
///
/// # Errors
/// [`Error::NoLoader`] or [`Error::NoDevice`] without a loader or a driver.
pub fn devices() -> Result<Vec<DeviceDescription>> {
    let instance = Instance::new(false, false, &[])?;
    Ok(candidates(&instance.raw, vk::API_VERSION_1_3)?.into_iter().map(|c| c.description).collect())
}

/// A device, with the data to open it.
pub(super) struct Candidate {
    pub(super) physical: vk::PhysicalDevice,
    pub(super) description: DeviceDescription,
    pub(super) device_type: vk::PhysicalDeviceType,
    pub(super) queue_family: u32,
    /// Queue family of a device that also presents to a screen.
    pub(super) presenting_family: u32,
    /// Queue family for copies only, on a device of our own.
    pub(super) copying_family: Option<u32>,
    pub(super) features: OptionalFeatures,
    pub(super) missing: Option<String>,
}

impl Candidate {
    /// Returns all that the device lacks and a host has not enabled; None if nothing is missing.
    pub(super) fn lacks(&self, enabled: &Features) -> Option<String> {
        let own = self.missing.as_deref();
        let is_there =
            |name: &&str| own.is_none_or(|missing| missing.split(", ").all(|other| other != *name));
        let not_enabled: Vec<&str> = enabled.missing().into_iter().filter(is_there).collect();
        let host = format!("{} (the device has it, the host has not enabled it)", not_enabled.join(", "));
        let host = (!not_enabled.is_empty()).then_some(host);
        let all: Vec<&str> = own.into_iter().chain(host.as_deref()).collect();
        (!all.is_empty()).then(|| all.join(", "))
    }

    /// True if device memory is host memory, so that mapping is the fastest way to transfer data.
    pub(super) fn has_unified_memory(&self) -> bool {
        matches!(self.device_type, vk::PhysicalDeviceType::CPU | vk::PhysicalDeviceType::INTEGRATED_GPU)
    }
}

/// Features that are turned on if the device has them.
#[derive(Clone, Copy, Default)]
pub(super) struct OptionalFeatures {
    pub(super) int8: bool,
    pub(super) int64: bool,
    pub(super) storage8: bool,
    pub(super) uniform_storage8: bool,
    pub(super) memory_model: bool,
    pub(super) memory_model_device_scope: bool,
    pub(super) push_descriptor: bool,
    pub(super) portability_subset: bool,
    pub(super) calibrated_timestamps: Option<Calibrated>,
    pub(super) memory_budget: bool,
    /// subgroupBroadcastDynamicId.
    pub(super) dynamic_broadcasts: bool,
    /// VK_KHR_shader_maximal_reconvergence.
    pub(super) reconverges: bool,
    /// VK_KHR_shader_subgroup_uniform_control_flow.
    pub(super) uniform_control_flow: bool,
    /// robustBufferAccess2 of VK_EXT_robustness2.
    pub(super) robust_buffers2: bool,
    /// fragmentStoresAndAtomics and vertexPipelineStoresAndAtomics, which the layer's debugPrintf requires.
    pub(super) graphics_stores: bool,
}

impl OptionalFeatures {
    /// Turns off the subgroup features that a host has not enabled.
    pub(super) fn keep_enabled(&mut self, told: &Features, extensions: &[&CStr]) {
        let enabled = |name: &CStr| extensions.contains(&name);
        self.dynamic_broadcasts &= told.subgroup_broadcast_dynamic_id;
        self.reconverges &=
            told.shader_maximal_reconvergence && enabled(ash::khr::shader_maximal_reconvergence::NAME);
        self.uniform_control_flow &= told.shader_subgroup_uniform_control_flow
            && enabled(ash::khr::shader_subgroup_uniform_control_flow::NAME)
            && !self.reconverges;
    }
}

/// Returns all devices, in the loader's order. Those with an older Vulkan are unusable.
fn candidates(instance: &ash::Instance, least_version: u32) -> Result<Vec<Candidate>> {
    // SAFETY: the instance is alive.
    let physical = unsafe { instance.enumerate_physical_devices() };
    let physical = physical.map_err(vk_error("vkEnumeratePhysicalDevices"))?;
    if physical.is_empty() {
        return Err(Error::NoDevice { reason: "the loader found no device".into() });
    }
    let physical = physical.into_iter().enumerate();
    physical.map(|(index, physical)| describe(instance, index, physical, least_version)).collect()
}

/// Returns the device requested by index or by part of its name, or otherwise the best. Discrete, integrated, virtual and
/// processor are preferred in this order.
pub(super) fn choose(instance: &ash::Instance, asked: Option<&str>, least_version: u32) -> Result<Candidate> {
    let mut all = candidates(instance, least_version)?;
    if let Some(asked) = asked {
        let Some(found) = find(all.iter().map(|c| c.description.name.as_str()), asked) else {
            let names = all.iter().map(|c| format!("{} '{}'", c.description.index, c.description.name));
            let available = names.collect::<Vec<_>>().join(", ");
            return Err(Error::UnknownDevice { asked: asked.to_owned(), available });
        };
        let candidate = all.swap_remove(found);
        return match &candidate.missing {
            Some(feature) => Err(Error::MissingFeature {
                device: candidate.description.name.clone(),
                feature: feature.clone(),
            }),
            None => Ok(candidate),
        };
    }
    let rank = |c: &Candidate| match c.device_type {
        vk::PhysicalDeviceType::DISCRETE_GPU => 0,
        vk::PhysicalDeviceType::INTEGRATED_GPU => 1,
        vk::PhysicalDeviceType::VIRTUAL_GPU => 2,
        vk::PhysicalDeviceType::CPU => 3,
        _ => 4,
    };
    let reasons =
        all.iter().filter_map(|c| Some(format!("'{}' lacks {}", c.description.name, c.missing.as_ref()?)));
    let reason = reasons.collect::<Vec<_>>().join(", ");
    let usable = all.into_iter().filter(|c| c.missing.is_none());
    usable.min_by_key(rank).ok_or(Error::NoDevice { reason })
}

/// Returns the index of the device named by `asked`: a number, the whole name, or part of a name in any case.
fn find<'a>(names: impl Iterator<Item = &'a str> + Clone, asked: &str) -> Option<usize> {
    let asked = asked.trim().to_lowercase();
    if let Ok(index) = asked.parse::<usize>() {
        return (index < names.clone().count()).then_some(index);
    }
    let lower = names.map(str::to_lowercase);
    let whole = lower.clone().position(|name| name == asked);
    whole.or_else(
        || if asked.is_empty() { None } else { lower.clone().position(|name| name.contains(&asked)) },
    )
}

pub(super) fn describe(
    instance: &ash::Instance,
    index: usize,
    physical: vk::PhysicalDevice,
    least_version: u32,
) -> Result<Candidate> {
    // SAFETY: the physical device is of this instance; so in all queries below.
    let basic = unsafe { instance.get_physical_device_properties(physical) };
    let mut candidate = Candidate {
        physical,
        description: DeviceDescription {
            index,
            name: text(basic.device_name_as_c_str()),
            kind: match basic.device_type {
                vk::PhysicalDeviceType::DISCRETE_GPU => "discrete GPU",
                vk::PhysicalDeviceType::INTEGRATED_GPU => "integrated GPU",
                vk::PhysicalDeviceType::VIRTUAL_GPU => "virtual GPU",
                vk::PhysicalDeviceType::CPU => "CPU",
                _ => "other",
            },
            driver: String::new(),
            api_version: version(basic.api_version),
            limits: None,
            problem: None,
        },
        device_type: basic.device_type,
        queue_family: 0,
        presenting_family: 0,
        copying_family: None,
        features: OptionalFeatures::default(),
        missing: None,
    };
    let missing = if basic.api_version < least_version {
        Some(format!("Vulkan 1.3 (it has {})", candidate.description.api_version))
    } else {
        examine(instance, physical, &mut candidate)?
    };
    candidate.description.problem = missing.as_ref().map(|m| format!("lacks {m}"));
    candidate.missing = missing;
    Ok(candidate)
}

/// Fills in limits, queue families and features. Returns what the device lacks.
fn examine(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    candidate: &mut Candidate,
) -> Result<Option<String>> {
    // SAFETY: a plain query.
    let extensions = unsafe { instance.enumerate_device_extension_properties(physical) };
    let extensions = extensions.map_err(vk_error("vkEnumerateDeviceExtensionProperties"))?;
    let has = |name: &CStr| extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(name));
    // SAFETY: a plain query.
    let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
    let Some(ComputeFamilies { alone, presenting, timed, copying }) = compute_families(&families) else {
        return Ok(Some("a compute queue".into()));
    };
    (candidate.queue_family, candidate.presenting_family) = (alone, presenting);
    candidate.copying_family = copying;
    let (limits, lacking) = limits(instance, physical, timed, &mut candidate.description);
    candidate.description.limits = Some(limits);
    let (optional, mut missing) = features(instance, physical, &has);
    candidate.features = optional;
    candidate.features.push_descriptor = has(ash::khr::push_descriptor::NAME);
    candidate.features.portability_subset = has(c"VK_KHR_portability_subset");
    candidate.features.calibrated_timestamps = Calibrated::find(has);
    candidate.features.memory_budget = has(ash::ext::memory_budget::NAME);
    missing.extend(lacking);
    Ok((!missing.is_empty()).then(|| missing.join(", ")))
}

fn features(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    has: &impl Fn(&CStr) -> bool,
) -> (OptionalFeatures, Vec<String>) {
    let mut robustness2 = vk::PhysicalDeviceRobustness2FeaturesEXT::default();
    let mut reconvergence = vk::PhysicalDeviceShaderMaximalReconvergenceFeaturesKHR::default();
    let mut uniform = vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default();
    let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
    let mut all = vk::PhysicalDeviceFeatures2::default().push_next(&mut v12).push_next(&mut v13);
    if has(ash::ext::robustness2::NAME) {
        all = all.push_next(&mut robustness2);
    }
    if has(ash::khr::shader_maximal_reconvergence::NAME) {
        all = all.push_next(&mut reconvergence);
    }
    if has(ash::khr::shader_subgroup_uniform_control_flow::NAME) {
        all = all.push_next(&mut uniform);
    }
    // SAFETY: the device implements Vulkan 1.3, each struct is chained once.
    unsafe { instance.get_physical_device_features2(physical, &mut all) };
    let f = all.features;
    let missing = Features::of(&v12, &v13).missing().into_iter().map(str::to_owned).collect();
    let optional = OptionalFeatures {
        int8: v12.shader_int8 != 0,
        int64: f.shader_int64 != 0,
        storage8: v12.storage_buffer8_bit_access != 0,
        uniform_storage8: v12.uniform_and_storage_buffer8_bit_access != 0,
        memory_model: v12.vulkan_memory_model != 0,
        memory_model_device_scope: v12.vulkan_memory_model_device_scope != 0,
        push_descriptor: false,
        portability_subset: false,
        calibrated_timestamps: None,
        memory_budget: false,
        dynamic_broadcasts: v12.subgroup_broadcast_dynamic_id != 0,
        reconverges: reconvergence.shader_maximal_reconvergence != 0,
        uniform_control_flow: uniform.shader_subgroup_uniform_control_flow != 0,
        robust_buffers2: robustness2.robust_buffer_access2 != 0,
        graphics_stores: f.fragment_stores_and_atomics != 0 && f.vertex_pipeline_stores_and_atomics != 0,
    };
    (optional, missing)
}

fn limits(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    timestamps: bool,
    description: &mut DeviceDescription,
) -> (Limits, Vec<String>) {
    let mut v11 = vk::PhysicalDeviceVulkan11Properties::default();
    let mut v12 = vk::PhysicalDeviceVulkan12Properties::default();
    let mut v13 = vk::PhysicalDeviceVulkan13Properties::default();
    let mut push = vk::PhysicalDevicePushDescriptorPropertiesKHR::default();
    let mut all = vk::PhysicalDeviceProperties2::default()
        .push_next(&mut v11)
        .push_next(&mut v12)
        .push_next(&mut v13)
        .push_next(&mut push);
    // SAFETY: the device implements Vulkan 1.3, each struct is chained once.
    unsafe { instance.get_physical_device_properties2(physical, &mut all) };
    let properties = all.properties;
    let l = properties.limits;
    // SAFETY: a plain query.
    let memory = unsafe { instance.get_physical_device_memory_properties(physical) };
    let local = memory.memory_heaps_as_slice().iter();
    let local = local.filter(|h| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL)).map(|h| h.size).max();
    description.driver = format!("{} {}", text(v12.driver_name_as_c_str()), text(v12.driver_info_as_c_str()));
    let lacking = SUBGROUP_OPERATIONS
        .iter()
        .filter(|(flag, _)| !v11.subgroup_supported_operations.contains(*flag))
        .map(|(_, name)| *name);
    let lacking = lacking.collect::<Vec<_>>().join(", ");
    let mut missing = Vec::new();
    if !v11.subgroup_supported_stages.contains(vk::ShaderStageFlags::COMPUTE) {
        missing.push("subgroup operations in compute shaders".to_owned());
    } else if !lacking.is_empty() {
        missing.push(format!("subgroup operations ({lacking})"));
    }
    let tuning = match properties.device_type {
        vk::PhysicalDeviceType::CPU => Tuning::of(Backend::Processor),
        _ => Tuning::of_vendor(properties.vendor_id),
    };
    let limits = Limits {
        subgroup_size: v11.subgroup_size,
        heavy_subgroup_size: v11.subgroup_size,
        own_subgroup_size: v11.subgroup_size,
        min_subgroup_size: v13.min_subgroup_size,
        max_subgroup_size: v13.max_subgroup_size,
        subgroup_size_selectable: v13.required_subgroup_size_stages.contains(vk::ShaderStageFlags::COMPUTE),
        max_workgroup_invocations: l.max_compute_work_group_invocations,
        max_workgroup_size: l.max_compute_work_group_size,
        max_workgroup_subgroups: v13.max_compute_workgroup_subgroups,
        max_workgroups_per_axis: l.max_compute_work_group_count.into_iter().min().unwrap_or(65_535),
        shared_memory_bytes: l.max_compute_shared_memory_size,
        max_storage_buffer_range: u64::from(l.max_storage_buffer_range),
        max_allocation_bytes: v11.max_memory_allocation_size.min(v13.max_buffer_size),
        heap_bytes: local.unwrap_or(0),
        max_texels: l.max_texel_buffer_elements.into(),
        texel_alignment: l.min_texel_buffer_offset_alignment.max(16),
        storage_alignment: l.min_storage_buffer_offset_alignment.max(4),
        max_image_side: l.max_image_dimension2_d,
        max_uniform_range: l.max_uniform_buffer_range,
        uniform_alignment: l.min_uniform_buffer_offset_alignment.max(4),
        push_constant_bytes: l.max_push_constants_size,
        max_push_descriptors: push.max_push_descriptors,
        timestamp_period_ns: if timestamps { f64::from(l.timestamp_period) } else { 0.0 },
        tuning,
        broadcasts: false,
        workarounds: Workarounds::of_driver(v12.driver_id, &text(v12.driver_info_as_c_str())),
        instances_per_dispatch: INSTANCES_PER_DISPATCH,
        overrides: Vec::new(),
    };
    let limits = limits.tuned(tuning);
    missing.extend(low_limits(&l, limits.subgroup_size.max(limits.heavy_subgroup_size)));
    (limits, missing)
}

fn text(name: Result<&CStr, std::ffi::FromBytesUntilNulError>) -> String {
    name.map_or_else(|_| String::new(), |n| n.to_string_lossy().trim().to_owned())
}

fn version(v: u32) -> String {
    format!("{}.{}.{}", vk::api_version_major(v), vk::api_version_minor(v), vk::api_version_patch(v))
}

#[cfg(test)]
mod tests {
    use super::{CStr, Features, OptionalFeatures, find};

    #[test]
    fn a_device_is_found_by_index_and_by_part_of_its_name() {
        let names = ["NVIDIA H200", "llvmpipe (LLVM 15)", "AMD 200"];
        let find = |asked| find(names.into_iter(), asked);
        assert_eq!(find("1"), Some(1));
        assert_eq!(find("3"), None);
        assert_eq!(find("LLVMpipe"), Some(1));
        assert_eq!(find("amd 200"), Some(2));
        assert_eq!(find("intel"), None);
        assert_eq!(find(""), None);
    }

    /// A device's feature is used only if the host has enabled it together with its extension.
    #[test]
    fn a_hosts_optional_features_are_those_that_it_has_enabled() {
        let (maximal, uniform) = (
            ash::khr::shader_maximal_reconvergence::NAME,
            ash::khr::shader_subgroup_uniform_control_flow::NAME,
        );
        let kept = |told: &Features, extensions: &[&CStr]| {
            let has = OptionalFeatures {
                dynamic_broadcasts: true,
                reconverges: true,
                uniform_control_flow: true,
                ..OptionalFeatures::default()
            };
            let mut kept = has;
            kept.keep_enabled(told, extensions);
            [kept.dynamic_broadcasts, kept.reconverges, kept.uniform_control_flow]
        };
        let told = Features {
            subgroup_broadcast_dynamic_id: true,
            shader_maximal_reconvergence: true,
            shader_subgroup_uniform_control_flow: true,
            ..Features::REQUIRED
        };
        assert_eq!(kept(&Features::REQUIRED, &[maximal, uniform]), [false; 3]);
        assert_eq!(kept(&told, &[]), [true, false, false]);
        assert_eq!(kept(&told, &[uniform]), [true, false, true]);
        // Maximal reconvergence includes uniform control flow.
        assert_eq!(kept(&told, &[maximal, uniform]), [true, true, false]);
    }
}
