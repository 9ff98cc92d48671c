//! The loss as a sum of terms.

use super::DepthPointBuffers;
use crate::forward::FrameInputs;
use crate::vk::{Buffer, Recorder};

/// Inputs and outputs of a term in one iteration.
#[derive(Clone, Copy)]
pub struct TermInputs<'a> {
    /// Frame whose forward pass precedes.
    pub frame: &'a FrameInputs<'a>,
    /// Picture of the frame. [`PixelLayout::Rows`]: (r, g, b, 0) per pixel. [`PixelLayout::Native`]: see
    /// [`super::LossInputs::rendered`].
    pub picture: &'a Buffer,
    /// Photograph of the view. [`PixelLayout::Rows`]: (r, g, b, mask) per pixel, a byte each. [`PixelLayout::Native`]: see
    /// [`super::LossInputs::photo`].
    pub photo: &'a Buffer,
    /// In and out: the gradient. [`PixelLayout::Rows`]: dL/d(r, g, b, inverse depth) per pixel, a vec4.
    /// [`PixelLayout::Native`]: see [`super::LossInputs::image_gradient`].
    pub image_gradient: &'a Buffer,
    /// True if the photograph has a mask.
    pub photo_is_masked: bool,
    /// Inverse-depth map of the view ([`TrainView::inverse_depth`](crate::TrainView::inverse_depth)), if any: a float per
    /// pixel, row by row.
    pub inverse_depth_map: Option<&'a Buffer>,
    /// Sparse points of the view ([`TrainView::depth_points`](crate::TrainView::depth_points)), if any.
    pub depth_points: Option<&'a DepthPointBuffers>,
    /// Iteration, counted from 1.
    pub iteration: u32,
    /// Per chunk of the scene: dL/d(mean, opacity logit), dL/d(quaternion), dL/d(log-scale), laid out like the
    /// scene's first three planes. Empty unless a term has [`Targets::parameters`].
    pub parameter_gradients: &'a [Buffer],
    /// Buffers of [`LossTerm::scratch_requests`].
    pub scratch: &'a [Buffer],
    /// Out: vec4 (weighted value of the term, up to three further values) per term.
    pub losses: &'a Buffer,
    /// Row of the term in `losses`.
    pub row: u32,
}

/// Layout of pictures, photographs and picture gradients.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelLayout {
    /// Row by row, pixel by pixel, the same on all devices. On processors the trainer converts to and from rows.
    #[default]
    Rows,
    /// Layout of the blending kernels: by rows, or in [`Strips`](crate::plan::Strips).
    Native,
}

/// Data that a term reads and adds to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Targets {
    /// Layout of the picture, the photograph and the picture's gradient. None for a term that uses none of them; a gradient of
    /// the inverse depth is then by rows.
    pub picture: Option<PixelLayout>,
    /// True if the term writes the fourth component of the picture's gradient: dL/d(inverse depth). In the native layout of
    /// processors it is a fourth plane. `frame.frame.inverse_depth` is the sum of weights / z per pixel, row by row.
    pub inverse_depth: bool,
    /// With `inverse_depth`: `frame.frame.inverse_depth` is the sum of weights * z, and the gradient is with respect to that
    /// sum. The term may overwrite the value that the backward pass takes for the sum. Excludes other terms with
    /// `inverse_depth`.
    pub linear_depth: bool,
    /// True if the term adds to [`TermInputs::parameter_gradients`].
    pub parameters: bool,
}

impl Targets {
    /// Returns the union of both; pictures are by rows if either needs rows.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            picture: match self.rows() || other.rows() {
                true => Some(PixelLayout::Rows),
                false => self.picture.or(other.picture),
            },
            inverse_depth: self.inverse_depth || other.inverse_depth,
            linear_depth: self.linear_depth || other.linear_depth,
            parameters: self.parameters || other.parameters,
        }
    }

    /// True if pictures are converted to rows for a term.
    pub fn rows(self) -> bool {
        self.picture == Some(PixelLayout::Rows) || (self.picture.is_none() && self.inverse_depth)
    }
}

/// A term of the training loss.
///
/// The first term of a loss writes the native gradient of the picture; later ones add to it. A gradient by rows belongs to one
/// term: it is zero before the term, and then added to the sum of the others. Gradients of parameters are zero before the first
/// term, and all terms add to them.
pub trait LossTerm: Send {
    /// Name in reports and profiles.
    fn name(&self) -> &'static str;

    /// Data that the term reads and adds to.
    fn targets(&self) -> Targets {
        Targets::default()
    }

    /// Names and bytes of the scratch buffers, for views of these sizes (width, height).
    fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)>;

    /// Records the value and the gradient. The caller places barriers before and after. A frame that overflowed is repeated, so
    /// the term must not change anything that outlives the iteration.
    fn record(&self, r: &mut Recorder, inputs: &TermInputs);
}
