//! Copies between images, which the engine leaves to its hosts.

use ashsplat::ash::{self, vk};
use ashsplat::vk::{Image, ImageState};

const WHOLE: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};
const LAYER: vk::ImageSubresourceLayers = vk::ImageSubresourceLayers {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    mip_level: 0,
    base_array_layer: 0,
    layer_count: 1,
};
const READ: ImageState = ImageState {
    layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
    stages: vk::PipelineStageFlags2::ALL_TRANSFER,
    accesses: vk::AccessFlags2::TRANSFER_READ,
};
const WRITTEN: ImageState = ImageState {
    layout: vk::ImageLayout::TRANSFER_DST_OPTIMAL,
    stages: vk::PipelineStageFlags2::ALL_TRANSFER,
    accesses: vk::AccessFlags2::TRANSFER_WRITE,
};
/// An acquired image: the semaphore is waited for in this stage, and the old contents are overwritten.
const ACQUIRED: ImageState = ImageState {
    layout: vk::ImageLayout::UNDEFINED,
    stages: vk::PipelineStageFlags2::ALL_TRANSFER,
    accesses: vk::AccessFlags2::NONE,
};
/// An image to present. The semaphore of the presentation does the rest.
const SHOWN: ImageState = ImageState {
    layout: vk::ImageLayout::PRESENT_SRC_KHR,
    stages: vk::PipelineStageFlags2::NONE,
    accesses: vk::AccessFlags2::NONE,
};

pub struct Images<'a> {
    pub device: &'a ash::Device,
    pub commands: vk::CommandBuffer,
}

impl Images<'_> {
    /// Waits for one use and prepares the image for the next.
    fn barrier(&self, image: vk::Image, from: ImageState, to: ImageState) {
        let barriers = [vk::ImageMemoryBarrier2::default()
            .src_stage_mask(from.stages)
            .src_access_mask(from.accesses)
            .dst_stage_mask(to.stages)
            .dst_access_mask(to.accesses)
            .old_layout(from.layout)
            .new_layout(to.layout)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(image)
            .subresource_range(WHOLE)];
        let dependency = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        // SAFETY: the image is alive; the command buffer is being recorded.
        unsafe { self.device.cmd_pipeline_barrier2(self.commands, &dependency) }
    }

    fn blit(&self, [from, to]: [vk::Image; 2], sizes: [[u32; 2]; 2], filter: vk::Filter) {
        let corner = |[width, height]: [u32; 2]| {
            let [x, y] = [width, height].map(|side| i32::try_from(side).unwrap_or(i32::MAX));
            [vk::Offset3D::default(), vk::Offset3D { x, y, z: 1 }]
        };
        let regions = [vk::ImageBlit2::default()
            .src_subresource(LAYER)
            .src_offsets(corner(sizes[0]))
            .dst_subresource(LAYER)
            .dst_offsets(corner(sizes[1]))];
        let info = vk::BlitImageInfo2::default()
            .src_image(from)
            .src_image_layout(READ.layout)
            .dst_image(to)
            .dst_image_layout(WRITTEN.layout)
            .regions(&regions)
            .filter(filter);
        // SAFETY: both images are alive, have these sizes and, by the barriers before, these layouts.
        unsafe { self.device.cmd_blit_image2(self.commands, &info) }
    }

    /// Fills an image with one colour. Returns its new state.
    pub fn clear(&self, image: &Image, from: ImageState, [r, g, b]: [f32; 3]) -> ImageState {
        self.barrier(image.handle(), from, WRITTEN);
        let color = vk::ClearColorValue { float32: [r, g, b, 1.0] };
        // SAFETY: as in `blit`.
        unsafe {
            let layout = WRITTEN.layout;
            self.device.cmd_clear_color_image(self.commands, image.handle(), layout, &color, &[WHOLE]);
        }
        WRITTEN
    }

    /// Copies an image into one of another size. Returns the second one's new state.
    pub fn scale(&self, [from, to]: [&Image; 2], uses: [ImageState; 2]) -> ImageState {
        self.barrier(from.handle(), uses[0], READ);
        self.barrier(to.handle(), uses[1], WRITTEN);
        self.blit([from.handle(), to.handle()], [from.size(), to.size()], vk::Filter::LINEAR);
        WRITTEN
    }

    /// Copies a picture into an acquired image of the swapchain, and makes that image ready to present.
    pub fn show(&self, picture: &Image, used: ImageState, image: vk::Image, extent: [u32; 2]) {
        self.barrier(picture.handle(), used, READ);
        self.barrier(image, ACQUIRED, WRITTEN);
        self.blit([picture.handle(), image], [picture.size(), extent], vk::Filter::NEAREST);
        self.barrier(image, WRITTEN, SHOWN);
    }
}
