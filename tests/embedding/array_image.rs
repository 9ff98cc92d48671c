//! A host's image with several layers, like a headset's swapchain.

use crate::auxiliary::truth::WRITTEN;
use crate::host::Host;
use crate::memory::HostBuffer;
use ashsplat::ash::vk;
use ashsplat::vk::{Context, ForeignImage, Image, ImageUse};

const FORMAT: vk::Format = vk::Format::R32G32B32A32_SFLOAT;

pub struct ArrayImage {
    image: vk::Image,
    memory: vk::DeviceMemory,
    size: [u32; 2],
    layers: u32,
}

impl ArrayImage {
    pub fn new(host: &Host, size: [u32; 2], layers: u32) -> Self {
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(FORMAT)
            .extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 })
            .mip_levels(1)
            .array_layers(layers)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(Self::usage());
        // SAFETY: a valid create info; the image is bound once to memory of its own.
        unsafe {
            let image = host.device.create_image(&info, None).expect("an image");
            let needs = host.device.get_image_memory_requirements(image);
            let memory = host.allocate(needs, vk::MemoryPropertyFlags::empty()).expect("memory");
            host.device.bind_image_memory(image, memory, 0).expect("bound");
            Self { image, memory, size, layers }
        }
    }

    fn usage() -> vk::ImageUsageFlags {
        vk::ImageUsageFlags::STORAGE | vk::ImageUsageFlags::TRANSFER_SRC
    }

    /// A layer as the guest's image.
    pub fn adopt(&self, context: &Context, layer: u32) -> Image {
        let foreign = ForeignImage {
            image: self.image,
            format: FORMAT,
            flags: vk::ImageCreateFlags::empty(),
            usage: Self::usage(),
            samples: vk::SampleCountFlags::TYPE_1,
            size: self.size,
            mip_level: 0,
            layer,
        };
        // SAFETY: the description matches the image, which outlives the view in all tests.
        unsafe { Image::adopt(context, "eye", &foreign, ImageUse::Target) }.expect("adopted")
    }

    /// Reads the texels of all layers.
    pub fn read(&self, host: &Host) -> Vec<Vec<[f32; 4]>> {
        let [width, height] = self.size;
        let pixels = (width * height) as usize;
        let bytes = 16 * pixels * self.layers as usize;
        let staging = HostBuffer::new(host, bytes as u64).expect("memory");
        let range = vk::ImageSubresourceRange {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            level_count: 1,
            layer_count: self.layers,
            ..Default::default()
        };
        let layout = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        let barriers = [vk::ImageMemoryBarrier2::default()
            .src_stage_mask(WRITTEN.stages)
            .src_access_mask(WRITTEN.accesses)
            .dst_stage_mask(vk::PipelineStageFlags2::ALL_TRANSFER)
            .dst_access_mask(vk::AccessFlags2::TRANSFER_READ)
            .old_layout(WRITTEN.layout)
            .new_layout(layout)
            .image(self.image)
            .subresource_range(range)];
        let readable = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        let layers = vk::ImageSubresourceLayers {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            layer_count: self.layers,
            ..Default::default()
        };
        let region = vk::BufferImageCopy::default().image_subresource(layers).image_extent(vk::Extent3D {
            width,
            height,
            depth: 1,
        });
        let copied = host.run(|commands| {
            // SAFETY: recording state; the buffer holds all layers.
            unsafe {
                host.device.cmd_pipeline_barrier2(commands, &readable);
                host.device.cmd_copy_image_to_buffer(commands, self.image, layout, staging.raw, &[region]);
            }
            staging.to_host(host, commands);
            Ok(())
        });
        copied.expect("copied");
        let texels: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&staging.read(host, bytes).expect("bytes"));
        staging.destroy(host);
        texels.chunks(pixels).map(<[_]>::to_vec).collect()
    }

    pub fn destroy(self, host: &Host) {
        // SAFETY: no longer in use.
        unsafe {
            host.device.destroy_image(self.image, None);
            host.device.free_memory(self.memory, None);
        }
    }
}
