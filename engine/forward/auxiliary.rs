//! What blending leaves beside the picture where a host wants it: the Gaussian of the largest weight, and the mean motion.

use super::inputs::FrameInputs;
use crate::scene::{Camera, Pose};
use crate::vk::{Buffer, Recorder};

/// What a frame leaves beside the picture. The default is nothing, by the kernels of a frame without.
#[derive(Clone, Copy, Default)]
pub struct Auxiliary<'a> {
    /// The Gaussian of the largest weight.
    pub picks: Option<PickBuffers<'a>>,
    /// The mean motion.
    pub motion: Option<MotionBuffers<'a>>,
}

/// The buffers of picking.
#[derive(Clone, Copy)]
pub struct PickBuffers<'a> {
    /// Per pixel: 1 + place of the Gaussian in its tile's list, 0 for none, and the bits of its weight: 8 bytes.
    pub picks: &'a Buffer,
    /// Per scene: the index of its first Gaussian among all of the frame, 4 bytes.
    pub scene_firsts: &'a Buffer,
}

/// The buffers of motion.
#[derive(Clone, Copy)]
pub struct MotionBuffers<'a> {
    /// Per visible Gaussian: its motion on the screen, px, 8 bytes.
    pub motions: &'a Buffer,
    /// Per pixel: the sum of weights * motions, px, 8 bytes.
    pub sums: &'a Buffer,
}

/// How a scene is seen.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// The camera in the scene's own axes and origin, in world units.
    pub camera: Camera,
    /// World units per unit of the scene.
    pub scale: f32,
}

/// How a scene was seen in the frame before.
#[derive(Clone, Copy, Debug)]
pub struct Before<'a> {
    /// The frame's camera.
    pub camera: &'a Camera,
    /// The scene's pose.
    pub pose: &'a Pose,
}

impl Before<'_> {
    pub(super) fn seen(&self) -> Seen {
        Seen { camera: self.pose.camera_in_object(self.camera), scale: self.pose.scale }
    }
}

/// How many of them one command writes. They are gathered on the stack: 4 KiB.
const FIRSTS_AT_ONCE: usize = 1024;

/// Records the writes of the scenes' first Gaussians, by which picks find the scene. The caller places a barrier after it.
///
/// # Panics
/// Without room for them.
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
