//! Two-dimensional images: a host's, or our own.

use super::allocator::MemoryKind;
use super::buffer::Buffer;
use super::context::Context;
use super::debug::vk_error;
use super::format::{ImageKind, ImageUse, aspect, has_stencil, texel_bytes};
use super::memory::NEXT_ID;
use super::open_device::Device;
use crate::{Error, Result};
use ash::vk;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Arena of own images, in [`Context::memory`].
const ARENA: &str = "images";

/// A host's image, as it was created.
#[derive(Clone, Copy, Debug)]
pub struct ForeignImage {
    /// The image: two-dimensional, optimal tiling.
    pub image: vk::Image,
    /// Its format.
    pub format: vk::Format,
    /// Its flags. Kernels see the texels of some formats in another format ([`ImageUse::seen_as`]). Such an image needs
    /// MUTABLE_FORMAT, and EXTENDED_USAGE if its own format cannot be a storage image on the device. If it was created with
    /// a list of formats, the list contains the other format.
    pub flags: vk::ImageCreateFlags,
    /// Its usage.
    pub usage: vk::ImageUsageFlags,
    /// Its samples per pixel; kernels require one. A host that draws with more resolves them first: depth into a depth
    /// image of one sample, by `resolve_mode` MIN, MAX or SAMPLE_ZERO of its attachment.
    pub samples: vk::SampleCountFlags,
    /// Width and height of the mip level, pixels.
    pub size: [u32; 2],
    /// Index of the mip level.
    pub mip_level: u32,
    /// Index of the array layer.
    pub layer: u32,
}

/// Use of an image at a point in a command buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageState {
    /// Its layout.
    pub layout: vk::ImageLayout,
    /// Stages that use it.
    pub stages: vk::PipelineStageFlags2,
    /// Accesses of these stages.
    pub accesses: vk::AccessFlags2,
}

impl ImageState {
    /// Its contents are discarded, and it has no earlier use.
    pub const UNDEFINED: Self = Self {
        layout: vk::ImageLayout::UNDEFINED,
        stages: vk::PipelineStageFlags2::NONE,
        accesses: vk::AccessFlags2::NONE,
    };
}

/// A view of one level and layer of an image. Clones share it.
#[derive(Clone)]
pub struct Image(
    Arc<View>,
    /// Queue family that owns it between recordings: see [`Image::of_family`].
    pub(super) u32,
);

struct View {
    inner: Arc<Device>,
    image: vk::Image,
    view: vk::ImageView,
    /// Null if the image is a host's.
    memory: vk::DeviceMemory,
    bytes: u64,
    format: vk::Format,
    size: [u32; 2],
    range: vk::ImageSubresourceRange,
    purpose: ImageUse,
    is_attachment: bool,
    name: &'static str,
    id: u64,
}

impl Image {
    /// A view of a host's image, for kernels.
    ///
    /// # Errors
    /// [`Error::Argument`] for:
    /// - a null handle, no size, or one above maxImageDimension2D;
    /// - more than one sample per pixel;
    /// - a usage that lacks what `purpose` needs;
    /// - a format that is not one of [`ImageUse::formats`] or that the device does not support;
    /// - flags that lack what the format needs ([`ForeignImage::flags`]).
    ///
    /// # Safety
    /// - the image belongs to the context's device, was created as `foreign` describes and is bound to memory;
    /// - it lives until the last recording that uses it has finished, and this view and its clones are dropped;
    /// - recordings use it while the context's queue family owns it, or the family named by [`Image::of_family`], or it was
    ///   created for concurrent use.
    pub unsafe fn adopt(
        context: &Context,
        name: &'static str,
        foreign: &ForeignImage,
        purpose: ImageUse,
    ) -> Result<Self> {
        let bad = |problem: String| Err(Error::argument(format!("image '{name}'"), problem));
        if foreign.image == vk::Image::null() {
            return bad("the handle is null".into());
        }
        if !context.has_images_of(foreign.size) {
            let ([width, height], most) = (foreign.size, context.limits().max_image_side);
            return bad(format!("its size is {width} x {height}, each must be from 1 to {most}"));
        }
        if foreign.samples != vk::SampleCountFlags::TYPE_1 {
            let samples = foreign.samples.as_raw();
            if samples == 0 {
                return bad("samples is 0: say how many samples per pixel it has, 1 for most".into());
            }
            return bad(format!(
                "it has {samples} samples per pixel, kernels see images of one: resolve it into such an image, and give that"
            ));
        }
        if !foreign.usage.contains(purpose.kind().usage()) {
            return bad(format!("its usage '{:?}' lacks {:?}", foreign.usage, purpose.kind().usage()));
        }
        let (format, possible) = (foreign.format, purpose.formats());
        if !possible.contains(&format) {
            return bad(format!("its format {format:?} is not one of {possible:?}"));
        }
        let seen = purpose.seen_as(format);
        if !context.supports(seen, purpose) {
            return bad(format!("the device cannot use format {seen:?} as {purpose:?}"));
        }
        let needed = context.flags_for(format, purpose);
        if !foreign.flags.contains(needed) {
            let missing = needed & !foreign.flags;
            return bad(format!(
                "its flags lack {missing:?}: kernels see the texels of {format:?} as {seen:?}"
            ));
        }
        Self::view(context, name, foreign, (vk::DeviceMemory::null(), 0), purpose)
    }

    /// Creates an image of our own.
    ///
    /// # Errors
    /// Same as [`Image::adopt`]; [`Error::Vulkan`] when the memory does not suffice.
    pub fn new(
        context: &Context,
        name: &'static str,
        format: vk::Format,
        size: [u32; 2],
        purpose: ImageUse,
    ) -> Result<Self> {
        let possible = purpose.formats().contains(&format) && context.has_images_of(size);
        if !possible || !context.supports(purpose.seen_as(format), purpose) {
            let problem = format!("{format:?} of {} x {} is not possible as {purpose:?}", size[0], size[1]);
            return Err(Error::argument(format!("image '{name}'"), problem));
        }
        let transfer = vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST;
        let usage = purpose.kind().usage() | transfer;
        let flags = context.flags_for(format, purpose);
        let info = vk::ImageCreateInfo::default()
            .flags(flags)
            .image_type(vk::ImageType::TYPE_2D)
            .format(format)
            .extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(usage);
        let device = &context.device.device;
        // SAFETY: a valid create info; the image is bound once to memory of its own, and both are given to the view,
        // or destroyed where that fails.
        unsafe {
            let image = device.create_image(&info, None).map_err(vk_error("vkCreateImage"))?;
            let memory = context.image_memory(image).inspect_err(|_| device.destroy_image(image, None))?;
            let samples = vk::SampleCountFlags::TYPE_1;
            let foreign = ForeignImage { image, format, flags, usage, samples, size, mip_level: 0, layer: 0 };
            Self::view(context, name, &foreign, memory, purpose).inspect_err(|_| {
                device.destroy_image(image, None);
                device.free_memory(memory.0, None);
            })
        }
    }

    fn view(
        context: &Context,
        name: &'static str,
        foreign: &ForeignImage,
        (memory, bytes): (vk::DeviceMemory, u64),
        purpose: ImageUse,
    ) -> Result<Self> {
        let range = vk::ImageSubresourceRange {
            aspect_mask: aspect(foreign.format),
            base_mip_level: foreign.mip_level,
            level_count: 1,
            base_array_layer: foreign.layer,
            layer_count: 1,
        };
        let mut usage = vk::ImageViewUsageCreateInfo::default().usage(purpose.kind().usage());
        let info = vk::ImageViewCreateInfo::default()
            .image(foreign.image)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(purpose.seen_as(foreign.format))
            .subresource_range(range)
            .push_next(&mut usage);
        let inner = context.device.clone();
        // SAFETY: the image is alive and of this device, with this format and usage.
        let view = unsafe { inner.device.create_image_view(&info, None) };
        let view = view.map_err(vk_error("vkCreateImageView"))?;
        inner.names.name(view, name);
        let id = NEXT_ID.fetch_add(1, Ordering::Relaxed);
        if bytes > 0 {
            inner.registry.add(&ARENA.into(), bytes, MemoryKind::Device);
        }
        let view = View {
            inner,
            image: foreign.image,
            view,
            memory,
            bytes,
            format: foreign.format,
            size: foreign.size,
            range,
            purpose,
            is_attachment: foreign.usage.contains(vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT),
            name,
            id,
        };
        Ok(Self(Arc::new(view), vk::QUEUE_FAMILY_IGNORED))
    }

    /// Its name in messages.
    pub fn name(&self) -> &'static str {
        self.0.name
    }

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        self.0.size
    }

    /// Its format at creation.
    pub fn format(&self) -> vk::Format {
        self.0.format
    }

    /// The use that it was made for.
    pub fn purpose(&self) -> ImageUse {
        self.0.purpose
    }

    /// Returns an error for an image that was adopted for another purpose.
    pub(crate) fn check_purpose(&self, purpose: ImageUse) -> Result<()> {
        if self.purpose() == purpose {
            return Ok(());
        }
        let problem = format!("it was adopted for {:?}, not for {purpose:?}", self.purpose());
        Err(Error::argument(format!("image '{}'", self.name()), problem))
    }

    /// Returns the layout that kernels require.
    pub fn layout(&self) -> vk::ImageLayout {
        match self.0.purpose.kind() {
            ImageKind::Storage => vk::ImageLayout::GENERAL,
            // The host may still test depth against it.
            ImageKind::Sampled if self.0.is_attachment => vk::ImageLayout::DEPTH_STENCIL_READ_ONLY_OPTIMAL,
            ImageKind::Sampled => vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
        }
    }

    /// The Vulkan image, for a host's commands.
    pub fn handle(&self) -> vk::Image {
        self.raw()
    }

    /// True if it belongs to this context's device.
    pub fn belongs_to(&self, context: &Context) -> bool {
        self.is_of(&context.device)
    }

    pub(super) fn is_of(&self, inner: &Arc<Device>) -> bool {
        Arc::ptr_eq(&self.0.inner, inner)
    }

    pub(super) fn device(&self) -> &Device {
        &self.0.inner
    }

    /// True if both are views of the same texels.
    pub(crate) fn is_same_as(&self, other: &Self) -> bool {
        let place = |view: &View| (view.image, view.range.base_mip_level, view.range.base_array_layer);
        place(&self.0) == place(&other.0)
    }

    pub(super) fn id(&self) -> u64 {
        self.0.id
    }

    pub(super) fn raw(&self) -> vk::Image {
        self.0.image
    }

    pub(super) fn descriptor(&self) -> vk::DescriptorImageInfo {
        vk::DescriptorImageInfo::default().image_view(self.0.view).image_layout(self.layout())
    }
}

impl std::fmt::Debug for Image {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [width, height] = self.0.size;
        write!(f, "Image('{}', {:?}, {width} x {height})", self.0.name, self.0.format)
    }
}

impl Drop for View {
    fn drop(&mut self) {
        let device = &self.inner.device;
        // SAFETY: recordings and slots hold the view until they are done with it; the image itself is destroyed only
        // where it is ours.
        unsafe {
            device.destroy_image_view(self.view, None);
            if self.memory != vk::DeviceMemory::null() {
                device.destroy_image(self.image, None);
                device.free_memory(self.memory, None);
                self.inner.registry.remove(&ARENA.into(), self.bytes, MemoryKind::Device);
            }
        }
    }
}

impl Context {
    /// Returns the flags that an image needs so that kernels see its texels.
    fn flags_for(&self, format: vk::Format, purpose: ImageUse) -> vk::ImageCreateFlags {
        let mut flags = vk::ImageCreateFlags::empty();
        if purpose.seen_as(format) != format {
            flags |= vk::ImageCreateFlags::MUTABLE_FORMAT;
            if !self.supports(format, purpose) {
                flags |= vk::ImageCreateFlags::EXTENDED_USAGE;
            }
        }
        flags
    }

    fn has_images_of(&self, size: [u32; 2]) -> bool {
        let sides = 1..=self.limits().max_image_side;
        size.iter().all(|side| sides.contains(side))
    }

    fn supports(&self, format: vk::Format, purpose: ImageUse) -> bool {
        let (instance, physical) = (self.device.owner.instance(), self.device.physical);
        // SAFETY: a plain query.
        let has = unsafe { instance.get_physical_device_format_properties(physical, format) };
        has.optimal_tiling_features.contains(purpose.kind().feature())
    }

    /// Allocates memory for an image and binds it. Returns the memory and its bytes.
    fn image_memory(&self, image: vk::Image) -> Result<(vk::DeviceMemory, u64)> {
        let device = &self.device.device;
        // SAFETY: the image is of this device and not bound yet; memory that cannot be bound is freed.
        unsafe {
            let needs = device.get_image_memory_requirements(image);
            let memory_type_index = self.device.memory_type(needs.memory_type_bits, MemoryKind::Device)?;
            let info = vk::MemoryAllocateInfo::default()
                .allocation_size(needs.size)
                .memory_type_index(memory_type_index);
            let memory = device.allocate_memory(&info, None).map_err(vk_error("vkAllocateMemory"))?;
            device.bind_image_memory(image, memory, 0).map_err(|error| {
                device.free_memory(memory, None);
                vk_error("vkBindImageMemory")(error)
            })?;
            Ok((memory, needs.size))
        }
    }
}

impl Image {
    /// Returns the range including the stencil, whose layout changes together with the depth's.
    pub(super) fn whole_range(&self) -> vk::ImageSubresourceRange {
        let mut range = self.0.range;
        if has_stencil(self.0.format) {
            range.aspect_mask |= vk::ImageAspectFlags::STENCIL;
        }
        range
    }

    pub(super) fn copy_region(&self, buffer: &Buffer) -> vk::BufferImageCopy {
        let [width, height] = self.0.size;
        let bytes = u64::from(width) * u64::from(height) * texel_bytes(self.0.format);
        assert!(bytes <= buffer.bytes(), "copy: {buffer:?} is smaller than {self:?}, {bytes} bytes");
        let range = self.0.range;
        vk::BufferImageCopy::default()
            .buffer_offset(buffer.offset())
            .image_subresource(vk::ImageSubresourceLayers {
                aspect_mask: range.aspect_mask,
                mip_level: range.base_mip_level,
                base_array_layer: range.base_array_layer,
                layer_count: 1,
            })
            .image_extent(vk::Extent3D { width, height, depth: 1 })
    }
}
