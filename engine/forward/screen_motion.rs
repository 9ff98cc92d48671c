//! The motion of the visible Gaussians on the screen, in frames that ask for it.

use super::auxiliary::{MotionBuffers, Seen};
use super::inputs::Part;
use super::{FrameInputs, block_of, range_arguments};
use crate::error::Result;
use crate::kernels::forward::screen_motion;
use crate::plan::LaunchSizes;
use crate::vk::{Context, Kernel, Recorder};

/// The kernels, built on first use: of a pinhole and one before it, then with an orthographic camera now, before, and both.
#[derive(Default)]
pub(super) struct ScreenMotion {
    kernels: [Option<Kernel<screen_motion::Interface>>; 4],
}

impl ScreenMotion {
    /// Builds what frames of pinholes need, with `orthographic` also those where a camera is orthographic.
    pub fn prepare(&mut self, context: &Context, workgroup_size: u32, orthographic: bool) -> Result<()> {
        let wanted = if orthographic { 4 } else { 1 };
        for (place, kernel) in self.kernels.iter_mut().enumerate().take(wanted) {
            if kernel.is_none() {
                let [orthographic, previous_orthographic] = [place & 1 != 0, place & 2 != 0];
                let spec = screen_motion::Spec { workgroup_size, orthographic, previous_orthographic };
                *kernel = Some(Kernel::new(context, &spec)?);
            }
        }
        Ok(())
    }

    pub fn is_prepared(&self, orthographic: bool) -> bool {
        self.kernels[if orthographic { 3 } else { 0 }].is_some()
    }

    /// Records the motions of a part's visible Gaussians, if the frame asks for them. It writes nothing that the projection
    /// reads or writes, and needs no barrier between them.
    pub fn record(&self, r: &mut Recorder, (inputs, part): (&FrameInputs, &Part), sizes: &LaunchSizes) {
        let Some(MotionBuffers { motions, .. }) = inputs.auxiliary.motion else { return };
        let (f, Seen { camera, scale }) = (inputs.frame, part.previous);
        let place = usize::from(inputs.camera.is_orthographic()) | usize::from(camera.is_orthographic()) << 1;
        let Some(kernel) = &self.kernels[place] else { panic!("Forward::prepare was not called for motion") };
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
            camera_block: &block_of(f, part.block),
        };
        r.dispatch_indirect(kernel, &bind, &push, &range_arguments(f, sizes, part.range));
    }
}
