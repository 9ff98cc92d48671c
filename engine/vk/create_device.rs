//! Creates a device of our own.

use super::device::Candidate;
use super::error::vk_error;
use super::requirements::Features;
use crate::{Error, Result};
use ash::vk;
use std::ffi::CStr;

/// Optional requests beyond the required features.
pub(super) struct Wishes<'a> {
    /// Shaders may print.
    pub printf: bool,
    /// Pipelines report compiler statistics.
    pub executables: bool,
    pub extensions: &'a [&'a CStr],
}

/// Creates a device with the required features, its optional features and the wishes. It has a main queue, and a copy queue
/// if there is a family for copies.
pub(super) fn create_device(
    instance: &ash::Instance,
    candidate: &Candidate,
    wishes: &Wishes<'_>,
) -> Result<ash::Device> {
    let optional = &candidate.features;
    let statistics = wishes.executables.then_some(ash::khr::pipeline_executable_properties::NAME);
    let further: Vec<&CStr> = wishes.extensions.iter().copied().chain(statistics).collect();
    let mut v12 = vk::PhysicalDeviceVulkan12Features::default()
        .shader_int8(optional.int8)
        .storage_buffer8_bit_access(optional.storage8)
        .uniform_and_storage_buffer8_bit_access(optional.uniform_storage8)
        .vulkan_memory_model(optional.memory_model)
        .vulkan_memory_model_device_scope(optional.memory_model_device_scope)
        .subgroup_broadcast_dynamic_id(optional.dynamic_broadcasts)
        // Every device of Vulkan 1.2 has it.
        .timeline_semaphore(candidate.copying_family.is_some());
    let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
    Features::REQUIRED.merge_into(&mut v12, &mut v13);
    // SAFETY: a plain query.
    let present = unsafe { instance.enumerate_device_extension_properties(candidate.physical) };
    let present = present.map_err(vk_error("vkEnumerateDeviceExtensionProperties"))?;
    let has = |name: &CStr| present.iter().any(|e| e.extension_name_as_c_str() == Ok(name));
    if let Some(lacking) = further.iter().find(|name| !has(name)) {
        let feature = lacking.to_string_lossy().into_owned();
        return Err(Error::MissingFeature { device: candidate.description.name.clone(), feature });
    }
    let mut extensions: Vec<_> = further.iter().map(|name| name.as_ptr()).collect();
    if optional.push_descriptor {
        extensions.push(ash::khr::push_descriptor::NAME.as_ptr());
    }
    if optional.portability_subset {
        extensions.push(c"VK_KHR_portability_subset".as_ptr());
    }
    if optional.memory_budget {
        extensions.push(ash::ext::memory_budget::NAME.as_ptr());
    }
    if optional.robust_buffers2 {
        extensions.push(ash::ext::robustness2::NAME.as_ptr());
    }
    if optional.reconverges {
        extensions.push(ash::khr::shader_maximal_reconvergence::NAME.as_ptr());
    }
    if optional.uniform_control_flow {
        extensions.push(ash::khr::shader_subgroup_uniform_control_flow::NAME.as_ptr());
    }
    extensions.extend(optional.calibrated_timestamps.map(|kind| kind.extension().as_ptr()));
    let priorities = [1.0];
    let families = std::iter::once(candidate.queue_family).chain(candidate.copying_family);
    let queue = |family| {
        vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&priorities)
    };
    let queues: Vec<_> = families.map(queue).collect();
    // Without these features the layer refuses to print.
    let printing = wishes.printf && optional.graphics_stores;
    // Every device has robustBufferAccess. It is needed because counts in push constants are not checked here.
    let core = vk::PhysicalDeviceFeatures::default()
        .robust_buffer_access(true)
        .shader_int64(optional.int64)
        .fragment_stores_and_atomics(printing)
        .vertex_pipeline_stores_and_atomics(printing);
    let mut robustness2 = vk::PhysicalDeviceRobustness2FeaturesEXT::default().robust_buffer_access2(true);
    let mut info = vk::DeviceCreateInfo::default()
        .enabled_features(&core)
        .queue_create_infos(&queues)
        .enabled_extension_names(&extensions)
        .push_next(&mut v12)
        .push_next(&mut v13);
    if optional.robust_buffers2 {
        info = info.push_next(&mut robustness2);
    }
    let mut reconvergence =
        vk::PhysicalDeviceShaderMaximalReconvergenceFeaturesKHR::default().shader_maximal_reconvergence(true);
    if optional.reconverges {
        info = info.push_next(&mut reconvergence);
    }
    let mut uniform = vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default()
        .shader_subgroup_uniform_control_flow(true);
    if optional.uniform_control_flow {
        info = info.push_next(&mut uniform);
    }
    let mut executables =
        vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
    if wishes.executables {
        info = info.push_next(&mut executables);
    }
    // SAFETY: all features and extensions were found present (the last one comes with its extension); each struct is chained
    // once and outlives the call.
    unsafe { instance.create_device(candidate.physical, &info, None) }.map_err(vk_error("vkCreateDevice"))
}
