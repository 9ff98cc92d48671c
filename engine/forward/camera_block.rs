//! The camera blocks of a frame: what the kernels that project Gaussians know of a scene's camera and of the
//! settings, in one uniform block per scene.
//!
//! A new scalar of the projection takes three files: a member in `glsl/include/camera_block.glsl`, a field of
//! `RenderSettings` and a line of [`camera_block`] beside it, and its use in a shader. The blocks are written
//! by commands of the frame's own recording, so a recording needs no host memory, and frames in flight do not
//! share a block.

use super::inputs::FrameInputs;
use super::settings::camera_block;
use crate::kernels::blocks::CameraBlock;
use crate::plan::{CAMERA_BLOCK_BYTES, FrameBuffers};
use crate::scene::Camera;
use crate::vk::{Buffer, Recorder};
use std::mem::offset_of;

/// The block of a frame's scene, by the scene's place in the frame.
pub(crate) fn block_of(frame: &FrameBuffers, scene: usize) -> Buffer {
    frame.camera_blocks.range(scene as u64 * CAMERA_BLOCK_BYTES, CAMERA_BLOCK_BYTES)
}

/// Bytes of a camera's pose at the start of its block: the rows of the rotation from world to camera, and the translation.
pub const POSE_BYTES: u64 = 48;
const _: () = assert!(
    offset_of!(CameraBlock, camera_row_x) == 0
        && offset_of!(CameraBlock, camera_translation) == 36
        && offset_of!(CameraBlock, focal_px) as u64 == POSE_BYTES
);

/// A camera's pose as the device keeps it: the rows of the rotation from world to camera, then the translation.
pub fn pose_of(camera: &Camera) -> [f32; 12] {
    let rows = camera.camera_from_world.transpose();
    let mut pose = [0.0; 12];
    pose[..9].copy_from_slice(&rows.to_cols_array());
    pose[9..].copy_from_slice(&camera.translation.to_array());
    pose
}

/// Records the writes of the blocks of all scenes. The caller places a barrier after it.
pub(super) fn record_blocks(r: &mut Recorder, inputs: &FrameInputs) {
    for (scene, placed) in inputs.placed().enumerate() {
        let values = camera_block(&placed.camera, placed.scale, inputs.settings);
        let (values, block) = (bytemuck::bytes_of(&values), block_of(inputs.frame, scene));
        match inputs.pose {
            Some(pose) if scene == 0 => {
                r.copy(pose, &block.range(0, POSE_BYTES));
                let rest = values.len() as u64 - POSE_BYTES;
                r.update(&block.range(POSE_BYTES, rest), &values[POSE_BYTES as usize..]);
            }
            _ => r.update(&block, values),
        }
    }
}
