//! Cut-outs of a frame's scenes in the layout that culling reads (cut_outs.glsl).

use super::inputs::FrameInputs;
use crate::kernels::constants as c;
use crate::scene::cut_out::Compared;
use crate::scene::{CutOutLimits, Inside, MAX_CUT_OUTS};
use crate::vk::Recorder;

type Words = [[f32; 4]; c::CUT_OUT_PLANES as usize];

/// Bytes of a cut-out on the device.
pub(crate) const CUT_OUT_BYTES: u64 = size_of::<Words>() as u64;

/// Records the writes of all scenes' cut-outs. The caller places a barrier after it.
///
/// # Panics
/// If the buffer is too small.
pub(super) fn record(r: &mut Recorder, inputs: &FrameInputs) {
    // The last scene's lie behind all others'.
    let end = inputs.scenes.last().map_or(0, |last| last.first_cut_out + last.settings.cut_out_count());
    let needed = u64::from(end) * CUT_OUT_BYTES;
    if needed == 0 {
        return;
    }
    let Some(buffer) = inputs.cut_outs.filter(|buffer| buffer.bytes() >= needed) else {
        panic!("FrameInputs::cut_outs has no room for {end} cut-outs, which take {needed} bytes");
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
