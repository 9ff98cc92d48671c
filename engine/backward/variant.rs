//! Variants of the kernels of the backward pass.

use crate::forward::RenderSettings;
use crate::kernels::constants::DILATION_PX2;
use crate::plan::LaunchSizes;

/// What the backward pass of a frame needs besides gradients of the colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BackwardVariant {
    /// Gradients of the inverse depth.
    pub inverse_depth: bool,
    /// As [`BlendVariant::steep`](crate::forward::BlendVariant::steep).
    pub steep: bool,
    /// Gaussians have a 3D filter.
    pub filter_3d: bool,
    /// The low-pass filter is another than the reference's.
    pub own_dilation: bool,
    /// As [`BlendVariant::dropout`](crate::forward::BlendVariant::dropout).
    pub dropout: bool,
    /// As [`BlendVariant::z_record`](crate::forward::BlendVariant::z_record).
    pub z_record: bool,
}

impl BackwardVariant {
    /// That of a frame.
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

    pub(super) fn of_project(self, absolute: bool, pose_gradient: bool) -> usize {
        usize::from(self.filter_3d)
            | usize::from(self.own_dilation) << 1
            | usize::from(self.dropout) << 2
            | usize::from(self.z_record) << 3
            | usize::from(absolute) << 4
            | usize::from(pose_gradient) << 5
    }

    pub(super) fn index(self, sizes: &LaunchSizes) -> usize {
        usize::from(self.inverse_depth) | usize::from(self.steep && sizes.incremental_exp) << 1
    }
}
