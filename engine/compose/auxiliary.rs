//! Writes picks and the mean motion into a host's images.

use super::{Compose, Region};
use crate::error::Result;
use crate::forward::{MotionBuffers, PickBuffers};
use crate::kernels::compose::{mean_motion, picks};
use crate::plan::{FrameBuffers, LaunchSizes, tile_grid};
use crate::scene::Camera;
use crate::vk::{Buffer, Context, KernelSet, Recorder};

/// Kernels, built on request.
#[derive(Default)]
pub(super) struct Kernels {
    picks: KernelSet<picks::Interface>,
    mean_motion: KernelSet<mean_motion::Interface>,
}

impl Compose {
    /// Builds the missing kernels of picking and of motion, if wanted.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn prepare(&mut self, context: &Context, [pick, motion]: [bool; 2]) -> Result<()> {
        let workgroup_size = self.workgroup;
        if pick {
            self.auxiliary.picks.prepare(context, picks::Spec { workgroup_size })?;
        }
        if motion {
            self.auxiliary.mean_motion.prepare(context, mean_motion::Spec { workgroup_size })?;
        }
        Ok(())
    }

    /// Records the picks of a frame without backward that was blended with picks, into an image of [`Compose::PICK_FORMAT`]
    /// that is ready for kernels. Each has the Gaussian, its scene, and the bits of its depth and of its weight.
    pub fn record_picks(
        &self,
        r: &mut Recorder,
        (frame, sizes, own): (&FrameBuffers, &LaunchSizes, PickBuffers<'_>),
        (camera, scenes): (&Camera, u32),
        region: Region<'_>,
    ) {
        let spec = picks::Spec { workgroup_size: self.workgroup };
        let Some(kernel) = self.auxiliary.picks.get(r, &spec) else { return };
        let splats = frame.splats();
        let [offset_x, offset_y] = region.offset;
        let bind = picks::Bind {
            picks: own.picks,
            tile_ranges: &frame.tile_ranges,
            sorted_visible: frame.sorted_visible(sizes, false, camera),
            visible_list: &frame.visible_list,
            color_inverse_depth: splats.color_inverse_depth,
            scene_firsts: own.scene_firsts,
            target: region.image,
        };
        let push = picks::Push {
            image_width: camera.width,
            image_height: camera.height,
            offset_x,
            offset_y,
            tiles_per_row: tile_grid(camera.width, camera.height).0,
            splat_stride: splats.stride,
            scenes,
        };
        r.dispatch(kernel, &bind, &push, self.workgroups([camera.width, camera.height]));
    }

    /// Records the mean motion sum(w m) / sum(w), px, of a frame that was blended with motion, into an image of
    /// [`Compose::MOTION_FORMAT`] that is ready for kernels. Pixels with a sum of weights below `min_weight` receive `empty`,
    /// or stay without it.
    pub fn record_motion(
        &self,
        r: &mut Recorder,
        (accumulated, own): (&Buffer, MotionBuffers<'_>),
        size: [u32; 2],
        region: Region<'_>,
        (min_weight, empty): (f32, Option<[f32; 2]>),
    ) {
        let spec = mean_motion::Spec { workgroup_size: self.workgroup };
        let Some(kernel) = self.auxiliary.mean_motion.get(r, &spec) else { return };
        let ([image_width, image_height], [offset_x, offset_y]) = (size, region.offset);
        let bind = mean_motion::Bind { accumulated, motion_sums: own.sums, target: region.image };
        let push = mean_motion::Push {
            image_width,
            image_height,
            offset_x,
            offset_y,
            min_weight,
            empty: empty.unwrap_or_default(),
            keeps: empty.is_none().into(),
        };
        r.dispatch(kernel, &bind, &push, self.workgroups(size));
    }
}
