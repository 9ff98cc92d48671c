//! The loader, the Vulkan instance, and the devices: enumerates them, checks them, and selects one.

use super::debug::{Messenger, vk_error};
use super::limits::{Limits, max_loop_iterations};
use super::requirements::{Features, SUBGROUP_OPERATIONS, low_limits};
use crate::error::{Error, Result};
use crate::frame::tuning::{Backend, Tuning};
use ash::vk;
use std::ffi::CStr;

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// An instance of Vulkan 1.3 and the loader that it came from.
pub(super) struct Instance {
    pub(super) messenger: Option<Messenger>,
    pub(super) has_debug_utils: bool,
    /// Vulkan version of the validation layer, if it is on.
    layer: Option<u32>,
    pub(super) raw: ash::Instance,
    // Unloads the library when dropped: keep it last.
    _entry: ash::Entry,
}

impl Instance {
    /// With `validation`, turns on the Khronos layer with synchronization validation, and collects its messages. With
    /// `printf`, turns on the layer for shader output. Also enables all `extensions`.
    pub(super) fn new(validation: bool, printf: bool, extensions: &[&CStr]) -> Result<Self> {
        // SAFETY: loading the system's Vulkan loader runs its initialisers, which are sound for a proper install.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| Error::NoLoader { reason: e.to_string() })?;
        let layer = if validation || printf { layer_version(&entry)? } else { None };
        if (validation || printf) && layer.is_none() {
            return Err(lacks_on_this_machine(
                "VK_LAYER_KHRONOS_validation (Debian: vulkan-validationlayers)".into(),
            ));
        }
        // SAFETY: a plain query.
        let present = unsafe { entry.enumerate_instance_extension_properties(None) };
        let present = present.map_err(vk_error("vkEnumerateInstanceExtensionProperties"))?;
        if let Some(lacking) = extensions.iter().find(|name| !has_extension(&present, name)) {
            return Err(lacks_on_this_machine(lacking.to_string_lossy().into_owned()));
        }
        let has_debug_utils = has_extension(&present, ash::ext::debug_utils::NAME);
        let has_portability = has_extension(&present, ash::khr::portability_enumeration::NAME);
        let further = [
            (has_debug_utils, ash::ext::debug_utils::NAME),
            (has_portability, ash::khr::portability_enumeration::NAME),
        ];
        let further = further.into_iter().filter_map(|(has, name)| has.then_some(name));
        let enabled: Vec<_> = extensions.iter().copied().chain(further).map(CStr::as_ptr).collect();
        let flags = match has_portability {
            true => vk::InstanceCreateFlags::ENUMERATE_PORTABILITY_KHR,
            false => vk::InstanceCreateFlags::empty(),
        };
        let checks = [
            (validation, vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION),
            (printf, vk::ValidationFeatureEnableEXT::DEBUG_PRINTF),
        ];
        let checks: Vec<_> =
            checks.into_iter().filter_map(|(wanted, check)| wanted.then_some(check)).collect();
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&checks);
        let application = vk::ApplicationInfo::default()
            .application_name(c"ashsplat")
            .engine_name(c"ashsplat")
            .api_version(vk::API_VERSION_1_3);
        let layers = [VALIDATION_LAYER.as_ptr()];
        let mut info = vk::InstanceCreateInfo::default()
            .flags(flags)
            .application_info(&application)
            .enabled_extension_names(&enabled);
        if layer.is_some() {
            info = info.enabled_layer_names(&layers).push_next(&mut features);
        }
        // SAFETY: every pointer in `info` outlives the call.
        let raw = unsafe { entry.create_instance(&info, None) }.map_err(|error| match error {
            vk::Result::ERROR_INCOMPATIBLE_DRIVER => {
                Error::NoDevice { reason: "the loader found no driver for Vulkan 1.3".into() }
            }
            error => vk_error("vkCreateInstance")(error),
        })?;
        let wanted = layer.is_some() && has_debug_utils;
        match wanted.then(|| Messenger::new(&entry, &raw, printf)).transpose() {
            Ok(messenger) => Ok(Self { messenger, has_debug_utils, layer, raw, _entry: entry }),
            Err(error) => {
                // SAFETY: nothing was created from the instance.
                unsafe { raw.destroy_instance(None) };
                Err(vk_error("vkCreateDebugUtilsMessengerEXT")(error))
            }
        }
    }

    /// True if VK_KHR_shader_maximal_reconvergence can be used: older validation layers reject its SPIR-V.
    pub(super) fn knows_reconvergence(&self) -> bool {
        self.layer.is_none_or(|version| version >= vk::make_api_version(0, 1, 3, 280))
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        self.messenger = None;
        // SAFETY: the messenger is gone, and the owner of this struct has destroyed its device before.
        unsafe { self.raw.destroy_instance(None) }
    }
}

/// True if the Khronos validation layer is installed; false without a loader.
pub fn validation_available() -> bool {
    // SAFETY: as in `Instance::new`.
    unsafe { ash::Entry::load() }.is_ok_and(|entry| layer_version(&entry).is_ok_and(|v| v.is_some()))
}

fn layer_version(entry: &ash::Entry) -> Result<Option<u32>> {
    // SAFETY: a plain query.
    let layers = unsafe { entry.enumerate_instance_layer_properties() };
    let layers = layers.map_err(vk_error("vkEnumerateInstanceLayerProperties"))?;
    let layer = layers.iter().find(|l| l.layer_name_as_c_str() == Ok(VALIDATION_LAYER));
    Ok(layer.map(|layer| layer.spec_version))
}

fn lacks_on_this_machine(feature: String) -> Error {
    Error::MissingFeature { device: "this machine".into(), feature }
}

pub(super) fn has_extension(present: &[vk::ExtensionProperties], name: &CStr) -> bool {
    present.iter().any(|extension| extension.extension_name_as_c_str() == Ok(name))
}

/// See [`Limits::instances_per_dispatch`]: 256 pixels per instance, tens of milliseconds on a GPU.
const INSTANCES_PER_DISPATCH: u32 = 1 << 25;

/// Description of a device by [`devices`].
#[derive(Clone, Debug, Default)]
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

#[derive(Default)]
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
    /// Features of Vulkan 1.2.
    pub(super) v12: vk::PhysicalDeviceVulkan12Features<'static>,
    pub(super) int64: bool,
    pub(super) push_descriptor: bool,
    pub(super) portability_subset: bool,
    pub(super) memory_budget: bool,
    pub(super) dynamic_broadcasts: bool,
    pub(super) reconverges: bool,
    pub(super) uniform_control_flow: bool,
    pub(super) robust_buffers2: bool,
    /// fragmentStoresAndAtomics and vertexPipelineStoresAndAtomics, which the layer's debugPrintf requires.
    pub(super) graphics_stores: bool,
}

impl OptionalFeatures {
    /// Turns off the subgroup features that a host has not enabled.
    pub(super) fn keep_enabled(&mut self, reported: &Features, extensions: &[&CStr]) {
        let enabled = |name: &CStr| extensions.contains(&name);
        self.dynamic_broadcasts &= reported.subgroup_broadcast_dynamic_id;
        self.reconverges &=
            reported.shader_maximal_reconvergence && enabled(ash::khr::shader_maximal_reconvergence::NAME);
        self.uniform_control_flow &= reported.shader_subgroup_uniform_control_flow
            && enabled(ash::khr::shader_subgroup_uniform_control_flow::NAME)
            && !self.reconverges;
    }
}

/// Returns all devices, in the loader's order. Those with an older Vulkan are unusable.
fn candidates(instance: &ash::Instance, min_version: u32) -> Result<Vec<Candidate>> {
    // SAFETY: the instance is alive.
    let physical = unsafe { instance.enumerate_physical_devices() };
    let physical = physical.map_err(vk_error("vkEnumeratePhysicalDevices"))?;
    if physical.is_empty() {
        return Err(Error::NoDevice { reason: "the loader found no device".into() });
    }
    let physical = physical.into_iter().enumerate();
    physical.map(|(index, physical)| describe(instance, index, physical, min_version)).collect()
}

/// Types of devices and their names, the preferred first.
const KINDS: [(vk::PhysicalDeviceType, &str); 4] = [
    (vk::PhysicalDeviceType::DISCRETE_GPU, "discrete GPU"),
    (vk::PhysicalDeviceType::INTEGRATED_GPU, "integrated GPU"),
    (vk::PhysicalDeviceType::VIRTUAL_GPU, "virtual GPU"),
    (vk::PhysicalDeviceType::CPU, "CPU"),
];

/// Returns the device requested by index or by part of its name, or otherwise the best by [`KINDS`].
pub(super) fn choose(
    instance: &ash::Instance,
    requested: Option<&str>,
    min_version: u32,
) -> Result<Candidate> {
    let mut all = candidates(instance, min_version)?;
    if let Some(requested) = requested {
        let Some(found) = find(all.iter().map(|c| c.description.name.as_str()), requested) else {
            let names = all.iter().map(|c| format!("{} '{}'", c.description.index, c.description.name));
            let available = names.collect::<Vec<_>>().join(", ");
            return Err(Error::UnknownDevice { requested: requested.to_owned(), available });
        };
        let candidate = all.swap_remove(found);
        return match candidate.missing {
            Some(feature) => Err(Error::MissingFeature { device: candidate.description.name, feature }),
            None => Ok(candidate),
        };
    }
    let rank =
        |c: &Candidate| KINDS.iter().position(|(kind, _)| *kind == c.device_type).unwrap_or(KINDS.len());
    let lacking =
        all.iter().filter_map(|c| Some(format!("'{}' lacks {}", c.description.name, c.missing.as_ref()?)));
    let reason = lacking.collect::<Vec<_>>().join(", ");
    let usable = all.into_iter().filter(|c| c.missing.is_none());
    usable.min_by_key(rank).ok_or(Error::NoDevice { reason })
}

/// Returns the index of the device named by `requested`: a number, the whole name, or part of a name in any case.
fn find<'a>(names: impl Iterator<Item = &'a str> + Clone, requested: &str) -> Option<usize> {
    let requested = requested.trim().to_lowercase();
    if let Ok(index) = requested.parse::<usize>() {
        return (index < names.clone().count()).then_some(index);
    }
    let lower = names.map(str::to_lowercase);
    let whole = lower.clone().position(|name| name == requested);
    whole.or_else(|| lower.clone().position(|name| !requested.is_empty() && name.contains(&requested)))
}

pub(super) fn describe(
    instance: &ash::Instance,
    index: usize,
    physical: vk::PhysicalDevice,
    min_version: u32,
) -> Result<Candidate> {
    // SAFETY: the physical device is of this instance; so in all queries below.
    let basic = unsafe { instance.get_physical_device_properties(physical) };
    let mut candidate = Candidate {
        physical,
        description: DeviceDescription {
            index,
            name: text(basic.device_name_as_c_str()),
            kind: KINDS.iter().find(|(kind, _)| *kind == basic.device_type).map_or("other", |(_, name)| name),
            api_version: version(basic.api_version),
            ..Default::default()
        },
        device_type: basic.device_type,
        ..Default::default()
    };
    let missing = if basic.api_version < min_version {
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
    let families = compute_families(&queue_families(instance, physical));
    let Some(ComputeFamilies { alone, presenting, timed, copying }) = families else {
        return Ok(Some("a compute queue".into()));
    };
    (candidate.queue_family, candidate.presenting_family) = (alone, presenting);
    candidate.copying_family = copying;
    let (limits, lacking) = limits(instance, physical, timed, &mut candidate.description);
    candidate.description.limits = Some(limits);
    let mut missing: Vec<String>;
    (candidate.features, missing) = features(instance, physical, &extensions);
    missing.extend(lacking);
    Ok((!missing.is_empty()).then(|| missing.join(", ")))
}

fn features(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    extensions: &[vk::ExtensionProperties],
) -> (OptionalFeatures, Vec<String>) {
    let has = |name: &CStr| has_extension(extensions, name);
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
        v12: vk::PhysicalDeviceVulkan12Features {
            shader_int8: v12.shader_int8,
            storage_buffer8_bit_access: v12.storage_buffer8_bit_access,
            uniform_and_storage_buffer8_bit_access: v12.uniform_and_storage_buffer8_bit_access,
            vulkan_memory_model: v12.vulkan_memory_model,
            vulkan_memory_model_device_scope: v12.vulkan_memory_model_device_scope,
            ..Default::default()
        },
        int64: f.shader_int64 != 0,
        push_descriptor: has(ash::khr::push_descriptor::NAME),
        portability_subset: has(ash::khr::portability_subset::NAME),
        memory_budget: has(ash::ext::memory_budget::NAME),
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
    let operations = v11.subgroup_supported_operations;
    let lacking = SUBGROUP_OPERATIONS.iter().filter(|(flag, _)| !operations.contains(*flag));
    let lacking = lacking.map(|(_, name)| *name).collect::<Vec<_>>().join(", ");
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
        max_loop_iterations: max_loop_iterations(v12.driver_id, &text(v12.driver_info_as_c_str())),
        instances_per_dispatch: INSTANCES_PER_DISPATCH,
        overrides: Vec::new(),
    }
    .tuned(tuning);
    missing.extend(low_limits(&l, limits.subgroup_size.max(limits.heavy_subgroup_size)));
    (limits, missing)
}

fn text(name: Result<&CStr, std::ffi::FromBytesUntilNulError>) -> String {
    name.map_or_else(|_| String::new(), |n| n.to_string_lossy().trim().to_owned())
}

fn version(v: u32) -> String {
    format!("{}.{}.{}", vk::api_version_major(v), vk::api_version_minor(v), vk::api_version_patch(v))
}

pub(super) fn queue_families(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
) -> Vec<vk::QueueFamilyProperties> {
    // SAFETY: the physical device is of this instance.
    unsafe { instance.get_physical_device_queue_family_properties(physical) }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ComputeFamilies {
    /// For work without presentation. A family without graphics if there is one: its queue does not wait for other draws.
    pub(super) alone: u32,
    /// For work beside presentation to a screen.
    pub(super) presenting: u32,
    /// True if both have timestamps.
    pub(super) timed: bool,
    /// For copies only: its queue runs beside the others. None if there is no such family.
    pub(super) copying: Option<u32>,
}

/// Returns None without compute. Prefers families with timestamps.
pub(super) fn compute_families(families: &[vk::QueueFamilyProperties]) -> Option<ComputeFamilies> {
    let is_timed = |f: &vk::QueueFamilyProperties| f.timestamp_valid_bits > 0;
    let compute = |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
    let timed = families.iter().any(|f| compute(f) && is_timed(f));
    let fits = |f: &vk::QueueFamilyProperties| compute(f) && (is_timed(f) || !timed);
    let presenting = families.iter().position(fits)?;
    let apart = |f: &vk::QueueFamilyProperties| fits(f) && !f.queue_flags.contains(vk::QueueFlags::GRAPHICS);
    let alone = families.iter().position(apart).unwrap_or(presenting);
    // Video families can copy too, but have another purpose.
    let copies = vk::QueueFlags::TRANSFER | vk::QueueFlags::SPARSE_BINDING | vk::QueueFlags::PROTECTED;
    let only_copies = |f: &vk::QueueFamilyProperties| {
        f.queue_flags.contains(vk::QueueFlags::TRANSFER) && copies.contains(f.queue_flags)
    };
    let copying = families.iter().position(only_copies).map(|index| index as u32);
    Some(ComputeFamilies { alone: alone as u32, presenting: presenting as u32, timed, copying })
}

#[cfg(test)]
mod tests {
    use super::*;
    use vk::QueueFlags as Flags;

    #[test]
    fn a_device_is_found_by_index_and_by_part_of_its_name() {
        let names = ["NVIDIA H200", "llvmpipe (LLVM 15)", "AMD 200"];
        let requested = ["1", "3", "LLVMpipe", "amd 200", "intel", ""];
        let found = requested.map(|requested| find(names.into_iter(), requested));
        assert_eq!(found, [Some(1), None, Some(1), Some(2), None, None], "{requested:?}");
    }

    /// A device's feature is used only if the host has enabled it together with its extension.
    #[test]
    fn a_hosts_optional_features_are_those_that_it_has_enabled() {
        let (maximal, uniform) = (
            ash::khr::shader_maximal_reconvergence::NAME,
            ash::khr::shader_subgroup_uniform_control_flow::NAME,
        );
        let kept = |reported: &Features, extensions: &[&CStr]| {
            let mut kept = OptionalFeatures {
                dynamic_broadcasts: true,
                reconverges: true,
                uniform_control_flow: true,
                ..OptionalFeatures::default()
            };
            kept.keep_enabled(reported, extensions);
            [kept.dynamic_broadcasts, kept.reconverges, kept.uniform_control_flow]
        };
        let reported = Features {
            subgroup_broadcast_dynamic_id: true,
            shader_maximal_reconvergence: true,
            shader_subgroup_uniform_control_flow: true,
            ..Features::REQUIRED
        };
        assert_eq!(kept(&Features::REQUIRED, &[maximal, uniform]), [false; 3]);
        assert_eq!(kept(&reported, &[]), [true, false, false]);
        assert_eq!(kept(&reported, &[uniform]), [true, false, true]);
        // Maximal reconvergence includes uniform control flow.
        assert_eq!(kept(&reported, &[maximal, uniform]), [true, true, false]);
    }

    /// Families of queues with these flags and bits of timestamps.
    fn of(families: &[(Flags, u32)]) -> Option<ComputeFamilies> {
        let family = |&(queue_flags, timestamp_valid_bits)| vk::QueueFamilyProperties {
            queue_flags,
            timestamp_valid_bits,
            queue_count: 1,
            ..vk::QueueFamilyProperties::default()
        };
        compute_families(&families.iter().map(family).collect::<Vec<_>>())
    }

    const APART: Flags = Flags::from_raw(Flags::COMPUTE.as_raw() | Flags::TRANSFER.as_raw());
    const ALL: Flags = Flags::from_raw(APART.as_raw() | Flags::GRAPHICS.as_raw());

    #[test]
    fn copies_have_a_family_that_does_nothing_else() {
        let copies = Flags::TRANSFER | Flags::SPARSE_BINDING;
        let (all, apart, films) = (ALL | copies, APART | copies, copies | Flags::VIDEO_DECODE_KHR);
        let copying = |flags: &[Flags]| {
            of(&flags.iter().map(|&flags| (flags, 0)).collect::<Vec<_>>()).and_then(|found| found.copying)
        };
        // NVIDIA's order, AMD's order, and cards without a copy family.
        assert_eq!(copying(&[all, copies, apart, films]), Some(1));
        assert_eq!(copying(&[all, apart, films, copies]), Some(3));
        assert_eq!(copying(&[all, apart, films]), None);
    }

    #[test]
    fn families_without_graphics_come_first_for_work_alone() {
        let of = |families| of(families).map(|found| (found.alone, found.presenting, found.timed));
        // Orders of real cards, one with a copy family before the compute family.
        assert_eq!(of(&[(ALL, 64), (Flags::TRANSFER, 64), (APART, 64)]), Some((2, 0, true)));
        assert_eq!(of(&[(ALL, 64), (APART, 64)]), Some((1, 0, true)));
        // One family for everything.
        assert_eq!(of(&[(ALL, 36)]), Some((0, 0, true)));
        // Timestamps are preferred to a separate queue.
        assert_eq!(of(&[(ALL, 36), (APART, 0)]), Some((0, 0, true)));
        assert_eq!(of(&[(ALL, 0), (APART, 0)]), Some((1, 0, false)));
        assert_eq!(of(&[(Flags::TRANSFER, 64), (Flags::GRAPHICS, 64)]), None);
    }
}
