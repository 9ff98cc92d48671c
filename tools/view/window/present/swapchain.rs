//! The images of a window, and their choice.

use super::choice::{extent, format, mode};
use super::{failed, unfit};
use ashsplat::Result;
use ashsplat::ash::{self, khr, vk};

/// Format of the displayed pictures, one that the engine writes.
pub const CANVAS: vk::Format = vk::Format::R8G8B8A8_UNORM;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    pub format: vk::Format,
    pub extent: vk::Extent2D,
    pub mode: vk::PresentModeKHR,
    images: u32,
    transform: vk::SurfaceTransformFlagsKHR,
    alpha: vk::CompositeAlphaFlagsKHR,
}

impl Choice {
    /// Chooses parameters for the surface of a window of this size; none if it has no pixels.
    pub fn of(
        surfaces: &khr::surface::Instance,
        physical: vk::PhysicalDevice,
        surface: vk::SurfaceKHR,
        vsync: bool,
        window: [u32; 2],
    ) -> Result<Option<Choice>> {
        // SAFETY: plain queries on live handles.
        let (can, formats, modes) = unsafe {
            (
                surfaces.get_physical_device_surface_capabilities(physical, surface),
                surfaces.get_physical_device_surface_formats(physical, surface),
                surfaces.get_physical_device_surface_present_modes(physical, surface),
            )
        };
        let can = can.map_err(failed("vkGetPhysicalDeviceSurfaceCapabilitiesKHR"))?;
        let formats = formats.map_err(failed("vkGetPhysicalDeviceSurfaceFormatsKHR"))?;
        let modes = modes.map_err(failed("vkGetPhysicalDeviceSurfacePresentModesKHR"))?;
        let extent = extent(&can, window);
        if extent.width == 0 || extent.height == 0 {
            return Ok(None);
        }
        if !can.supported_usage_flags.contains(vk::ImageUsageFlags::TRANSFER_DST) {
            return Err(unfit("nothing can be copied to images of this display"));
        }
        let format =
            format(&formats).ok_or_else(|| unfit("this display has no 8-bit format without a curve"))?;
        let max = if can.max_image_count == 0 { u32::MAX } else { can.max_image_count };
        let opaque = vk::CompositeAlphaFlagsKHR::OPAQUE;
        let lowest = can.supported_composite_alpha.as_raw();
        let lowest = vk::CompositeAlphaFlagsKHR::from_raw(lowest & lowest.wrapping_neg());
        Ok(Some(Choice {
            format,
            extent,
            mode: mode(&modes, vsync),
            images: (can.min_image_count + 1).min(max),
            transform: can.current_transform,
            alpha: if can.supported_composite_alpha.contains(opaque) { opaque } else { lowest },
        }))
    }
}

/// The images that a window shows in turn.
pub struct Swapchain {
    pub raw: vk::SwapchainKHR,
    pub extent: vk::Extent2D,
    /// Images with the semaphore that each presentation waits for: it is free again when its image is.
    pub images: Vec<(vk::Image, vk::Semaphore)>,
}

impl Swapchain {
    /// Replaces an old swapchain, if there is one.
    ///
    /// # Safety
    /// Device, surface and the old one are alive and belong together; the device supports presentation to the surface.
    pub unsafe fn new(
        device: &ash::Device,
        loader: &khr::swapchain::Device,
        surface: vk::SurfaceKHR,
        choice: &Choice,
        old: Option<&Swapchain>,
    ) -> Result<Swapchain> {
        let info = vk::SwapchainCreateInfoKHR::default()
            .surface(surface)
            .min_image_count(choice.images)
            .image_format(choice.format)
            .image_color_space(vk::ColorSpaceKHR::SRGB_NONLINEAR)
            .image_extent(choice.extent)
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::TRANSFER_DST)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(choice.transform)
            .composite_alpha(choice.alpha)
            .present_mode(choice.mode)
            .clipped(true)
            .old_swapchain(old.map_or(vk::SwapchainKHR::null(), |old| old.raw));
        // SAFETY: as promised; on failure, objects made so far are destroyed.
        unsafe {
            let raw = loader.create_swapchain(&info, None).map_err(failed("vkCreateSwapchainKHR"))?;
            let mut swapchain = Swapchain { raw, extent: choice.extent, images: Vec::new() };
            let filled = loader.get_swapchain_images(raw).and_then(|images| {
                for image in images {
                    let semaphore = device.create_semaphore(&vk::SemaphoreCreateInfo::default(), None)?;
                    swapchain.images.push((image, semaphore));
                }
                Ok(())
            });
            match filled {
                Ok(()) => Ok(swapchain),
                Err(error) => {
                    swapchain.destroy(device, loader);
                    Err(failed("vkGetSwapchainImagesKHR")(error))
                }
            }
        }
    }

    /// # Safety
    /// Nothing uses its images and semaphores any more.
    pub unsafe fn destroy(self, device: &ash::Device, loader: &khr::swapchain::Device) {
        // SAFETY: as promised.
        unsafe {
            self.images.iter().for_each(|(_, semaphore)| device.destroy_semaphore(*semaphore, None));
            loader.destroy_swapchain(self.raw, None);
        }
    }
}
