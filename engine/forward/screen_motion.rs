//! The motion of the visible Gaussians on the screen, in frames that ask for it.

use super::auxiliary::{MotionBuffers, Seen};
use super::{FrameInputs, block_of, range_arguments};
use crate::error::Result;
use crate::kernels::forward::screen_motion;
use crate::plan::LaunchSizes;
use crate::vk::{Context, Kernel, Recorder};

/// The kernel, built on first use.
#[derive(Default)]
pub(super) struct ScreenMotion {
    kernel: Option<Kernel<screen_motion::Interface>>,
}

impl ScreenMotion {
    pub fn prepare(&mut self, context: &Context, workgroup_size: u32) -> Result<()> {
        if self.kernel.is_none() {
            self.kernel = Some(Kernel::new(context, &screen_motion::Spec { workgroup_size })?);
        }
        Ok(())
    }

    pub fn is_prepared(&self) -> bool {
        self.kernel.is_some()
    }

    /// Records the motions of the visible Gaussians, if the frame asks for them, and a barrier.
    pub fn record(&self, r: &mut Recorder, inputs: &FrameInputs, sizes: &LaunchSizes) {
        let Some(MotionBuffers { motions, .. }) = inputs.auxiliary.motion else { return };
        let Some(kernel) = &self.kernel else { panic!("Forward::prepare was not called for motion") };
        let f = inputs.frame;
        r.scope("motion", |r| {
            for (index, part) in inputs.parts().enumerate() {
                let Seen { camera, scale } = part.previous;
                let rows = camera.camera_from_world.transpose() * scale;
                let push = screen_motion::Push {
                    first: part.range.first,
                    previous_row_x: rows.x_axis.to_array(),
                    previous_row_y: rows.y_axis.to_array(),
                    previous_row_z: rows.z_axis.to_array(),
                    previous_translation: camera.translation.to_array(),
                    previous_focal_px: [camera.fx, camera.fy],
                    // As in the camera block.
                    previous_center_px: [camera.cx - 0.5, camera.cy - 0.5],
                };
                let bind = screen_motion::Bind {
                    parameters: &part.scene.chunks[part.range.chunk],
                    visible_ranges: &f.visible_ranges,
                    visible_list: &f.visible_list,
                    motions,
                    camera_block: &block_of(f, part.place),
                };
                if index > 0 {
                    r.barrier();
                }
                r.dispatch_indirect(kernel, &bind, &push, &range_arguments(f, sizes, part.range));
            }
            r.barrier();
        });
    }
}
