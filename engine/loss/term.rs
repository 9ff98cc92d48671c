//! The loss as a sum of terms.

use super::DepthPointBuffers;
use crate::forward::FrameInputs;
use crate::vk::{Buffer, Recorder};

/// What a term reads and adds to, in one iteration.
#[derive(Clone, Copy)]
pub struct TermInputs<'a> {
    /// The frame, of which the forward pass precedes.
    pub frame: &'a FrameInputs<'a>,
    /// The picture. By [`PixelLayout::Rows`]: (r, g, b, 0) per pixel. [`PixelLayout::Native`]: see
    /// [`super::LossInputs::rendered`].
    pub picture: &'a Buffer,
    /// The view's photograph. By [`PixelLayout::Rows`]: (r, g, b, mask) per pixel, a byte each.
    /// [`PixelLayout::Native`]: see [`super::LossInputs::photo`].
    pub photo: &'a Buffer,
    /// In and out: the gradient. By [`PixelLayout::Rows`]: dL/d(r, g, b, inverse depth) per pixel, a vec4.
    /// [`PixelLayout::Native`]: see [`super::LossInputs::image_gradient`].
    pub image_gradient: &'a Buffer,
    /// Whether the photograph has a mask.
    pub photo_is_masked: bool,
    /// The view's inverse-depth map ([`TrainView::inverse_depth`](crate::TrainView::inverse_depth)), if it has one: a
    /// float per pixel, row by row.
    pub inverse_depth_map: Option<&'a Buffer>,
    /// The view's sparse points ([`TrainView::depth_points`](crate::TrainView::depth_points)), if it has any.
    pub depth_points: Option<&'a DepthPointBuffers>,
    /// The iteration, from 1.
    pub iteration: u32,
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

/// Layout of pictures, photographs and picture gradients.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelLayout {
    /// Row by row, pixel by pixel, the same on all devices. On processors they are converted for the term.
    #[default]
    Rows,
    /// That of the blending kernels: by rows, or in [`Strips`](crate::plan::Strips).
    Native,
}

/// What a term reads and adds to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Targets {
    /// The picture, the photograph and the picture's gradient, in this layout. None for a term that uses none
    /// of them; if it has a gradient of the inverse depth, that is by rows.
    pub picture: Option<PixelLayout>,
    /// The fourth component of the picture's gradient: dL/d(inverse depth). In the native layout of
    /// processors it is a fourth plane. `frame.frame.inverse_depth` is the sum of weights / z per pixel, row by
    /// row.
    pub inverse_depth: bool,
    /// With `inverse_depth`: `frame.frame.inverse_depth` is the sum of weights * z, the gradient is dL/d(that), and the term may
    /// write what the backward pass takes for the sum. Not beside another term with `inverse_depth`.
    pub linear_depth: bool,
    /// [`TermInputs::parameter_gradients`].
    pub parameters: bool,
}

impl Targets {
    /// Those of either; pictures by rows if either needs them.
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

    /// Whether pictures are converted for a term.
    pub fn rows(self) -> bool {
        self.picture == Some(PixelLayout::Rows) || (self.picture.is_none() && self.inverse_depth)
    }
}

/// A term of the training loss.
///
/// The first term of a loss writes the native gradient of the picture; later ones add to it. A gradient by rows
/// is the term's own: zero before the term, and added to those of all others after it. Gradients of parameters
/// are zero before the first term, and all terms add to them.
pub trait LossTerm: Send {
    /// Its name in reports and profiles.
    fn name(&self) -> &'static str;

    /// What it reads and adds to.
    fn targets(&self) -> Targets {
        Targets::default()
    }

    /// Names and bytes of its scratch buffers, for views of these sizes (width, height).
    fn scratch_requests(&self, sizes: &[(u32, u32)]) -> Vec<(&'static str, u64)>;

    /// Records its value and its gradient. The caller places barriers before and after. A frame that
    /// overflowed is run again, so the term must not change anything that outlives the iteration.
    fn record(&self, r: &mut Recorder, inputs: &TermInputs);
}
