//! Camera blocks of a frame: one uniform block per scene with its camera and the settings, for the kernels that project
//! Gaussians. The blocks are contiguous, so kernels over all scenes read them as a table.
//!
//! A new scalar of the projection changes three files: `glsl/include/camera_members.glsl` gets a member, `RenderSettings` a
//! field with a line of [`block_of_frame`] below, and a shader its use. Commands of the frame's own recording write the blocks.
//! So a recording needs no host memory, and frames in flight do not share a block.

use super::CAMERA_BLOCK_BYTES;
use super::inputs::{FrameInputs, PlacedScene};
use super::settings::{DrawnShape, Dropout, RenderSettings};
use crate::kernels::blocks::CameraBlock;
use crate::kernels::constants as c;
use crate::scene::cut_out::Compared;
use crate::scene::{Camera, CutLimits, CutOutLimits, Inside, MAX_CUT_OUTS, Projection};
use crate::vk::{MAX_UPDATE_BYTES, Recorder};
use bytemuck::Zeroable;
use std::mem::offset_of;

/// Bytes of a camera's pose at the start of its block: rows of the rotation from world to camera, then the translation.
pub const POSE_BYTES: u64 = 48;
const _: () = assert!(
    offset_of!(CameraBlock, camera_row_x) == 0
        && offset_of!(CameraBlock, camera_translation) == 36
        && offset_of!(CameraBlock, focal_px) as u64 == POSE_BYTES
);

const _: () = assert!(crate::scene::camera::NEAR_PLANE == c::NEAR_PLANE);

/// Number by which kernels know a projection.
const fn number_of(projection: Projection) -> u32 {
    match projection {
        Projection::Perspective => c::PROJECTION_PERSPECTIVE,
        Projection::Orthographic => c::PROJECTION_ORTHOGRAPHIC,
        Projection::Brown => c::PROJECTION_BROWN,
        Projection::Fov => c::PROJECTION_FOV,
        Projection::Division => c::PROJECTION_DIVISION,
        Projection::Eucm => c::PROJECTION_EUCM,
        Projection::Fisheye => c::PROJECTION_FISHEYE,
        Projection::ThinPrismFisheye => c::PROJECTION_THIN_PRISM_FISHEYE,
        Projection::Equirectangular => c::PROJECTION_EQUIRECTANGULAR,
    }
}
const _: () = {
    let mut place = 0;
    while place < Projection::ALL.len() {
        let projection = Projection::ALL[place];
        assert!(number_of(projection) == projection as u32 && projection as usize == place);
        place += 1;
    }
};

/// Pose of a camera in device layout: rows of the rotation from world to camera, then the translation.
pub fn pose_of(camera: &Camera) -> [f32; 12] {
    let rows = camera.camera_from_world.transpose();
    let mut pose = [0.0; 12];
    pose[..9].copy_from_slice(&rows.to_cols_array());
    pose[9..].copy_from_slice(&camera.translation.to_array());
    pose
}

/// Number of blocks that one command writes, from the host's stack.
const BLOCKS_PER_UPDATE: usize = 64;
const _: () = assert!(BLOCKS_PER_UPDATE * size_of::<Block>() <= MAX_UPDATE_BYTES);

/// A block with the words of the lens (glsl/include/lens_members.glsl).
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Block {
    values: CameraBlock,
    lens: [f32; c::CAMERA_BLOCK_WORDS as usize - size_of::<CameraBlock>() / 4],
}
const _: () = assert!(size_of::<Block>() as u64 == CAMERA_BLOCK_BYTES);

/// Records the writes of all scenes' blocks, including scenes that are not drawn. The caller places a barrier after it.
pub(crate) fn record_blocks(r: &mut Recorder, inputs: &FrameInputs) {
    let all = inputs.camera_blocks();
    // Most members are the same for all scenes, so they are computed once.
    let mut of_frame = Block { values: block_of_frame(inputs.camera, inputs.settings), ..Block::zeroed() };
    if let Some(words) = inputs.camera.lens_words() {
        (of_frame.values.jacobian_limits, of_frame.lens) = words;
    }
    let mut blocks = [of_frame; BLOCKS_PER_UPDATE];
    let (mut scenes, mut written) = (inputs.scenes.iter(), 0);
    if let Some(pose) = inputs.pose {
        r.copy(pose, &all.range(0, POSE_BYTES));
    }
    while written < all.bytes() {
        let mut filled = 0;
        for (block, placed) in blocks.iter_mut().zip(scenes.by_ref()) {
            set_scene(&mut block.values, placed);
            filled += 1;
        }
        // The first block's pose comes from the device if it has one.
        let known = if written == 0 && inputs.pose.is_some() { POSE_BYTES } else { 0 };
        let values = &bytemuck::cast_slice::<_, u8>(&blocks[..filled])[known as usize..];
        let bytes = values.len() as u64;
        r.update(&all.range(written + known, bytes), values);
        written += known + bytes;
    }
}

/// Members that all scenes of a frame share. Their cameras differ only in the pose.
fn block_of_frame(camera: &Camera, settings: &RenderSettings) -> CameraBlock {
    let shape = DrawnShape::of(settings);
    let CutLimits { low, high, opacity_logit, log_density } = settings.cut.limits();
    let whole = camera.whole();
    let dropout = settings.dropout.unwrap_or(Dropout { share: 0.0, seed: 0, iteration: 0 });
    CameraBlock {
        focal_px: [camera.fx, camera.fy],
        // COLMAP puts the centre of the first pixel at 0.5, the shaders at 0.
        center_px: [camera.cx - 0.5, camera.cy - 0.5],
        jacobian_limits: camera.jacobian_limits(settings.jacobian_limit),
        image_width: camera.width,
        image_height: camera.height,
        whole_width: whole.width,
        whole_height: whole.height,
        shape_scale: shape.scale,
        shape_dilation_px2: shape.dilation_px2,
        shape_opacity: shape.opacity,
        cut_low: low.to_array(),
        cut_high: high.to_array(),
        cut_opacity_logit: opacity_logit,
        cut_log_density: log_density,
        dropout_seed: dropout.seed,
        dropout_iteration: dropout.iteration,
        dropout_below: dropout.below(),
        dropout_factor: dropout.factor(),
        ..CameraBlock::zeroed()
    }
}

/// Sets the members that differ between the scenes of a frame.
#[inline]
fn set_scene(block: &mut CameraBlock, placed: &PlacedScene<'_>) {
    let PlacedScene { camera, scale, settings: scene, .. } = placed;
    let rows = camera.camera_from_world.transpose() * *scale;
    block.camera_row_x = rows.x_axis.to_array();
    block.camera_row_y = rows.y_axis.to_array();
    block.camera_row_z = rows.z_axis.to_array();
    block.camera_translation = camera.translation.to_array();
    block.inverse_scale_squared = (scale * scale).recip();
    block.scene_tint = scene.tint;
    block.scene_opacity = scene.opacity;
    block.selection_color = scene.selection.map_or([0.0; 3], |selection| selection.color);
    block.selection_share = scene.selection.map_or(0.0, |selection| selection.share);
    block.scene_first = placed.first;
    block.scene_count = placed.drawn_gaussians();
    block.scene_chunk_gaussians = placed.scene.plan.chunk_gaussians;
    block.scene_batch = placed.batch;
    block.scene_parameters = placed.parameters.begin;
    block.scene_first_cut_out = placed.first_cut_out;
    block.scene_cut_outs = scene.cut_out_count();
}

// Cut-outs of a frame's scenes in the layout that culling reads (cut_outs.glsl).

type Words = [[f32; 4]; c::CUT_OUT_PLANES as usize];

/// Bytes of a cut-out on the device.
pub(crate) const CUT_OUT_BYTES: u64 = size_of::<Words>() as u64;

/// Records the writes of all scenes' cut-outs. The caller places a barrier after it.
///
/// # Panics
/// If the buffer is too small.
pub(crate) fn record_cut_outs(r: &mut Recorder, inputs: &FrameInputs) {
    // The last scene's lie behind all others'.
    let end = inputs.scenes.last().map_or(0, |last| last.first_cut_out + last.settings.cut_out_count());
    let needed = u64::from(end) * CUT_OUT_BYTES;
    if needed == 0 {
        return;
    }
    let Some(buffer) = inputs.cut_outs.filter(|buffer| buffer.bytes() >= needed) else {
        panic!("FrameInputs::cut_outs is too small for {end} cut-outs, which take {needed} bytes");
    };
    for placed in inputs.scenes.iter().filter(|placed| placed.settings.cut_out_count() > 0) {
        let mut words = [Words::default(); MAX_CUT_OUTS];
        let own = placed.settings.cut_outs;
        for (words, cut_out) in words.iter_mut().zip(own) {
            *words = words_of(&cut_out.limits());
        }
        let (first, bytes) = (u64::from(placed.first_cut_out), own.len() as u64 * CUT_OUT_BYTES);
        r.update(&buffer.range(first * CUT_OUT_BYTES, bytes), bytemuck::cast_slice(&words[..own.len()]));
    }
}

fn words_of(limits: &CutOutLimits) -> Words {
    let CutOutLimits { center, rows, bounds, compared, inside } = *limits;
    let shape = match compared {
        Compared::Box => c::CUT_OUT_BOX,
        Compared::Ellipsoid => c::CUT_OUT_ELLIPSOID,
        Compared::HalfSpace => c::CUT_OUT_HALF_SPACE,
    };
    let removes = if inside == Inside::Removed { c::CUT_OUT_REMOVES } else { 0 };
    let with = |[x, y, z]: [f32; 3], w: f32| [x, y, z, w];
    let [x, y, z] = [0, 1, 2].map(|axis| with(rows[axis], center[axis]));
    [x, y, z, with(bounds, (shape + removes) as f32)]
}

// Indices of the scenes' first Gaussians in the frame, by which picks find the scene.

/// Number of indices that one command writes. They are gathered on the stack: 4 KiB.
const FIRSTS_AT_ONCE: usize = 1024;

/// Records the writes of all scenes' indices if the frame has picks. The caller places a barrier after it.
///
/// # Panics
/// If the buffer is too small.
pub(crate) fn record_scene_firsts(r: &mut Recorder, inputs: &FrameInputs) {
    if !inputs.outputs.pick {
        return;
    }
    let mut words = [0u32; FIRSTS_AT_ONCE];
    for (scenes, first) in inputs.scenes.chunks(FIRSTS_AT_ONCE).zip((0..).step_by(4 * FIRSTS_AT_ONCE)) {
        words.iter_mut().zip(scenes).for_each(|(word, placed)| *word = placed.first);
        let bytes = bytemuck::cast_slice(&words[..scenes.len()]);
        r.update(&inputs.buffers.scene_firsts.range(first, bytes.len() as u64), bytes);
    }
}
