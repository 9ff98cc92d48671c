//! The host's images and buffers.

use super::host::{Host, Result};
use ashsplat::ash::vk;
use ashsplat::vk::{ForeignImage, ImageUse};

const STORAGE: vk::ImageUsageFlags = vk::ImageUsageFlags::STORAGE;

pub struct HostTexture {
    pub image: vk::Image,
    pub view: vk::ImageView,
    pub format: vk::Format,
    pub flags: vk::ImageCreateFlags,
    pub usage: vk::ImageUsageFlags,
    pub size: [u32; 2],
    pub aspect: vk::ImageAspectFlags,
    memory: vk::DeviceMemory,
}

impl HostTexture {
    pub fn new(host: &Host, format: vk::Format, usage: vk::ImageUsageFlags, size: [u32; 2]) -> Result<Self> {
        let depth = format == vk::Format::D32_SFLOAT || format == vk::Format::D16_UNORM;
        let aspect = if depth { vk::ImageAspectFlags::DEPTH } else { vk::ImageAspectFlags::COLOR };
        // The guest views some formats' texels in another format.
        let flags = match ImageUse::Target.seen_as(format) != format && usage.contains(STORAGE) {
            true => vk::ImageCreateFlags::MUTABLE_FORMAT | vk::ImageCreateFlags::EXTENDED_USAGE,
            false => vk::ImageCreateFlags::empty(),
        };
        let info = vk::ImageCreateInfo::default()
            .flags(flags)
            .image_type(vk::ImageType::TYPE_2D)
            .format(format)
            .extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(usage);
        // SAFETY: valid create infos; the image is bound to its own memory.
        unsafe {
            let image = host.device.create_image(&info, None)?;
            let needs = host.device.get_image_memory_requirements(image);
            let memory = host.allocate(needs, vk::MemoryPropertyFlags::empty())?;
            host.device.bind_image_memory(image, memory, 0)?;
            // The host's own view: such a format need not support storage.
            let seen = if flags.is_empty() { usage } else { usage & !STORAGE };
            let mut seen = vk::ImageViewUsageCreateInfo::default().usage(seen);
            let info = vk::ImageViewCreateInfo::default()
                .image(image)
                .view_type(vk::ImageViewType::TYPE_2D)
                .format(format)
                .subresource_range(whole(aspect))
                .push_next(&mut seen);
            let view = host.device.create_image_view(&info, None)?;
            Ok(Self { image, view, format, flags, usage, size, aspect, memory })
        }
    }

    pub fn foreign(&self) -> ForeignImage {
        let Self { image, format, flags, usage, size, .. } = *self;
        let samples = vk::SampleCountFlags::TYPE_1;
        ForeignImage { image, format, flags, usage, samples, size, mip_level: 0, layer: 0 }
    }

    pub fn barrier(&self, host: &Host, commands: vk::CommandBuffer, from: Use, to: Use) {
        let barriers = [vk::ImageMemoryBarrier2::default()
            .src_stage_mask(from.1)
            .src_access_mask(from.2)
            .dst_stage_mask(to.1)
            .dst_access_mask(to.2)
            .old_layout(from.0)
            .new_layout(to.0)
            .image(self.image)
            .subresource_range(whole(self.aspect))];
        let dependency = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        // SAFETY: recording state.
        unsafe { host.device.cmd_pipeline_barrier2(commands, &dependency) }
    }

    /// The region of a copy of the whole image.
    pub fn region(&self) -> vk::BufferImageCopy {
        let layers =
            vk::ImageSubresourceLayers { aspect_mask: self.aspect, layer_count: 1, ..Default::default() };
        let [width, height] = self.size;
        let image_extent = vk::Extent3D { width, height, depth: 1 };
        vk::BufferImageCopy { image_subresource: layers, image_extent, ..Default::default() }
    }

    /// Records a copy into a buffer of the image's size, and makes it visible to the host. Returns the image's new use.
    pub fn record_read(&self, host: &Host, commands: vk::CommandBuffer, from: Use, to: &HostBuffer) -> Use {
        let read = (
            vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
            vk::PipelineStageFlags2::ALL_TRANSFER,
            vk::AccessFlags2::TRANSFER_READ,
        );
        self.barrier(host, commands, from, read);
        // SAFETY: recording state; the buffer holds the image.
        unsafe {
            host.device.cmd_copy_image_to_buffer(commands, self.image, read.0, to.raw, &[self.region()]);
        }
        to.to_host(host, commands);
        read
    }

    pub fn destroy(self, host: &Host) {
        // SAFETY: no longer in use.
        unsafe {
            host.device.destroy_image_view(self.view, None);
            host.device.destroy_image(self.image, None);
            host.device.free_memory(self.memory, None);
        }
    }
}

/// All of an image with one level and one layer.
fn whole(aspect_mask: vk::ImageAspectFlags) -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange { aspect_mask, level_count: 1, layer_count: 1, ..Default::default() }
}

/// Layout, stages and accesses of an image at some point.
pub type Use = (vk::ImageLayout, vk::PipelineStageFlags2, vk::AccessFlags2);

pub struct HostBuffer {
    pub raw: vk::Buffer,
    memory: vk::DeviceMemory,
}

impl HostBuffer {
    pub fn new(host: &Host, bytes: u64) -> Result<Self> {
        let usage = vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST
            | vk::BufferUsageFlags::STORAGE_BUFFER;
        let info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        // SAFETY: a valid create info; bound to its own memory.
        unsafe {
            let raw = host.device.create_buffer(&info, None)?;
            let needs = host.device.get_buffer_memory_requirements(raw);
            let flags = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
            let memory = host.allocate(needs, flags)?;
            host.device.bind_buffer_memory(raw, memory, 0)?;
            Ok(Self { raw, memory })
        }
    }

    /// Records a barrier that makes writes of transfers and shaders visible to the host.
    pub fn to_host(&self, host: &Host, commands: vk::CommandBuffer) {
        let barriers = [vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::HOST)
            .dst_access_mask(vk::AccessFlags2::HOST_READ)];
        let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: recording state.
        unsafe { host.device.cmd_pipeline_barrier2(commands, &dependency) }
    }

    pub fn write(&self, host: &Host, bytes: &[u8]) -> Result<()> {
        // SAFETY: the memory is large enough for the bytes, and not in use.
        self.mapped(host, |at| unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), at, bytes.len()) })
    }

    pub fn read(&self, host: &Host, bytes: usize) -> Result<Vec<u8>> {
        // SAFETY: as above.
        self.mapped(host, |at| unsafe { std::slice::from_raw_parts(at, bytes).to_vec() })
    }

    fn mapped<T>(&self, host: &Host, access: impl FnOnce(*mut u8) -> T) -> Result<T> {
        // SAFETY: the memory is host-visible, and mapped only here.
        unsafe {
            let at = host.device.map_memory(self.memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty())?;
            let result = access(at.cast());
            host.device.unmap_memory(self.memory);
            Ok(result)
        }
    }

    pub fn destroy(self, host: &Host) {
        // SAFETY: no longer in use.
        unsafe {
            host.device.destroy_buffer(self.raw, None);
            host.device.free_memory(self.memory, None);
        }
    }
}
