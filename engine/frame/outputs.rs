//! Outputs of blending besides the picture, on request: the Gaussian of the largest weight, the mean motion, and the surface
//! (blend_auxiliary.glsl).

use super::FrameInputs;
use crate::vk::Recorder;

/// Outputs of a frame besides the picture. By default there are none, and the kernels are those of a plain frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    /// Gaussian of the largest weight per pixel.
    pub pick: bool,
    /// Mean motion per pixel.
    pub motion: bool,
    /// Normal and median depth per pixel.
    pub surface: bool,
}

impl Outputs {
    /// True if there is an output.
    pub fn any(self) -> bool {
        self != Self::default()
    }

    /// Returns the outputs of both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            pick: self.pick || other.pick,
            motion: self.motion || other.motion,
            surface: self.surface || other.surface,
        }
    }
}

/// Number of indices that one command writes. They are gathered on the stack: 4 KiB.
const FIRSTS_AT_ONCE: usize = 1024;

/// Records the indices of the scenes' first Gaussians, by which picks find the scene. The caller places a barrier after it.
///
/// # Panics
/// If the buffer is too small.
pub(crate) fn record_scene_firsts(r: &mut Recorder, inputs: &FrameInputs) {
    if !inputs.outputs.pick {
        return;
    }
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
        r.update(&inputs.frame.scene_firsts.range(first, bytes.len() as u64), bytes);
        first += bytes.len() as u64;
    }
}
