//! Shapes that represent Gaussians, and their scalars for the kernels.

use super::RenderSettings;

/// Shape that represents each Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shape {
    /// The Gaussian itself.
    #[default]
    Gaussian,
    /// An opaque ellipsoid of the Gaussian's colour. Its surface lies at [`ELLIPSOID_SIGMAS`] standard deviations, with a soft
    /// rim of a few percent of that. Gaussians with an opacity below
    /// [`ELLIPSOID_LEAST_OPACITY`](crate::kernels::constants::ELLIPSOID_LEAST_OPACITY) are not drawn. Its depth is that of its
    /// mean, like a Gaussian's.
    Ellipsoid,
    /// An opaque dot of the Gaussian's colour at its mean, about [`POINT_RADIUS_PX`] pixels in radius.
    Point,
}

/// Distance of the surface of [`Shape::Ellipsoid`] from the mean, in standard deviations.
pub const ELLIPSOID_SIGMAS: f32 = 2.0;
/// Radius of [`Shape::Point`], pixels.
pub const POINT_RADIUS_PX: f32 = 1.5;

/// Logarithm of the opacity that turns a Gaussian into a disc. `exp(STEEPNESS - d²/2)` stays above 1 until d = √(2 STEEPNESS).
/// It is below 1/255 at √(2 (STEEPNESS + ln 255)), 7 % farther out. The value fits float32 well.
const STEEPNESS: f32 = 40.0;
/// Same as [`STEEPNESS`], but for points, whose rim is one pixel wide.
const POINT_STEEPNESS: f32 = 3.75;

/// Scalars of a shape in the camera block (camera_block.glsl).
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
                    // A negative value excludes Gaussians of low opacity.
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
