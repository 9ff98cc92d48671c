//! Commands on images: layouts and copies.

use super::access::Access;
use super::buffer::Buffer;
use super::format::ImageKind;
use super::image::{Image, ImageState};
use super::recorder::Recorder;
use ash::vk;

impl Recorder {
    /// Makes an image ready for kernels: waits for the use `from`, and changes the layout to [`Image::layout`]. Returns the
    /// kernels' use.
    pub fn acquire_image(&mut self, image: &Image, from: ImageState) -> ImageState {
        let accesses = match image.purpose().kind() {
            ImageKind::Storage => {
                vk::AccessFlags2::SHADER_STORAGE_READ | vk::AccessFlags2::SHADER_STORAGE_WRITE
            }
            ImageKind::Sampled => vk::AccessFlags2::SHADER_SAMPLED_READ,
        };
        let stages = vk::PipelineStageFlags2::COMPUTE_SHADER;
        let to = ImageState { layout: image.layout(), stages, accesses };
        match image.acquisition(from) {
            Some(half) => {
                self.record_image_barrier(image, half.dst_stage_mask(stages).dst_access_mask(accesses));
            }
            None => self.image_barrier(image, from, to),
        }
        to
    }

    /// Copies a buffer of tightly packed texels into an image of our own, and leaves it ready for kernels.
    ///
    /// # Panics
    /// When the buffer is smaller than the image.
    pub fn copy_to_image(&mut self, from: &Buffer, image: &Image) {
        let transfer = ImageState {
            layout: vk::ImageLayout::TRANSFER_DST_OPTIMAL,
            stages: vk::PipelineStageFlags2::ALL_TRANSFER,
            accesses: vk::AccessFlags2::TRANSFER_WRITE,
        };
        self.image_barrier(image, ImageState::UNDEFINED, transfer);
        self.transfer("copy to image", &[(from, "source", Access::Read)]);
        let region = image.copy_region(from);
        // SAFETY: recording state; the layout is as the barrier says, the region is the whole level of the image.
        unsafe {
            let (raw, layout) = (self.raw(), transfer.layout);
            self.inner.device.cmd_copy_buffer_to_image(raw, from.raw(), image.raw(), layout, &[region]);
        }
        self.acquire_image(image, transfer);
    }

    /// Copies an image that kernels have written into a buffer of tightly packed texels.
    ///
    /// # Panics
    /// When the buffer is smaller than the image.
    pub fn copy_from_image(&mut self, image: &Image, to: &Buffer) {
        let stages = vk::PipelineStageFlags2::COMPUTE_SHADER;
        let accesses = vk::AccessFlags2::SHADER_STORAGE_WRITE;
        let written = ImageState { layout: image.layout(), stages, accesses };
        let transfer = ImageState {
            layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
            stages: vk::PipelineStageFlags2::ALL_TRANSFER,
            accesses: vk::AccessFlags2::TRANSFER_READ,
        };
        self.image_barrier(image, written, transfer);
        self.transfer("copy from image", &[(to, "destination", Access::Write)]);
        let region = image.copy_region(to);
        // SAFETY: as in `copy_to_image`.
        unsafe {
            let (raw, layout) = (self.raw(), transfer.layout);
            self.inner.device.cmd_copy_image_to_buffer(raw, image.raw(), layout, to.raw(), &[region]);
        }
    }

    fn image_barrier(&mut self, image: &Image, from: ImageState, to: ImageState) {
        let barrier = vk::ImageMemoryBarrier2::default()
            .src_stage_mask(from.stages)
            .src_access_mask(from.accesses)
            .dst_stage_mask(to.stages)
            .dst_access_mask(to.accesses)
            .old_layout(from.layout)
            .new_layout(to.layout)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(image.raw())
            .subresource_range(image.whole_range());
        self.record_image_barrier(image, barrier);
    }

    pub(super) fn record_image_barrier(&mut self, image: &Image, barrier: vk::ImageMemoryBarrier2<'_>) {
        self.keep_image(image);
        let barriers = [barrier];
        let dependency = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        // SAFETY: recording state, outside of a render pass; the view's owner says that the image is alive.
        unsafe { self.inner.device.cmd_pipeline_barrier2(self.raw(), &dependency) }
    }
}
