//! The loss as a sum of terms.

use crate::forward::FrameInputs;
use crate::vk::{Buffer, Recorder};

/// What a term reads and adds to, in one iteration.
#[derive(Clone, Copy)]
pub struct TermInputs<'a> {
    /// The frame, of which the forward pass precedes.
    pub frame: &'a FrameInputs<'a>,
    /// dL/d(r, g, b) in the layout of [`Backward::record`](crate::backward::Backward::record); with a term that
    /// has [`Targets::inverse_depth`], dL/d(r, g, b, inverse depth).
    pub image_gradient: &'a Buffer,
    /// The view's photograph: see [`super::LossInputs::photo`].
    pub photo: &'a Buffer,
    /// Whether the photograph has a mask.
    pub photo_is_masked: bool,
    /// Per chunk of the scene: dL/d(mean, opacity logit), dL/d(quaternion), dL/d(log-scale), laid out like the
    /// scene's first three planes. Empty unless a term has [`Targets::parameters`].
    pub parameter_gradients: &'a [Buffer],
    /// The buffers of [`LossTerm::scratch_requests`].
    pub scratch: &'a [Buffer],
    /// Out: vec4 (the term's weighted value, up to three numbers of its own) per term.
    pub losses: &'a Buffer,
    /// The term's row in `losses`.
    pub row: u32,
}

/// Gradients that a term adds to, besides that of the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Targets {
    /// The fourth component of the image's gradient: dL/d(inverse depth).
    pub inverse_depth: bool,
    /// [`TermInputs::parameter_gradients`].
    pub parameters: bool,
}

impl Targets {
    /// Those of either.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            inverse_depth: self.inverse_depth || other.inverse_depth,
            parameters: self.parameters || other.parameters,
        }
    }
}

/// A term of the training loss.
///
/// The first term of a loss writes the picture's gradient, all others add to it. The gradients named by
/// [`LossTerm::targets`] are zero before the first term, and each term adds to them.
pub trait LossTerm: Send {
    /// Its name in reports and profiles.
    fn name(&self) -> &'static str;

    /// The gradients it adds to.
    fn targets(&self) -> Targets {
        Targets::default()
    }

    /// Names and bytes of its scratch buffers, for views of these sizes (width, height).
    fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)>;

    /// Records its value and its gradient. The caller places barriers before and after. A frame that
    /// overflowed is run again, so the term must not change anything that outlives the iteration.
    fn record(&self, r: &mut Recorder, inputs: &TermInputs);
}
