//! Writes a frame's buffers into the host's images, and tracks the images' uses within a recording.

use super::record::{HostImage, PickTarget, RecordedFrame, Release, Target};
use crate::compose::Compose;
use crate::forward::FrameInputs;
use crate::plan::LaunchSizes;
use crate::vk::{Image, ImageState, Recorder};
use ash::vk;

impl<'a> RecordedFrame<'a> {
    /// Returns the host's images that the frame uses, by field.
    pub(super) fn images(&self) -> [(&'static str, Option<&HostImage<'a>>); 5] {
        let target = match &self.target {
            Target::Image { to, .. } => Some(to),
            Target::Slot => None,
        };
        [
            ("target", target),
            ("occluder", self.occluder.as_ref().map(|occluder| &occluder.depth)),
            ("depth", self.depth.as_ref().map(|depth| &depth.to)),
            ("pick", self.pick.as_ref().map(|pick| &pick.to)),
            ("motion", self.motion.as_ref().map(|motion| &motion.to)),
        ]
    }

    /// True if the frame uses this image.
    pub(super) fn uses(&self, image: &Image) -> bool {
        self.images().iter().any(|(_, host)| host.is_some_and(|host| host.image.is_same_as(image)))
    }
}

/// The earlier views of a recording, and the last uses of their images.
#[derive(Clone, Copy)]
pub(super) struct Earlier<'a> {
    pub frames: &'a [RecordedFrame<'a>],
    pub releases: &'a [Release],
}

impl Earlier<'_> {
    /// Returns the last use of an image in the recording.
    fn last_use(&self, image: &Image) -> Option<ImageState> {
        let views = self.frames.iter().zip(self.releases).rev();
        views
            .flat_map(|(frame, release)| frame.images().into_iter().zip(release.uses()))
            .find_map(|((_, host), last)| host.filter(|host| host.image.is_same_as(image)).and(last))
    }

    /// Makes an image ready for kernels. An image of an earlier view is already ready: the barrier between two views orders
    /// all kernels.
    pub fn acquire(&self, r: &mut Recorder, host: &HostImage<'_>) -> ImageState {
        self.last_use(host.image).unwrap_or_else(|| r.acquire_image(host.image, host.from))
    }
}

impl Release {
    /// Returns the last uses of [`RecordedFrame::images`].
    fn uses(&self) -> [Option<ImageState>; 5] {
        [self.color, self.occluder, self.depth, self.pick, self.motion]
    }

    fn uses_mut(&mut self) -> [&mut Option<ImageState>; 5] {
        [&mut self.color, &mut self.occluder, &mut self.depth, &mut self.pick, &mut self.motion]
    }
}

/// Releases images to the queue families that own them, each after its last use.
pub(super) fn release_images(r: &mut Recorder, frames: &[RecordedFrame<'_>], releases: &mut [Release]) {
    for (index, frame) in frames.iter().enumerate() {
        let (earlier, own) = (&frames[..index], &mut releases[index]);
        for ((_, host), used) in frame.images().into_iter().zip(own.uses_mut()) {
            let (Some(host), Some(used)) = (host, used) else { continue };
            if !earlier.iter().any(|frame| frame.uses(host.image)) {
                r.release_image(host.image, *used);
            }
            *used = host.image.left(*used);
        }
    }
}

/// Records the writes of a frame into the host's images.
pub(super) fn record_targets(
    r: &mut Recorder,
    (compose, sizes): (&Compose, &LaunchSizes),
    inputs: &FrameInputs<'_>,
    (frame, earlier): (&RecordedFrame<'_>, Earlier<'_>),
) -> Release {
    let size = [frame.camera.width, frame.camera.height];
    let f = inputs.frame;
    let mut release = Release {
        stages: vk::PipelineStageFlags2::COMPUTE_SHADER,
        accesses: vk::AccessFlags2::SHADER_STORAGE_WRITE,
        ..Release::default()
    };
    r.scope("compose", |r| {
        if let Target::Image { to, behind, encoding } = &frame.target {
            release.color = Some(earlier.acquire(r, to));
            compose.record_color(r, &f.accumulated, size, to.region(), (*behind, *encoding));
        }
        if let Some(depth) = &frame.depth {
            release.depth = Some(earlier.acquire(r, &depth.to));
            let limits = [depth.min_weight, depth.empty];
            compose.record_expected_depth(
                r,
                [&f.accumulated, &f.inverse_depth],
                size,
                depth.to.region(),
                limits,
            );
        }
        if let (Some(PickTarget { to }), Some(own)) = (&frame.pick, inputs.auxiliary.picks) {
            release.pick = Some(earlier.acquire(r, to));
            let scenes = frame.scenes.len() as u32;
            compose.record_picks(r, (f, sizes, own), (frame.camera, scenes), to.region());
        }
        if let (Some(motion), Some(own)) = (&frame.motion, inputs.auxiliary.motion) {
            release.motion = Some(earlier.acquire(r, &motion.to));
            let others = (motion.min_weight, motion.empty);
            compose.record_motion(r, (&f.accumulated, own), size, motion.to.region(), others);
        }
    });
    release
}
