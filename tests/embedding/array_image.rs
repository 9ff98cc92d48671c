//! A host's image with several layers, like a headset's swapchain.

use crate::stage::*;
use crate::views::BLACK;
use ashsplat::vk::ForeignImage;

const FORMAT: vk::Format = vk::Format::R32G32B32A32_SFLOAT;

pub struct ArrayImage<'a> {
    /// The layers as the guest's images.
    pub layers: Vec<Image>,
    raw: Own<'a, (vk::Image, vk::DeviceMemory)>,
    size: [u32; 2],
}

impl<'a> ArrayImage<'a> {
    pub fn new(host: &'a Host, context: &Context, size: [u32; 2], layers: u32) -> Self {
        let usage = vk::ImageUsageFlags::STORAGE | vk::ImageUsageFlags::TRANSFER_SRC;
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(FORMAT)
            .extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 })
            .mip_levels(1)
            .array_layers(layers)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(usage);
        // SAFETY: a valid create info; the image is bound once to memory of its own.
        let (image, memory) = unsafe {
            let image = host.device.create_image(&info, None).expect("an image");
            let needs = host.device.get_image_memory_requirements(image);
            let memory = host.allocate(needs, vk::MemoryPropertyFlags::empty()).expect("memory");
            host.device.bind_image_memory(image, memory, 0).expect("bound");
            (image, memory)
        };
        let layer = |layer| {
            let flags = vk::ImageCreateFlags::empty();
            let samples = vk::SampleCountFlags::TYPE_1;
            let foreign =
                ForeignImage { image, format: FORMAT, flags, usage, samples, size, mip_level: 0, layer };
            // SAFETY: the description matches the image, which outlives the view in all tests.
            unsafe { Image::adopt(context, "eye", &foreign, ImageUse::Target) }.expect("adopted")
        };
        // SAFETY: no longer in use when it is dropped.
        let destroy = |(image, memory), host: &Host| unsafe {
            host.device.destroy_image(image, None);
            host.device.free_memory(memory, None);
        };
        Self { layers: (0..layers).map(layer).collect(), raw: Own::of(host, (image, memory), destroy), size }
    }

    /// Views of the same scenes over black, each in its own layer.
    pub fn frames<'b>(&'b self, scenes: &'b [Placed<'b>], cameras: &'b [Camera]) -> Vec<RecordedFrame<'b>> {
        let frame = |(camera, layer): (&'b Camera, &'b Image)| RecordedFrame {
            target: into(layer, BLACK, [0; 2]),
            ..frame_of(scenes, camera)
        };
        cameras.iter().zip(&self.layers).map(frame).collect()
    }

    pub fn read(&self) -> Vec<Vec<[f32; 4]>> {
        let [width, height] = self.size;
        let (pixels, layer_count) = (width * height, self.layers.len() as u32);
        let (host, image) = (self.raw.host, self.raw.0);
        let staging = Staging::new(host, u64::from(16 * pixels * layer_count));
        let barriers = [vk::ImageMemoryBarrier2::default()
            .src_stage_mask(WRITTEN.stages)
            .src_access_mask(WRITTEN.accesses)
            .dst_stage_mask(vk::PipelineStageFlags2::ALL_TRANSFER)
            .dst_access_mask(vk::AccessFlags2::TRANSFER_READ)
            .old_layout(WRITTEN.layout)
            .new_layout(READ.layout)
            .image(image)
            .subresource_range(vk::ImageSubresourceRange {
                layer_count,
                ..whole(vk::ImageAspectFlags::COLOR)
            })];
        let readable = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        let layers = vk::ImageSubresourceLayers {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            layer_count,
            ..Default::default()
        };
        let extent = vk::Extent3D { width, height, depth: 1 };
        let region = vk::BufferImageCopy::default().image_subresource(layers).image_extent(extent);
        let copied = host.run(|commands| {
            // SAFETY: recording state; the buffer holds all layers.
            unsafe {
                host.device.cmd_pipeline_barrier2(commands, &readable);
                host.device.cmd_copy_image_to_buffer(commands, image, READ.layout, staging.raw, &[region]);
            }
            staging.to_host(host, commands);
            Ok(())
        });
        copied.expect("copied");
        staging.read::<[f32; 4]>().chunks(pixels as usize).map(<[_]>::to_vec).collect()
    }
}
