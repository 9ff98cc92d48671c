//! Outputs of blending besides the picture, on request: the Gaussian of the largest weight, and the mean motion
//! (blend_auxiliary.glsl).

use super::{FrameCapacity, FrameInputs};
use crate::vk::{Buffer, Recorder};

/// Outputs of a frame besides the picture. By default there are none, and the kernels are those of a plain frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    /// Gaussian of the largest weight per pixel.
    pub pick: bool,
    /// Mean motion per pixel.
    pub motion: bool,
}

impl Outputs {
    /// True if there is an output.
    pub fn any(self) -> bool {
        self != Self::default()
    }

    /// Names and bytes of the buffers of [`OutputMemory`], in order.
    pub(crate) fn requests(self, capacity: &FrameCapacity) -> Vec<(&'static str, u64)> {
        let pixels = capacity.pictures.pixels;
        let mut requests = Vec::new();
        if self.pick {
            requests.extend([("picks", pixels * 8), ("scene_firsts", u64::from(capacity.scenes) * 4)]);
        }
        if self.motion {
            requests.extend([("motions", u64::from(capacity.visible) * 8), ("motion_sums", pixels * 8)]);
        }
        requests
    }
}

/// Reserved buffers of outputs.
#[derive(Clone)]
pub(crate) struct OutputMemory {
    /// See [`PickBuffers`].
    picks: Option<[Buffer; 2]>,
    /// See [`MotionBuffers`].
    motion: Option<[Buffer; 2]>,
}

impl OutputMemory {
    /// Assigns the buffers that were allocated for [`Outputs::requests`].
    pub fn from_allocated(reserved: Outputs, mut buffers: impl Iterator<Item = Buffer>) -> Self {
        let mut next = |reserved: bool| match reserved {
            true => buffers.next().zip(buffers.next()).map(<[_; 2]>::from),
            false => None,
        };
        Self { picks: next(reserved.pick), motion: next(reserved.motion) }
    }

    /// Returns the buffers of the outputs that a frame writes.
    pub fn of(&self, written: Outputs) -> Auxiliary<'_> {
        let (picks, motion) = (self.picks.as_ref(), self.motion.as_ref());
        Auxiliary {
            picks: picks
                .filter(|_| written.pick)
                .map(|[picks, scene_firsts]| PickBuffers { picks, scene_firsts }),
            motion: motion.filter(|_| written.motion).map(|[motions, sums]| MotionBuffers { motions, sums }),
        }
    }
}

/// Buffers of a frame's outputs.
#[derive(Clone, Copy, Default)]
pub struct Auxiliary<'a> {
    /// See [`Outputs::pick`].
    pub picks: Option<PickBuffers<'a>>,
    /// See [`Outputs::motion`].
    pub motion: Option<MotionBuffers<'a>>,
}

impl Auxiliary<'_> {
    /// Returns the outputs that have buffers.
    pub fn kinds(&self) -> Outputs {
        Outputs { pick: self.picks.is_some(), motion: self.motion.is_some() }
    }
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

/// Number of indices that one command writes. They are gathered on the stack: 4 KiB.
const FIRSTS_AT_ONCE: usize = 1024;

/// Records the indices of the scenes' first Gaussians, by which picks find the scene. The caller places a barrier after it.
///
/// # Panics
/// If the buffer is too small.
pub(crate) fn record_scene_firsts(r: &mut Recorder, inputs: &FrameInputs) {
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
