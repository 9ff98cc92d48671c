//! A rendered frame, with its counts and times.

use crate::vk::ScopeTime;

/// A rendered frame.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Row-major colours on the background, not clamped, display-encoded like the training photographs.
    /// [`linear_from_srgb`](crate::scene::linear_from_srgb) converts them to linear light.
    pub color: Vec<[f32; 3]>,
    /// Transmittance after the last Gaussian: 1 without any.
    pub transmittance: Vec<f32>,
    /// Sum of weights / z, if requested; with [`linear_depth`](crate::RenderSettings::linear_depth), sum of weights * z. The
    /// expected depth is the latter over 1 − transmittance.
    pub inverse_depth: Option<Vec<f32>>,
    /// Normals and depth of the surface, if requested.
    pub surface: Option<Surface>,
    /// Counts and times of the frame.
    pub stats: FrameStats,
}

/// Depth and normal of the surface at each pixel of a frame, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// Depth of the Gaussian behind which the transmittance is below that of [`SurfaceDepth`](crate::SurfaceDepth), along the view axis
    /// (in a panorama along the ray), world units. 0 where the transmittance stays above. It is the depth at which the Gaussian is
    /// densest on the pixel's ray, to first order; for lenses, that of its mean.
    pub depth: Vec<f32>,
    /// Mean of the Gaussians' normals, weighted as in blending, of unit length, in the scene's axes. A Gaussian's normal is its
    /// shortest axis, turned towards the camera. 0 where nothing is blended, or normals cancel out.
    pub normals: Vec<[f32; 3]>,
}

/// Number of samples (one Gaussian at one pixel) that the blending kernels compute, including those without effect. 0
/// unless the context's overrides set `COUNT_HITS` (see [`crate::vk::SpecOverride`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlendSamples {
    /// Samples of the forward pass.
    pub forward: u64,
    /// Samples of the backward pass.
    pub backward: u64,
}

/// Counts and times of a frame.
#[derive(Clone, Debug, Default)]
pub struct FrameStats {
    /// Gaussians in the scene.
    pub gaussians: u32,
    /// Visible Gaussians.
    pub visible: u32,
    /// (tile, Gaussian) instances.
    pub instances: u32,
    /// Entries of the longest tile.
    pub longest_tile: u32,
    /// Samples of blending, if counted.
    pub samples: BlendSamples,
    /// Device time per stage.
    pub scopes: Vec<ScopeTime>,
    /// Number of times the frame was run again because a capacity had to grow.
    pub retries: u32,
}
