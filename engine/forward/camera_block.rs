//! The camera blocks of a frame: what the kernels that project Gaussians know of a scene's camera and of the
//! settings, in one uniform block per scene.
//!
//! A new scalar of the projection is a member of `glsl/include/camera_block.glsl`, a line in [`camera_block`],
//! and its use in a shader. The blocks are written by commands of the frame's own recording, so a recording
//! needs no host memory, and frames in flight do not share a block.

use super::inputs::{FrameInputs, PlacedScene};
use super::settings::{RenderSettings, jacobian_limits};
use super::shape::DrawnShape;
use crate::kernels::blocks::CameraBlock;
use crate::plan::{CAMERA_BLOCK_BYTES, FrameBuffers};
use crate::vk::{Buffer, Recorder};

/// The block of a frame's scene, by the scene's place in the frame.
pub(crate) fn block_of(frame: &FrameBuffers, scene: usize) -> Buffer {
    frame.camera_blocks.range(scene as u64 * CAMERA_BLOCK_BYTES, CAMERA_BLOCK_BYTES)
}

/// Records the writes of the blocks of all scenes. The caller places a barrier after it.
pub(super) fn record_blocks(r: &mut Recorder, inputs: &FrameInputs) {
    for (scene, placed) in inputs.placed().enumerate() {
        let block = camera_block(&placed, inputs.settings);
        r.update(&block_of(inputs.frame, scene), bytemuck::bytes_of(&block));
    }
}

fn camera_block(placed: &PlacedScene, settings: &RenderSettings) -> CameraBlock {
    let (camera, scale) = (&placed.camera, placed.scale);
    let rows = camera.camera_from_world.transpose() * scale;
    let shape = DrawnShape::of(settings);
    CameraBlock {
        camera_row_x: rows.x_axis.to_array(),
        camera_row_y: rows.y_axis.to_array(),
        camera_row_z: rows.z_axis.to_array(),
        camera_translation: camera.translation.to_array(),
        focal_px: [camera.fx, camera.fy],
        // COLMAP puts the centre of the first pixel at 0.5, the shaders at 0.
        center_px: [camera.cx - 0.5, camera.cy - 0.5],
        jacobian_limits: jacobian_limits(camera, settings.jacobian_limit),
        image_width: camera.width,
        image_height: camera.height,
        inverse_scale_squared: (scale * scale).recip(),
        shape_scale: shape.scale,
        shape_dilation_px2: shape.dilation_px2,
        shape_opacity: shape.opacity,
    }
}
