//! A wgpu device on which ashsplat can be a guest: the host's part of step 1 in the guide's chapter `embedding`.

use crate::Result;
use crate::messages::Messages;
use ashsplat::ash::vk::{self, TaggedStructure};
use ashsplat::vk::{Context, ContextOptions, ForeignDevice};
use std::ffi::CStr;
use wgpu::hal::api::Vulkan;

/// wgpu-hal submits to the first queue of the first family.
const QUEUE_FAMILY: u32 = 0;
const QUEUE: u32 = 0;

/// A wgpu application's objects, and the extensions enabled on its device.
pub struct Host {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    extensions: Vec<&'static CStr>,
    adapter: wgpu::Adapter,
}

impl Host {
    /// The first adapter that is not a processor, else the first.
    pub fn new(instance: &wgpu::Instance) -> Result<Self> {
        let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
        let is_gpu = |adapter: &&wgpu::Adapter| adapter.get_info().device_type != wgpu::DeviceType::Cpu;
        let chosen = adapters.iter().find(is_gpu).or(adapters.first());
        let adapter = chosen.ok_or("no Vulkan device")?.clone();
        let descriptor = wgpu::DeviceDescriptor::default();
        let (open, extensions) = open(&adapter, &descriptor)?;
        // SAFETY: `open` made the device from this adapter, with these features.
        let (device, queue) = unsafe { adapter.create_device_from_hal(open, &descriptor)? };
        Ok(Self { device, queue, extensions, adapter })
    }

    /// A context on the device.
    ///
    /// # Safety
    /// The context and everything made from it are dropped before the host. No other thread submits to the queue, by wgpu or
    /// otherwise, during a call of ashsplat that submits.
    pub unsafe fn context(&self, debug_utils: bool) -> Result<Context> {
        // SAFETY: the handles are used while both guards and the host live, and none of them is destroyed here.
        let guards = unsafe { (self.adapter.as_hal::<Vulkan>(), self.device.as_hal::<Vulkan>()) };
        let (Some(adapter), Some(device)) = guards else { return Err("not a Vulkan device".into()) };
        let foreign = ForeignDevice {
            instance: adapter.shared_instance().raw_instance(),
            physical_device: adapter.raw_physical_device(),
            device: device.raw_device(),
            queue_family: device.queue_family_index(),
            queue: Some(device.raw_queue()),
            queue_lock: None,
            features: Context::requirements().features,
            extensions: &self.extensions,
            debug_utils,
            allocator: None,
            pipeline_cache: vk::PipelineCache::null(),
        };
        // SAFETY: wgpu-hal creates instances for Vulkan 1.3; `open` enabled the features and extensions; the caller keeps
        // the rest.
        Ok(unsafe { Context::from_foreign(&foreign, &ContextOptions::default())? })
    }
}

/// An instance. With validation, also synchronisation validation and VK_EXT_debug_utils. `InstanceFlags::DEBUG` would add the
/// extension too, but also debug information in wgpu's shaders, which older validation layers report as an error.
pub fn instance(validation: bool) -> Result<wgpu::Instance> {
    let flags = if validation { wgpu::InstanceFlags::VALIDATION } else { wgpu::InstanceFlags::empty() };
    let descriptor = wgpu::hal::InstanceDescriptor {
        name: "a host on wgpu",
        flags,
        memory_budget_thresholds: Default::default(),
        backend_options: Default::default(),
        telemetry: None,
        display: None,
    };
    let extend = Box::new(move |to: wgpu::hal::vulkan::CreateInstanceCallbackArgs<'_, '_, '_>| {
        to.extensions.extend(validation.then_some(ashsplat::ash::ext::debug_utils::NAME));
    });
    // SAFETY: adds an extension that the validation layer provides, and removes nothing.
    unsafe {
        let instance = wgpu::hal::vulkan::Instance::init_with_callback(&descriptor, Some(extend))?;
        Ok(wgpu::Instance::from_hal::<Vulkan>(instance))
    }
}

/// A messenger in addition to wgpu's own, which writes to the log.
///
/// # Safety
/// The instance has VK_EXT_debug_utils and lives until [`Messages::finish`].
pub unsafe fn messages(instance: &wgpu::Instance) -> Result<Messages> {
    // SAFETY: the handles are not destroyed; the caller keeps the rest.
    unsafe {
        let instance = instance.as_hal::<Vulkan>().ok_or("not a Vulkan instance")?;
        let shared = instance.shared_instance();
        Ok(Messages::new(shared.entry(), shared.raw_instance())?)
    }
}

/// Opens a device with wgpu's and ashsplat's requirements. Also returns its extensions.
fn open(
    adapter: &wgpu::Adapter,
    descriptor: &wgpu::DeviceDescriptor<'_>,
) -> Result<(wgpu::hal::OpenDevice<Vulkan>, Vec<&'static CStr>)> {
    // SAFETY: the adapter's handles are used while the guard lives, and not destroyed.
    let adapter = unsafe { adapter.as_hal::<Vulkan>() }.ok_or("not a Vulkan device")?;
    let wgpu::DeviceDescriptor { required_features, required_limits, memory_hints, .. } = descriptor;
    let requirements = Context::requirements();
    let mut extensions = adapter.required_device_extensions(*required_features);
    extensions.extend(&requirements.extensions);
    let optional = requirements.optional_extensions.iter().map(|extension| extension.name);
    extensions
        .extend(optional.filter(|name| adapter.physical_device_capabilities().supports_extension(name)));
    extensions.sort_unstable();
    extensions.dedup();

    let names: Vec<_> = extensions.iter().map(|name| name.as_ptr()).collect();
    let queues =
        [vk::DeviceQueueCreateInfo::default().queue_family_index(QUEUE_FAMILY).queue_priorities(&[1.0])];
    let info = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&names);
    let mut features = adapter.physical_device_features(&extensions, *required_features);
    let mut info = features.add_to_device_create(info);
    // Features whose structs wgpu has chained are enabled there: a struct may not be chained twice. The others get a struct
    // here. None may be Vulkan12Features or Vulkan13Features, which exclude the single structs.
    let mut scalar = vk::PhysicalDeviceScalarBlockLayoutFeatures::default();
    let mut synchronization2 = vk::PhysicalDeviceSynchronization2Features::default();
    let mut maintenance4 = vk::PhysicalDeviceMaintenance4Features::default();
    let mut subgroups = vk::PhysicalDeviceSubgroupSizeControlFeatures::default();
    // SAFETY: the chain's structs are those in `features` and the four above, which live until the device is created.
    unsafe {
        chained(&mut info, &mut scalar).scalar_block_layout = vk::TRUE;
        chained(&mut info, &mut synchronization2).synchronization2 = vk::TRUE;
        chained(&mut info, &mut maintenance4).maintenance4 = vk::TRUE;
        let subgroups = chained(&mut info, &mut subgroups);
        (subgroups.subgroup_size_control, subgroups.compute_full_subgroups) = (vk::TRUE, vk::TRUE);
    }
    let instance = adapter.shared_instance().raw_instance();
    // SAFETY: the physical device is of this instance, and all pointers live through the call. The device has what the adapter
    // requires, and wgpu-hal takes it over.
    let open = unsafe {
        let device = instance.create_device(adapter.raw_physical_device(), &info, None)?;
        adapter.device_from_raw(
            device,
            None,
            &extensions,
            *required_features,
            required_limits,
            memory_hints,
            QUEUE_FAMILY,
            QUEUE,
        )?
    };
    Ok((open, extensions))
}

/// Returns the chain's struct of this type, or adds `own` to the chain.
///
/// # Safety
/// All structs of the chain are alive, mutable, and not borrowed elsewhere while the returned reference lives; `own` lives as long as
/// `info` is used.
unsafe fn chained<'a, T: TaggedStructure>(info: &mut vk::DeviceCreateInfo<'_>, own: &'a mut T) -> &'a mut T {
    let mut next = info.p_next.cast_mut().cast::<vk::BaseOutStructure<'_>>();
    // SAFETY: as promised; each struct of a chain begins with its type and the next pointer.
    unsafe {
        while !next.is_null() {
            if (*next).s_type == T::STRUCTURE_TYPE {
                return &mut *next.cast::<T>();
            }
            next = (*next).p_next;
        }
        let own_base = std::ptr::from_mut(own).cast::<vk::BaseOutStructure<'_>>();
        (*own_base).p_next = info.p_next.cast_mut().cast();
        info.p_next = own_base.cast();
    }
    own
}
