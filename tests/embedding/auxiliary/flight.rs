//! Picks and motion of frames in flight: images of a slot that are used repeatedly, and the buffers that read them.

use super::truth::{Screens, WRITTEN};
use crate::host::{Host, InFlight};
use crate::memory::HostBuffer;
use ashsplat::ash::vk;
use ashsplat::vk::{Context, ImageState};
use ashsplat::{Camera, MotionTarget, PickTarget, RecordedFrame};

/// Texels of picks and of motion; empty unless requested.
pub type Beside = (Vec<[u32; 4]>, Vec<[u16; 2]>);

pub struct Flight<'a> {
    host: &'a Host,
    screens: Screens<'a>,
    staging: [HostBuffer; 2],
    pixels: usize,
    last: [ImageState; 2],
}

impl<'a> Flight<'a> {
    pub fn new(host: &'a Host, context: &Context, size: [u32; 2]) -> Self {
        let pixels = (size[0] * size[1]) as usize;
        let staging = [16, 4].map(|bytes| HostBuffer::new(host, bytes * pixels as u64).expect("memory"));
        let screens = Screens::new(host, context, size);
        Self { host, screens, staging, pixels, last: [ImageState::UNDEFINED; 2] }
    }

    /// Adds picks and motion to a frame.
    pub fn with<'b>(
        &'b self,
        frame: RecordedFrame<'b>,
        previous: &'b Camera,
        [pick, motion]: [bool; 2],
    ) -> RecordedFrame<'b> {
        let to = |which: usize| ashsplat::HostImage { from: self.last[which], ..self.screens.to(which) };
        let (target, moved) = (PickTarget { to: to(0) }, self.screens.motion(previous));
        let moved = MotionTarget { to: to(1), ..moved };
        RecordedFrame { pick: pick.then_some(target), motion: motion.then_some(moved), ..frame }
    }

    /// Records the reads after the frame, in its command buffer.
    pub fn record_read(&mut self, in_flight: &InFlight, wanted: [bool; 2]) {
        let written = (WRITTEN.layout, WRITTEN.stages, WRITTEN.accesses);
        for which in (0..2).filter(|&which| wanted[which]) {
            let (texture, staging) = (&self.screens.textures[which], &self.staging[which]);
            let (layout, stages, _) = texture.record_read(self.host, in_flight.commands, written, staging);
            self.last[which] = ImageState { layout, stages, accesses: vk::AccessFlags2::NONE };
        }
    }

    /// Returns the texels; to be called after the fence.
    pub fn read(&self, [pick, motion]: [bool; 2]) -> Beside {
        let bytes = |which: usize, wanted: bool, bytes: usize| match wanted {
            true => self.staging[which].read(self.host, bytes * self.pixels).expect("bytes"),
            false => Vec::new(),
        };
        let texels = (bytes(0, pick, 16), bytes(1, motion, 4));
        (bytemuck::pod_collect_to_vec(&texels.0), bytemuck::pod_collect_to_vec(&texels.1))
    }

    /// Reads the images after a frame that has finished and that recorded no reads.
    pub fn now(&self, [pick, motion]: [bool; 2]) -> Beside {
        let (picks, motions) = (pick.then(|| self.screens.read(0)), motion.then(|| self.screens.read(1)));
        (picks.unwrap_or_default(), motions.unwrap_or_default())
    }

    pub fn destroy(self) {
        self.screens.destroy();
        self.staging.into_iter().for_each(|staging| staging.destroy(self.host));
    }
}
