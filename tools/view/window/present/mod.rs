//! A window's surface on the engine's device: swapchain, frames in flight, and commands that the engine lacks. The window is a
//! raw Vulkan host, the only part of the program that is one.

#![allow(unsafe_code)]

mod choice;
mod commands;
mod swapchain;

use ashsplat::ash::{self, khr, vk};
use ashsplat::vk::{Context, ForeignCommands, Image, ImageState};
use ashsplat::{Error, Result};
use commands::Images;
use std::ffi::CStr;
use std::sync::Arc;
pub use swapchain::CANVAS;
use swapchain::{Choice, Swapchain};
use winit::raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use winit::window::Window;

/// Most frames that the device works on at once.
pub const FRAMES_IN_FLIGHT: u32 = 2;
/// Longest wait for an image of the swapchain, ns: an invisible window may get none.
const LONGEST_WAIT: u64 = 250_000_000;

fn failed(call: &'static str) -> impl Fn(vk::Result) -> Error {
    move |result| match result {
        vk::Result::ERROR_DEVICE_LOST => Error::DeviceLost { call },
        result => Error::Vulkan { call, result: format!("{result:?}"), remedy: String::new() },
    }
}

/// Error of a device or a display that cannot be used for a window.
pub fn unfit(problem: &str) -> Error {
    Error::argument("--window", format!("{problem}; without --window the viewer is a page in a browser"))
}

/// Instance extensions that surfaces of a display need.
pub fn instance_extensions(display: &impl HasDisplayHandle) -> Result<Vec<&'static CStr>> {
    let handle = display.display_handle().map_err(|error| unfit(&error.to_string()))?;
    let names = ash_window::enumerate_required_extensions(handle.as_raw());
    let names = names.map_err(|_| unfit("Vulkan has no surfaces for this kind of display"))?;
    // SAFETY: these are Vulkan's names, constants of the crate.
    Ok(names.iter().map(|&name| unsafe { CStr::from_ptr(name) }).collect())
}

pub const DEVICE_EXTENSIONS: [&CStr; 1] = [khr::swapchain::NAME];

/// A command buffer with its synchronization.
struct InFlight {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    /// Signalled when the image of the swapchain may be written.
    acquired: vk::Semaphore,
    /// Signalled when the commands are done, and before the first use.
    done: vk::Fence,
}

pub struct BegunFrame {
    /// Index among the frames in flight.
    pub slot: u32,
    /// Index among the swapchain's images.
    image: u32,
}

pub struct Present {
    device: ash::Device,
    queue: vk::Queue,
    surfaces: khr::surface::Instance,
    surface: vk::SurfaceKHR,
    swapchains: khr::swapchain::Device,
    physical: vk::PhysicalDevice,
    swapchain: Option<Swapchain>,
    /// True if the swapchain no longer fits the surface.
    stale: bool,
    vsync: bool,
    frames: Vec<InFlight>,
    next: usize,
    // Must outlive all objects above.
    window: Arc<Window>,
    context: Context,
    _entry: ash::Entry,
}

impl Present {
    /// Creates a window's surface. The context must have the extensions that surfaces need ([`instance_extensions`],
    /// [`DEVICE_EXTENSIONS`]).
    pub fn new(context: &Context, window: Arc<Window>, vsync: bool) -> Result<Present> {
        let (instance, physical, device, family) = context.handles();
        let display = window.display_handle().map_err(|error| unfit(&error.to_string()))?.as_raw();
        let handle = window.window_handle().map_err(|error| unfit(&error.to_string()))?.as_raw();
        // SAFETY: the context already uses the loader. All handles outlive this value: it holds window, context and loader, and
        // destroys its objects before them.
        unsafe {
            let entry = ash::Entry::load().map_err(|e| Error::NoLoader { reason: e.to_string() })?;
            let surface = ash_window::create_surface(&entry, &instance, display, handle, None)
                .map_err(failed("creating the window's surface"))?;
            let mut present = Present {
                queue: device.get_device_queue(family, 0),
                surfaces: khr::surface::Instance::new(&entry, &instance),
                surface,
                swapchains: khr::swapchain::Device::new(&instance, &device),
                physical,
                swapchain: None,
                stale: true,
                vsync,
                frames: Vec::new(),
                next: 0,
                device,
                window,
                context: context.clone(),
                _entry: entry,
            };
            present.check(&instance, family)?;
            for _ in 0..FRAMES_IN_FLIGHT {
                present.add_frame(family)?;
            }
            Ok(present)
        }
    }

    /// Refuses a device that cannot present to this window.
    fn check(&self, instance: &ash::Instance, family: u32) -> Result<()> {
        let (physical, name) = (self.physical, self.context.device_name());
        // SAFETY: plain queries on live handles.
        let (families, presents, format) = unsafe {
            (
                instance.get_physical_device_queue_family_properties(physical),
                self.surfaces.get_physical_device_surface_support(physical, family, self.surface),
                instance.get_physical_device_format_properties(physical, CANVAS),
            )
        };
        let presents = presents.map_err(failed("vkGetPhysicalDeviceSurfaceSupportKHR"))?;
        let flags = families.get(family as usize).map(|family| family.queue_flags).unwrap_or_default();
        let blits = vk::FormatFeatureFlags::BLIT_SRC | vk::FormatFeatureFlags::BLIT_DST;
        let scales =
            flags.contains(vk::QueueFlags::GRAPHICS) && format.optimal_tiling_features.contains(blits);
        match (presents, scales) {
            (true, true) => Ok(()),
            (false, _) => Err(unfit(&format!(
                "'{name}' cannot show pictures on this display: choose a device that can by --device"
            ))),
            (true, false) => {
                Err(unfit(&format!("the queue of '{name}' cannot scale images (vkCmdBlitImage)")))
            }
        }
    }

    fn add_frame(&mut self, family: u32) -> Result<()> {
        let device = &self.device;
        let mut frame = InFlight {
            pool: vk::CommandPool::null(),
            commands: vk::CommandBuffer::null(),
            acquired: vk::Semaphore::null(),
            done: vk::Fence::null(),
        };
        // SAFETY: valid create infos for this device; existing objects are destroyed with the value.
        let made = unsafe {
            let pool = vk::CommandPoolCreateInfo::default().queue_family_index(family);
            let fence = vk::FenceCreateInfo::default().flags(vk::FenceCreateFlags::SIGNALED);
            device
                .create_command_pool(&pool, None)
                .and_then(|pool| {
                    frame.pool = pool;
                    let info = vk::CommandBufferAllocateInfo::default()
                        .command_pool(pool)
                        .level(vk::CommandBufferLevel::PRIMARY)
                        .command_buffer_count(1);
                    frame.commands =
                        device.allocate_command_buffers(&info)?.first().copied().unwrap_or_default();
                    frame.acquired = device.create_semaphore(&vk::SemaphoreCreateInfo::default(), None)?;
                    frame.done = device.create_fence(&fence, None)?;
                    Ok(())
                })
                .map_err(failed("creating a frame in flight"))
        };
        self.frames.push(frame);
        made
    }

    /// Returns the surface's size, after recreating a swapchain that does not fit. None if there are no pixels: a minimised
    /// window.
    pub fn size(&mut self) -> Result<Option<[u32; 2]>> {
        let size = self.window.inner_size();
        let choice = Choice::of(&self.surfaces, self.physical, self.surface, self.vsync, size.into())?;
        let Some(choice) = choice else { return Ok(None) };
        if self.stale || self.swapchain.as_ref().is_none_or(|old| old.extent != choice.extent) {
            self.idle()?;
            let old = self.swapchain.take();
            // SAFETY: the device is idle, so nothing uses the old one's images and semaphores.
            unsafe {
                let new = Swapchain::new(&self.device, &self.swapchains, self.surface, &choice, old.as_ref());
                if let Some(old) = old {
                    old.destroy(&self.device, &self.swapchains);
                }
                self.swapchain = Some(new?);
            }
            self.stale = false;
        }
        Ok(Some([choice.extent.width, choice.extent.height]))
    }

    /// Waits until the next slot is free. Returns the slot.
    pub fn wait(&self) -> Result<u32> {
        // SAFETY: the fence is alive; it is signalled or its submission runs.
        let waited = unsafe { self.device.wait_for_fences(&[self.frames[self.next].done], true, u64::MAX) };
        waited.map_err(failed("vkWaitForFences"))?;
        Ok(self.next as u32)
    }

    /// True if the last frame submitted in a slot is done.
    pub fn is_done(&self, slot: u32) -> Result<bool> {
        // SAFETY: the fence is alive.
        let done = unsafe { self.device.get_fence_status(self.frames[slot as usize].done) };
        done.map_err(failed("vkGetFenceStatus"))
    }

    pub fn idle(&self) -> Result<()> {
        let _held = self.context.hold_queues()?;
        // SAFETY: the queues are held: no other thread uses them.
        unsafe { self.device.device_wait_idle() }.map_err(failed("vkDeviceWaitIdle"))
    }

    /// Waits for the next slot and begins a frame. None if no image is available.
    pub fn begin(&mut self) -> Result<Option<BegunFrame>> {
        let slot = self.wait()?;
        let Some(swapchain) = &self.swapchain else { return Ok(None) };
        let frame = &self.frames[self.next];
        // SAFETY: the fence of the submission that waited for the semaphore is signalled. No command buffer of the pool is
        // executing.
        unsafe {
            let acquired = self.swapchains.acquire_next_image(
                swapchain.raw,
                LONGEST_WAIT,
                frame.acquired,
                vk::Fence::null(),
            );
            let image = match acquired {
                Ok((image, suboptimal)) => {
                    self.stale |= suboptimal;
                    image
                }
                Err(vk::Result::TIMEOUT | vk::Result::NOT_READY) => return Ok(None),
                Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => {
                    self.stale = true;
                    return Ok(None);
                }
                Err(error) => return Err(failed("vkAcquireNextImageKHR")(error)),
            };
            let begin =
                vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
            self.device
                .reset_command_pool(frame.pool, vk::CommandPoolResetFlags::empty())
                .and_then(|()| self.device.begin_command_buffer(frame.commands, &begin))
                .map_err(failed("vkBeginCommandBuffer"))?;
            Ok(Some(BegunFrame { slot, image }))
        }
    }

    /// The frame's command buffer, for the engine.
    pub fn commands(&self, begun: &BegunFrame) -> Result<ForeignCommands> {
        let commands = self.frames[begun.slot as usize].commands;
        // SAFETY: it is being recorded, outside of a render pass, and `finish` submits it once. `begin` has waited for the
        // fence of the slot's previous recording, and the slots have the same numbers. The host leaves the recorded contents
        // alone until then.
        unsafe { self.context.adopt_commands(commands) }
    }

    /// Copies between images in a frame's command buffer.
    pub fn images<'a>(&'a self, begun: &BegunFrame) -> Images<'a> {
        Images { device: &self.device, commands: self.frames[begun.slot as usize].commands }
    }

    /// Copies the picture to the window's image, submits the frame and presents it. The picture has the surface's size.
    pub fn finish(&mut self, begun: BegunFrame, picture: &Image, used: ImageState) -> Result<()> {
        let Some(swapchain) = &self.swapchain else { return Ok(()) };
        let (image, presented) = swapchain.images[begun.image as usize];
        let images = self.images(&begun);
        let frame = &self.frames[begun.slot as usize];
        let extent = [swapchain.extent.width, swapchain.extent.height];
        images.show(picture, used, image, extent);
        let transfer = vk::PipelineStageFlags2::ALL_TRANSFER;
        let waits = [vk::SemaphoreSubmitInfo::default().semaphore(frame.acquired).stage_mask(transfer)];
        let everything = vk::PipelineStageFlags2::ALL_COMMANDS;
        let signals = [vk::SemaphoreSubmitInfo::default().semaphore(presented).stage_mask(everything)];
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(frame.commands)];
        let submits = [vk::SubmitInfo2::default()
            .wait_semaphore_infos(&waits)
            .command_buffer_infos(&buffers)
            .signal_semaphore_infos(&signals)];
        let (semaphores, raw, indices) = ([presented], [swapchain.raw], [begun.image]);
        let info = vk::PresentInfoKHR::default()
            .wait_semaphores(&semaphores)
            .swapchains(&raw)
            .image_indices(&indices);
        let held = self.context.hold_queues()?;
        // SAFETY: recorded since `begin`; the fence is signalled and nobody waits for it; the queues are held, so no other
        // thread uses them.
        let shown = unsafe {
            self.device.end_command_buffer(frame.commands).map_err(failed("vkEndCommandBuffer"))?;
            self.device.reset_fences(&[frame.done]).map_err(failed("vkResetFences"))?;
            self.device.queue_submit2(self.queue, &submits, frame.done).map_err(failed("vkQueueSubmit2"))?;
            self.swapchains.queue_present(self.queue, &info)
        };
        drop(held);
        self.next = (self.next + 1) % self.frames.len();
        match shown {
            Ok(suboptimal) => self.stale |= suboptimal,
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => self.stale = true,
            Err(error) => return Err(failed("vkQueuePresentKHR")(error)),
        }
        Ok(())
    }
}

impl Drop for Present {
    fn drop(&mut self) {
        // Waiting fails only for a lost device, which needs no wait.
        self.idle().ok();
        // SAFETY: the device is idle; null handles are allowed; the surface goes after its swapchain.
        unsafe {
            for frame in &self.frames {
                self.device.destroy_fence(frame.done, None);
                self.device.destroy_semaphore(frame.acquired, None);
                self.device.destroy_command_pool(frame.pool, None);
            }
            if let Some(swapchain) = self.swapchain.take() {
                swapchain.destroy(&self.device, &self.swapchains);
            }
            self.surfaces.destroy_surface(self.surface, None);
        }
    }
}
