//! Two-dimensional images: a host's, or our own.

use super::context::Context;
use super::debug::vk_error;
use super::format::{ImageKind, ImageUse, aspect, has_stencil, texel_bytes};
use super::memory::{Buffer, NEXT_ID};
use super::memory_types::MemoryKind;
use super::open_device::Device;
use crate::error::{Error, Result};
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

impl ForeignImage {
    /// Its mip level and array layer, with the aspect that kernels see.
    fn range(&self) -> vk::ImageSubresourceRange {
        vk::ImageSubresourceRange {
            aspect_mask: aspect(self.format),
            base_mip_level: self.mip_level,
            level_count: 1,
            base_array_layer: self.layer,
            layer_count: 1,
        }
    }
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
    of: ForeignImage,
    view: vk::ImageView,
    /// Null if the image is a host's.
    memory: vk::DeviceMemory,
    bytes: u64,
    purpose: ImageUse,
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
            let ([width, height], max) = (foreign.size, context.limits().max_image_side);
            return bad(format!("its size is {width} x {height}, each must be from 1 to {max}"));
        }
        match foreign.samples.as_raw() {
            1 => {}
            0 => return bad("samples is 0: say how many samples per pixel it has, 1 for most".into()),
            samples => {
                return bad(format!(
                    "it has {samples} samples per pixel, kernels see images of one: resolve it into such an image, \
                     and give that"
                ));
            }
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
        let mut usage = vk::ImageViewUsageCreateInfo::default().usage(purpose.kind().usage());
        let info = vk::ImageViewCreateInfo::default()
            .image(foreign.image)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(purpose.seen_as(foreign.format))
            .subresource_range(foreign.range())
            .push_next(&mut usage);
        let inner = context.device.clone();
        // SAFETY: the image is alive and of this device, with this format and usage.
        let view = unsafe { inner.device.create_image_view(&info, None) };
        let view = view.map_err(vk_error("vkCreateImageView"))?;
        inner.names.name(view, name);
        let id = NEXT_ID.fetch_add(1, Ordering::Relaxed);
        if bytes > 0 {
            inner.registry.add(ARENA, bytes, MemoryKind::Device);
        }
        let view = View { inner, of: *foreign, view, memory, bytes, purpose, name, id };
        Ok(Self(Arc::new(view), vk::QUEUE_FAMILY_IGNORED))
    }

    /// Its name in messages.
    pub fn name(&self) -> &'static str {
        self.0.name
    }

    /// Width and height, pixels.
    pub fn size(&self) -> [u32; 2] {
        self.0.of.size
    }

    /// Its format at creation.
    pub fn format(&self) -> vk::Format {
        self.0.of.format
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
        let is_attachment = self.0.of.usage.contains(vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT);
        match self.0.purpose.kind() {
            ImageKind::Storage => vk::ImageLayout::GENERAL,
            // The host may still test depth against it.
            ImageKind::Sampled if is_attachment => vk::ImageLayout::DEPTH_STENCIL_READ_ONLY_OPTIMAL,
            ImageKind::Sampled => vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
        }
    }

    /// The Vulkan image, for a host's commands.
    pub fn handle(&self) -> vk::Image {
        self.0.of.image
    }

    /// True if it belongs to this context's device.
    pub fn belongs_to(&self, context: &Context) -> bool {
        self.is_of(&context.device)
    }

    pub(super) fn is_of(&self, inner: &Arc<Device>) -> bool {
        Arc::ptr_eq(&self.0.inner, inner)
    }

    pub(crate) fn is_same_as(&self, other: &Self) -> bool {
        let place = |of: &ForeignImage| (of.image, of.mip_level, of.layer);
        place(&self.0.of) == place(&other.0.of)
    }

    pub(super) fn id(&self) -> u64 {
        self.0.id
    }

    pub(super) fn descriptor(&self) -> vk::DescriptorImageInfo {
        vk::DescriptorImageInfo::default().image_view(self.0.view).image_layout(self.layout())
    }
}

impl std::fmt::Debug for Image {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [width, height] = self.size();
        write!(f, "Image('{}', {:?}, {width} x {height})", self.0.name, self.format())
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
                device.destroy_image(self.of.image, None);
                device.free_memory(self.memory, None);
                self.inner.registry.remove(ARENA, self.bytes, MemoryKind::Device);
            }
        }
    }
}

impl Context {
    /// Returns the flags that an image needs so that kernels see its texels.
    fn flags_for(&self, format: vk::Format, purpose: ImageUse) -> vk::ImageCreateFlags {
        type Flags = vk::ImageCreateFlags;
        match (purpose.seen_as(format) == format, self.supports(format, purpose)) {
            (true, _) => Flags::empty(),
            (false, true) => Flags::MUTABLE_FORMAT,
            (false, false) => Flags::MUTABLE_FORMAT | Flags::EXTENDED_USAGE,
        }
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
    fn whole_range(&self) -> vk::ImageSubresourceRange {
        let mut range = self.0.of.range();
        if has_stencil(self.format()) {
            range.aspect_mask |= vk::ImageAspectFlags::STENCIL;
        }
        range
    }

    pub(super) fn copy_region(&self, buffer: &Buffer) -> vk::BufferImageCopy {
        let [width, height] = self.size();
        let bytes = u64::from(width) * u64::from(height) * texel_bytes(self.format());
        assert!(bytes <= buffer.bytes(), "copy: {buffer:?} is smaller than {self:?}, {bytes} bytes");
        let of = &self.0.of;
        let layers = vk::ImageSubresourceLayers {
            aspect_mask: aspect(of.format),
            mip_level: of.mip_level,
            base_array_layer: of.layer,
            layer_count: 1,
        };
        vk::BufferImageCopy::default()
            .buffer_offset(buffer.offset())
            .image_subresource(layers)
            .image_extent(vk::Extent3D { width, height, depth: 1 })
    }
}

// Images that another queue family owns between recordings: for example, an asynchronous queue renders them and the graphics
// queue shows them.
//
// A transfer of ownership has two halves, one in a queue of each family, ordered by a semaphore. The guest records its own
// half; [`Image::hand_over`] and [`Image::take_back`] return the host's.

const EVERYTHING: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::ALL_COMMANDS;

impl Image {
    /// Returns the same image, owned by another queue family between recordings. Each recording acquires it from that
    /// family, by a barrier that matches [`Image::hand_over`], and releases it to that family at its end.
    ///
    /// From [`ImageState::UNDEFINED`] the contents are discarded, and the image is not acquired: the host does not hand it
    /// over then. It is released in any case.
    ///
    /// # Errors
    /// [`Error::Argument`] for a family that the device does not have.
    pub fn of_family(self, queue_family: u32) -> Result<Self> {
        let families = self.0.inner.queue_families().len();
        if queue_family as usize >= families {
            let problem = format!("queue family {queue_family}, the device has {families}");
            return Err(Error::argument(format!("image '{}'", self.name()), problem));
        }
        Ok(Self(self.0, queue_family))
    }

    /// Returns the barrier that hands the image over to a recording with the same
    /// [`HostImage::from`](crate::HostImage::from). The host records it in a queue of the image's family, after the image's
    /// use `from`. The recording's submission waits for that queue's submission by a semaphore, in all stages. If another
    /// family owns the image, the barrier changes the layout as the recording does; otherwise it keeps the layout.
    pub fn hand_over(&self, from: ImageState) -> vk::ImageMemoryBarrier2<'static> {
        let barrier = self.barrier(from.layout, [self.1, self.0.inner.queue_family]);
        let to = if self.is_elsewhere() { self.layout() } else { from.layout };
        barrier.new_layout(to).src_stage_mask(from.stages).src_access_mask(from.accesses)
    }

    /// Returns the barrier that takes the image back after a recording. The host records it in a queue of the image's
    /// family, whose submission waits for the recording's by a semaphore, in all stages. The image then has
    /// [`Image::layout`], and its last use is that of the [`Release`](crate::Release).
    pub fn take_back(&self) -> vk::ImageMemoryBarrier2<'static> {
        let all = vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE;
        let barrier = self.barrier(self.layout(), [self.0.inner.queue_family, self.1]);
        // The other family's release has already made the writes available.
        let written = match self.is_elsewhere() {
            true => vk::AccessFlags2::NONE,
            false => vk::AccessFlags2::SHADER_STORAGE_WRITE,
        };
        let barrier = barrier.src_stage_mask(EVERYTHING).src_access_mask(written);
        barrier.dst_stage_mask(EVERYTHING).dst_access_mask(all)
    }

    /// Returns a barrier into the kernels' layout, from one family to another.
    pub(super) fn barrier(
        &self,
        from: vk::ImageLayout,
        [owner, next]: [u32; 2],
    ) -> vk::ImageMemoryBarrier2<'static> {
        let [owner, next] = if self.is_elsewhere() { [owner, next] } else { [vk::QUEUE_FAMILY_IGNORED; 2] };
        vk::ImageMemoryBarrier2::default()
            .old_layout(from)
            .new_layout(self.layout())
            .src_queue_family_index(owner)
            .dst_queue_family_index(next)
            .image(self.handle())
            .subresource_range(self.whole_range())
    }

    fn is_elsewhere(&self) -> bool {
        self.1 != vk::QUEUE_FAMILY_IGNORED && self.1 != self.0.inner.queue_family
    }

    /// Returns the family that owns it between recordings, if that is not the context's.
    pub(crate) fn other_family(&self) -> Option<u32> {
        self.is_elsewhere().then_some(self.1)
    }

    /// Returns the guest's half of [`Image::hand_over`] if another family owns the image. If the contents are discarded, it
    /// only changes the layout.
    pub(super) fn acquisition(&self, from: ImageState) -> Option<vk::ImageMemoryBarrier2<'static>> {
        if !self.is_elsewhere() {
            return None;
        }
        let families = match from.layout {
            vk::ImageLayout::UNDEFINED => [vk::QUEUE_FAMILY_IGNORED; 2],
            _ => [self.1, self.0.inner.queue_family],
        };
        // This queue may lack the stages of the other queue. The semaphore is waited for in all stages.
        Some(self.barrier(from.layout, families).src_stage_mask(EVERYTHING))
    }

    /// Returns the image's last use after a recording that leaves it in the state `used`.
    pub(crate) fn left(&self, used: ImageState) -> ImageState {
        match self.is_elsewhere() {
            true => ImageState { stages: EVERYTHING, accesses: vk::AccessFlags2::NONE, ..used },
            false => used,
        }
    }
}
