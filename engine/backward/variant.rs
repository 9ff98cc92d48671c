//! Variants of the kernels of the backward pass.

use crate::forward::RenderSettings;
use crate::kernels::constants::DILATION_PX2;

/// Parts of a frame's backward pass besides the gradients of the colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BackwardVariant {
    /// Gradients of the inverse depth.
    pub inverse_depth: bool,
    /// Same as [`BlendVariant::steep`](crate::forward::BlendVariant::steep).
    pub steep: bool,
    /// Gaussians have a 3D filter.
    pub filter_3d: bool,
    /// The low-pass filter differs from the reference's.
    pub own_dilation: bool,
    /// Same as [`BlendVariant::dropout`](crate::forward::BlendVariant::dropout).
    pub dropout: bool,
    /// Same as [`BlendVariant::z_record`](crate::forward::BlendVariant::z_record).
    pub z_record: bool,
}

impl BackwardVariant {
    /// Returns the variant of a frame with these settings.
    pub fn of(settings: &RenderSettings) -> Self {
        Self {
            inverse_depth: settings.inverse_depth,
            steep: settings.is_steep(),
            filter_3d: settings.filter_3d,
            own_dilation: settings.dilation_px2 != DILATION_PX2,
            dropout: settings.dropout.is_some(),
            z_record: settings.has_z_record(),
        }
    }
}
