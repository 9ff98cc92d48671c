//! Images that another queue family owns between recordings: for example, an asynchronous queue renders them and the
//! graphics queue shows them.
//!
//! A transfer of ownership has two halves, one in a queue of each family, ordered by a semaphore. The guest records its own
//! half; [`Image::hand_over`] and [`Image::take_back`] return the host's.

use super::image::{Image, ImageState};
use super::recorder::Recorder;
use crate::{Error, Result};
use ash::vk;

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
        let device = self.device();
        // SAFETY: the physical device is of this instance.
        let families =
            unsafe { device.owner.instance().get_physical_device_queue_family_properties(device.physical) };
        if queue_family as usize >= families.len() {
            let problem = format!("queue family {queue_family}, the device has {}", families.len());
            return Err(Error::argument(format!("image '{}'", self.name()), problem));
        }
        let mut owned = self;
        owned.1 = queue_family;
        Ok(owned)
    }

    /// Returns the barrier that hands the image over to a recording with the same
    /// [`HostImage::from`](crate::HostImage::from). The host records it in a queue of the image's family, after the image's
    /// use `from`. The recording's submission waits for that queue's submission by a semaphore, in all stages. If another
    /// family owns the image, the barrier changes the layout as the recording does; otherwise it keeps the layout.
    pub fn hand_over(&self, from: ImageState) -> vk::ImageMemoryBarrier2<'static> {
        let barrier = self.barrier(from.layout, [self.1, self.device().queue_family]);
        let to = if self.is_elsewhere() { self.layout() } else { from.layout };
        barrier.new_layout(to).src_stage_mask(from.stages).src_access_mask(from.accesses)
    }

    /// Returns the barrier that takes the image back after a recording. The host records it in a queue of the image's
    /// family, whose submission waits for the recording's by a semaphore, in all stages. The image then has
    /// [`Image::layout`], and its last use is that of the [`Release`](crate::Release).
    pub fn take_back(&self) -> vk::ImageMemoryBarrier2<'static> {
        let all = vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE;
        let barrier = self.barrier(self.layout(), [self.device().queue_family, self.1]);
        // The other family's release has already made the writes available.
        let written = match self.is_elsewhere() {
            true => vk::AccessFlags2::NONE,
            false => vk::AccessFlags2::SHADER_STORAGE_WRITE,
        };
        let barrier = barrier.src_stage_mask(EVERYTHING).src_access_mask(written);
        barrier.dst_stage_mask(EVERYTHING).dst_access_mask(all)
    }

    /// Returns a barrier into the kernels' layout, from one family to another.
    fn barrier(&self, from: vk::ImageLayout, [owner, next]: [u32; 2]) -> vk::ImageMemoryBarrier2<'static> {
        let [owner, next] = if self.is_elsewhere() { [owner, next] } else { [vk::QUEUE_FAMILY_IGNORED; 2] };
        vk::ImageMemoryBarrier2::default()
            .old_layout(from)
            .new_layout(self.layout())
            .src_queue_family_index(owner)
            .dst_queue_family_index(next)
            .image(self.raw())
            .subresource_range(self.whole_range())
    }

    /// True if another family owns it between recordings.
    fn is_elsewhere(&self) -> bool {
        self.1 != vk::QUEUE_FAMILY_IGNORED && self.1 != self.device().queue_family
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
            _ => [self.1, self.device().queue_family],
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

const EVERYTHING: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::ALL_COMMANDS;

impl Recorder {
    /// Releases an image that kernels have used to the family that owns it.
    pub(crate) fn release_image(&mut self, image: &Image, used: ImageState) {
        if image.is_elsewhere() {
            let barrier = image.take_back().src_stage_mask(used.stages).src_access_mask(used.accesses);
            let nothing = vk::PipelineStageFlags2::NONE;
            self.record_image_barrier(
                image,
                barrier.dst_stage_mask(nothing).dst_access_mask(vk::AccessFlags2::NONE),
            );
        }
    }
}
