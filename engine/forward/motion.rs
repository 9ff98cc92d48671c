//! Motion of the visible Gaussians on the screen, in frames that request it.

use super::inputs::Part;
use super::inputs::{MotionBuffers, Seen};
use super::{BlendVariant, Forward, FrameInputs, block_of, range_arguments};
use crate::kernels::forward::screen_motion;
use crate::vk::Recorder;

impl Forward {
    fn motion_spec(&self, [orthographic, previous_orthographic]: [bool; 2]) -> screen_motion::Spec {
        let workgroup_size = self.sizes.elementwise_workgroup;
        screen_motion::Spec { workgroup_size, orthographic, previous_orthographic }
    }

    /// Kernels that frames of a variant may need: the projections of the current and the previous camera may differ.
    pub(super) fn motion_specs(&self, variant: BlendVariant) -> impl Iterator<Item = screen_motion::Spec> {
        const PROJECTIONS: [[bool; 2]; 4] = [[false, false], [true, false], [false, true], [true, true]];
        let count = match (variant.motion, variant.orthographic) {
            (false, _) => 0,
            (true, false) => 1,
            (true, true) => 4,
        };
        PROJECTIONS.into_iter().take(count).map(|projections| self.motion_spec(projections))
    }

    /// Records the motions of a part's visible Gaussians if the frame requests them. The projection neither reads nor writes
    /// these outputs, so no barrier is necessary between them.
    pub(super) fn record_screen_motion(&self, r: &mut Recorder, inputs: &FrameInputs, part: &Part) {
        let Some(MotionBuffers { motions, .. }) = inputs.auxiliary.motion else { return };
        let (f, Seen { camera, scale }) = (inputs.frame, part.previous);
        let spec = self.motion_spec([inputs.camera.is_orthographic(), camera.is_orthographic()]);
        let Some(kernel) = self.screen_motion.get(r, &spec) else { return };
        let rows = camera.camera_from_world.transpose() * scale;
        let push = screen_motion::Push {
            first: part.range.first,
            previous_row_x: rows.x_axis.to_array(),
            previous_row_y: rows.y_axis.to_array(),
            previous_row_z: rows.z_axis.to_array(),
            previous_translation: camera.translation.to_array(),
            previous_focal_px: [camera.fx, camera.fy],
            // Same offset as in the camera block.
            previous_center_px: [camera.cx - 0.5, camera.cy - 0.5],
        };
        let bind = screen_motion::Bind {
            parameters: &part.scene.chunks[part.range.chunk],
            visible_ranges: &f.visible_ranges,
            visible_list: &f.visible_list,
            motions,
            camera_block: &block_of(f, part.block),
        };
        r.dispatch_indirect(kernel, &bind, &push, &range_arguments(f, &self.sizes, part.range));
    }
}
