//! How each Gaussian is drawn, and the scalars for it.

use super::RenderSettings;

/// How each Gaussian is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shape {
    /// The Gaussian itself.
    #[default]
    Gaussian,
    /// An opaque ellipsoid of the Gaussian's colour. Its surface lies at [`ELLIPSOID_SIGMAS`] standard
    /// deviations, with a soft rim of a few percent of that. Gaussians with an opacity below
    /// [`ELLIPSOID_LEAST_OPACITY`](crate::kernels::constants::ELLIPSOID_LEAST_OPACITY) are not drawn. An ellipsoid has the depth of its mean, as a Gaussian
    /// does.
    Ellipsoid,
    /// An opaque dot of the Gaussian's colour at its mean, about [`POINT_RADIUS_PX`] pixels in radius.
    Point,
}

/// Standard deviations at which the surface of [`Shape::Ellipsoid`] lies.
pub const ELLIPSOID_SIGMAS: f32 = 2.0;
/// Radius of [`Shape::Point`], pixels.
pub const POINT_RADIUS_PX: f32 = 1.5;

/// Logarithm of the opacity that turns a Gaussian into a disc. `exp(STEEPNESS - d²/2)` stays above 1 until
/// d = √(2 STEEPNESS). It is below 1/255 at √(2 (STEEPNESS + ln 255)), 7 % farther out. The value is well
/// within float32.
const STEEPNESS: f32 = 40.0;
/// The same for points, whose rim is one pixel wide.
const POINT_STEEPNESS: f32 = 3.75;

/// How the kernels draw a shape: the members of camera_block.glsl.
pub(super) struct DrawnShape {
    /// Factor of the scales.
    pub scale: f32,
    /// Term added to both screen variances.
    pub dilation_px2: f32,
    /// Opacity override; 0 for none.
    pub opacity: f32,
}

impl DrawnShape {
    pub fn of(settings: &RenderSettings) -> Self {
        let RenderSettings { scale_modifier, dilation_px2, .. } = *settings;
        match settings.shape {
            Shape::Gaussian => Self { scale: scale_modifier, dilation_px2, opacity: 0.0 },
            Shape::Ellipsoid => {
                // Standard deviations at which alpha is about one half.
                let reach = (2.0 * (STEEPNESS + 0.5f32.recip().ln())).sqrt();
                let shrink = ELLIPSOID_SIGMAS / reach;
                Self {
                    scale: scale_modifier * shrink,
                    dilation_px2: dilation_px2 * shrink * shrink,
                    // Negative: excludes Gaussians of low opacity.
                    opacity: -STEEPNESS.exp(),
                }
            }
            Shape::Point => {
                let reach2 = 2.0 * (POINT_STEEPNESS + 0.5f32.recip().ln());
                Self {
                    scale: 0.0,
                    dilation_px2: POINT_RADIUS_PX * POINT_RADIUS_PX / reach2,
                    opacity: POINT_STEEPNESS.exp(),
                }
            }
        }
    }
}
