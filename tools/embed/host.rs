//! The host's Vulkan: an engine's own instance, device, images and frames in flight, in raw `ash`. Only two functions here know
//! ashsplat: [`Host::new`] enables what it requires, and [`Host::foreign`] hands the device over.

use super::messages::Messages;
use ashsplat::ash::{self, vk};
use ashsplat::vk::{Context, Features, ForeignDevice};
use std::error::Error;
use std::ffi::CStr;

pub type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Instance, device, one queue.
pub struct Host {
    pub instance: ash::Instance,
    pub physical: vk::PhysicalDevice,
    pub device: ash::Device,
    pub queue_family: u32,
    pub queue: vk::Queue,
    pub pool: vk::CommandPool,
    /// Present with [`HostOptions::async_compute`].
    pub async_queue: Option<AsyncQueue>,
    pub features: Features,
    pub extensions: Vec<&'static CStr>,
    messages: Option<Messages>,
    // Unloads the library when dropped: keep it last.
    _entry: ash::Entry,
}

/// A compute queue of its own family, beside the main queue.
#[allow(dead_code, reason = "the example has one queue; the tests use another one")]
#[derive(Clone, Copy)]
pub struct AsyncQueue {
    pub family: u32,
    pub queue: vk::Queue,
    pub pool: vk::CommandPool,
}

#[derive(Clone, Copy)]
pub struct HostOptions {
    /// Turn on the validation layer with synchronisation validation.
    pub validation: bool,
    /// Enable VK_KHR_push_descriptor if the device has it.
    pub push_descriptors: bool,
    /// A required feature to leave out, by its Vulkan name.
    pub without: Option<&'static str>,
    /// Also create a queue of a compute family without graphics.
    pub async_compute: bool,
    /// Enable features that keep subgroups' invocations together, and broadcasts from any lane, if the device has them.
    pub subgroup_features: bool,
}

impl Default for HostOptions {
    fn default() -> Self {
        Self {
            validation: false,
            push_descriptors: true,
            without: None,
            async_compute: false,
            subgroup_features: false,
        }
    }
}

impl Host {
    pub fn new(options: &HostOptions) -> Result<Self> {
        // SAFETY: every create info lives through its call; handles come from the calls before.
        unsafe {
            let entry = ash::Entry::load()?;
            let instance = create_instance(&entry, options.validation)?;
            let messages = options.validation.then(|| Messages::new(&entry, &instance)).transpose()?;
            // Chooses the first device that is not a processor, else the first.
            let is_cpu = |device: &vk::PhysicalDevice| {
                instance.get_physical_device_properties(*device).device_type == vk::PhysicalDeviceType::CPU
            };
            let devices = instance.enumerate_physical_devices()?;
            let physical = devices.into_iter().min_by_key(is_cpu).ok_or("no Vulkan device")?;
            let families = instance.get_physical_device_queue_family_properties(physical);
            let both = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
            let family = families.iter().position(|f| f.queue_flags.contains(both));
            let queue_family = family.ok_or("no queue for graphics and compute")? as u32;
            let apart = families.iter().position(|f| f.queue_flags & both == vk::QueueFlags::COMPUTE);
            let async_family = match options.async_compute {
                true => Some(apart.ok_or("no queue for compute alone")? as u32),
                false => None,
            };

            // The guest's requirements are merged with the host's own.
            let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
            let mut v13 = vk::PhysicalDeviceVulkan13Features::default().dynamic_rendering(true);
            let requirements = Context::requirements();
            let mut features = requirements.features;
            match options.without {
                Some("synchronization2") => features.synchronization2 = false,
                Some("maintenance4") => features.maintenance4 = false,
                _ => {}
            }
            let present = instance.enumerate_device_extension_properties(physical)?;
            let has = |name: &CStr| present.iter().any(|e| e.extension_name_as_c_str() == Ok(name));
            let mut known = vk::PhysicalDeviceVulkan12Features::default();
            let mut all = vk::PhysicalDeviceFeatures2::default().push_next(&mut known);
            instance.get_physical_device_features2(physical, &mut all);
            // A device with the extension has its feature. The newer one, which an older validation layer does not know, is left out.
            let control_flow_extension = ash::khr::shader_subgroup_uniform_control_flow::NAME;
            let control_flow = options.subgroup_features && has(control_flow_extension);
            features.shader_subgroup_uniform_control_flow = control_flow;
            features.subgroup_broadcast_dynamic_id =
                options.subgroup_features && known.subgroup_broadcast_dynamic_id != 0;
            features.merge_into(&mut v12, &mut v13);
            let mut extensions = requirements.extensions.clone();
            if options.push_descriptors && has(ash::khr::push_descriptor::NAME) {
                extensions.push(ash::khr::push_descriptor::NAME);
            }
            if control_flow {
                extensions.push(control_flow_extension);
            }

            let names: Vec<_> = extensions.iter().map(|name| name.as_ptr()).collect();
            let priorities = [1.0];
            let queue_of = |family: u32| {
                vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&priorities)
            };
            let queues: Vec<_> = std::iter::once(queue_family).chain(async_family).map(queue_of).collect();
            let mut info = vk::DeviceCreateInfo::default()
                .queue_create_infos(&queues)
                .enabled_extension_names(&names)
                .push_next(&mut v12)
                .push_next(&mut v13);
            let mut control_flow_feature =
                vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default()
                    .shader_subgroup_uniform_control_flow(true);
            if control_flow {
                info = info.push_next(&mut control_flow_feature);
            }
            let device = instance.create_device(physical, &info, None)?;
            let queue = device.get_device_queue(queue_family, 0);
            let new_pool = |family: u32| {
                let info = vk::CommandPoolCreateInfo::default()
                    .queue_family_index(family)
                    .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER);
                device.create_command_pool(&info, None)
            };
            let pool = new_pool(queue_family)?;
            let async_queue = |family| {
                let queue = device.get_device_queue(family, 0);
                Ok::<_, vk::Result>(AsyncQueue { family, queue, pool: new_pool(family)? })
            };
            let async_queue = async_family.map(async_queue).transpose()?;
            let _entry = entry;
            Ok(Self {
                instance,
                physical,
                device,
                queue_family,
                queue,
                pool,
                async_queue,
                features,
                extensions,
                messages,
                _entry,
            })
        }
    }

    /// Describes the device to the guest: handles, and what was enabled.
    pub fn foreign(&self) -> ForeignDevice<'_> {
        ForeignDevice {
            instance: &self.instance,
            physical_device: self.physical,
            device: &self.device,
            queue_family: self.queue_family,
            queue: Some(self.queue),
            features: self.features,
            extensions: &self.extensions,
            debug_utils: self.messages.is_some(),
            queue_lock: None,
            allocator: None,
            pipeline_cache: vk::PipelineCache::null(),
        }
    }

    /// Allocates memory of a type with these properties.
    pub fn allocate(
        &self,
        needs: vk::MemoryRequirements,
        wanted: vk::MemoryPropertyFlags,
    ) -> Result<vk::DeviceMemory> {
        // SAFETY: plain calls on live handles.
        unsafe {
            let memory = self.instance.get_physical_device_memory_properties(self.physical);
            let fits = |(index, kind): &(usize, &vk::MemoryType)| {
                needs.memory_type_bits & (1 << index) != 0 && kind.property_flags.contains(wanted)
            };
            let found = memory.memory_types_as_slice().iter().enumerate().find(fits);
            let (index, _) = found.ok_or("no memory type")?;
            let info =
                vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(index as u32);
            Ok(self.device.allocate_memory(&info, None)?)
        }
    }

    pub fn run(&self, record: impl FnOnce(vk::CommandBuffer) -> Result<()>) -> Result<()> {
        let frame = InFlight::new(self)?;
        frame.begin(self)?;
        let recorded = record(frame.commands);
        if recorded.is_ok() {
            frame.submit(self)?;
            frame.wait(self)?;
        }
        frame.destroy(self);
        recorded
    }

    pub fn wait(&self) -> Result<()> {
        // SAFETY: this is the queue's only user.
        unsafe { self.device.device_wait_idle()? }
        Ok(())
    }

    /// Destroys the device and the instance; everything made from them must be gone. Returns all messages of the validation
    /// layer, including those about leaked objects.
    pub fn destroy(self) -> Vec<String> {
        // SAFETY: the caller has destroyed what was made from the device.
        unsafe {
            let _ = self.device.device_wait_idle();
            self.device.destroy_command_pool(self.pool, None);
            if let Some(AsyncQueue { pool, .. }) = self.async_queue {
                self.device.destroy_command_pool(pool, None);
            }
            self.device.destroy_device(None);
            let messages = self.messages.map(Messages::finish);
            self.instance.destroy_instance(None);
            messages.unwrap_or_default()
        }
    }
}

unsafe fn create_instance(entry: &ash::Entry, validation: bool) -> Result<ash::Instance> {
    let application = vk::ApplicationInfo::default()
        .application_name(c"a tiny engine")
        .api_version(Context::requirements().api_version);
    let (mut layers, mut extensions) = (Vec::new(), Vec::new());
    if validation {
        layers.push(c"VK_LAYER_KHRONOS_validation".as_ptr());
        extensions.push(ash::ext::debug_utils::NAME.as_ptr());
    }
    let checks = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
    let mut checks = vk::ValidationFeaturesEXT::default().enabled_validation_features(&checks);
    let mut info = vk::InstanceCreateInfo::default()
        .application_info(&application)
        .enabled_layer_names(&layers)
        .enabled_extension_names(&extensions);
    if validation {
        info = info.push_next(&mut checks);
    }
    // SAFETY: all pointers live through the call.
    Ok(unsafe { entry.create_instance(&info, None)? })
}

/// A command buffer and the fence of its submission.
pub struct InFlight {
    pub commands: vk::CommandBuffer,
    fence: vk::Fence,
}

impl InFlight {
    pub fn new(host: &Host) -> Result<Self> {
        // SAFETY: valid create infos.
        unsafe {
            let info = vk::CommandBufferAllocateInfo::default()
                .command_pool(host.pool)
                .level(vk::CommandBufferLevel::PRIMARY)
                .command_buffer_count(1);
            let commands = host.device.allocate_command_buffers(&info)?;
            let fence = host.device.create_fence(&vk::FenceCreateInfo::default(), None)?;
            Ok(Self { commands: commands[0], fence })
        }
    }

    pub fn begin(&self, host: &Host) -> Result<()> {
        let info = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the last submission was waited for.
        unsafe { host.device.begin_command_buffer(self.commands, &info)? }
        Ok(())
    }

    pub fn submit(&self, host: &Host) -> Result<()> {
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(self.commands)];
        let submits = [vk::SubmitInfo2::default().command_buffer_infos(&buffers)];
        // SAFETY: recorded above; the used objects live until the wait.
        unsafe {
            host.device.end_command_buffer(self.commands)?;
            host.device.queue_submit2(host.queue, &submits, self.fence)?;
        }
        Ok(())
    }

    pub fn wait(&self, host: &Host) -> Result<()> {
        // SAFETY: the fence was submitted.
        unsafe {
            host.device.wait_for_fences(&[self.fence], true, u64::MAX)?;
            host.device.reset_fences(&[self.fence])?;
        }
        Ok(())
    }

    pub fn destroy(self, host: &Host) {
        // SAFETY: waited for, or never submitted.
        unsafe {
            host.device.destroy_fence(self.fence, None);
            host.device.free_command_buffers(host.pool, &[self.commands]);
        }
    }
}
