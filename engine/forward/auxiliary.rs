//! Further outputs of blending on request: the Gaussian of the largest weight, and the mean motion.

use super::inputs::FrameInputs;
use crate::scene::{Camera, Pose};
use crate::vk::{Buffer, Recorder};

/// Further outputs of a frame besides the picture. By default there are none, and the kernels are those of a plain frame.
#[derive(Clone, Copy, Default)]
pub struct Auxiliary<'a> {
    /// Gaussian of the largest weight per pixel.
    pub picks: Option<PickBuffers<'a>>,
    /// Mean motion per pixel.
    pub motion: Option<MotionBuffers<'a>>,
}

/// Buffers of picking.
#[derive(Clone, Copy)]
pub struct PickBuffers<'a> {
    /// Per pixel: 1 + index of the Gaussian in its tile's list, 0 for none; bits of its weight. 8 bytes.
    pub picks: &'a Buffer,
    /// Per scene: index of its first Gaussian in the frame, 4 bytes.
    pub scene_firsts: &'a Buffer,
}

/// Buffers of motion.
#[derive(Clone, Copy)]
pub struct MotionBuffers<'a> {
    /// Per visible Gaussian: motion on the screen, px, 8 bytes.
    pub motions: &'a Buffer,
    /// Per pixel: sum of weights * motions, px, 8 bytes.
    pub sums: &'a Buffer,
}

/// View of a scene in its own axes.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Camera in the scene's own axes and origin, in world units.
    pub camera: Camera,
    /// World units per unit of the scene.
    pub scale: f32,
}

/// View of a scene in the previous frame.
#[derive(Clone, Copy, Debug)]
pub struct Before<'a> {
    /// Camera of the previous frame.
    pub camera: &'a Camera,
    /// Pose of the scene in the previous frame.
    pub pose: &'a Pose,
}

impl Before<'_> {
    pub(super) fn seen(&self) -> Seen {
        Seen { camera: self.pose.camera_in_object(self.camera), scale: self.pose.scale }
    }
}

/// Number of indices that one command writes. They are gathered on the stack: 4 KiB.
const FIRSTS_AT_ONCE: usize = 1024;

/// Records the indices of the scenes' first Gaussians, by which picks find the scene. The caller places a barrier after it.
///
/// # Panics
/// If the buffer is too small.
pub(super) fn record_firsts(r: &mut Recorder, inputs: &FrameInputs) {
    let Some(PickBuffers { scene_firsts, .. }) = inputs.auxiliary.picks else { return };
    let (mut placed, mut first, mut words) = (inputs.scenes.iter(), 0, [0u32; FIRSTS_AT_ONCE]);
    loop {
        let mut count = 0;
        for (word, placed) in words.iter_mut().zip(&mut placed) {
            *word = placed.first;
            count += 1;
        }
        if count == 0 {
            return;
        }
        let bytes = bytemuck::cast_slice(&words[..count]);
        r.update(&scene_firsts.range(first, bytes.len() as u64), bytes);
        first += bytes.len() as u64;
    }
}
