//! How a frame is rendered, in C. Enumerations arrive as numbers, for a C program may write any: they are checked here.

use super::{AshsplatStatus, borrowed_mut, guarded};
use ashsplat::{Background, ColorEncoding, Error, Extent, JacobianLimit, RenderSettings, Result, Shape};

/// What the splats are composited over.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatBackground {
    /// A background colour; the result is opaque.
    Color = 0,
    /// Nothing: premultiplied colour and alpha.
    Nothing = 1,
    /// The image's content.
    Image = 2,
}

/// What the colours are that are written into a target.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatColorEncoding {
    /// The values that the splats were trained in: those of photographs, display-encoded by the curve of sRGB.
    AsTrained = 0,
    /// Linear light with the primaries of sRGB, decoded after blending; what is premultiplied is decoded before the product
    /// with alpha. A target of an sRGB format encodes it again.
    LinearSrgb = 1,
}

/// At which pixels a Gaussian counts.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatExtent {
    /// Wherever its alpha is at least 1/255.
    Exact = 0,
    /// In the tiles of the reference implementation's square of three standard deviations.
    Reference = 1,
}

/// Directions within which the projection is linearised at the Gaussian itself. Outside, it is linearised at
/// the limit.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatJacobianLimit {
    /// The picture's edges and 0.3 tan(fov/2) beyond.
    Edge = 0,
    /// 1.3 tan(fov/2) on either side of the optical axis, as the reference implementation does.
    Symmetric = 1,
}

/// How each Gaussian is drawn.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatShape {
    /// The Gaussian itself.
    Gaussian = 0,
    /// An opaque ellipsoid of two standard deviations.
    Ellipsoid = 1,
    /// An opaque dot.
    Point = 2,
}

/// How a frame is rendered; ashsplat_render_settings fills in the defaults.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatRenderSettings {
    /// An AshsplatExtent.
    pub extent: u32,
    /// An AshsplatJacobianLimit.
    pub jacobian_limit: u32,
    /// An AshsplatShape.
    pub shape: u32,
    /// Highest evaluated SH degree: 3 for all stored degrees.
    pub sh_degree: u32,
    /// Factor of all scales: 1 for the scene as it is.
    pub scale_modifier: f32,
    /// Whether opacities are compensated for the low-pass filter.
    pub antialias: bool,
    /// Whether the sum of weights / z is rendered as well: ashsplat_slot_inverse_depth.
    pub inverse_depth: bool,
}

/// The meaning of a number that stands for one of an enumeration.
pub(super) fn one_of<T: Copy>(what: &str, number: u32, values: &[T]) -> Result<T> {
    let found = values.get(number as usize).copied();
    found.ok_or_else(|| Error::argument(what, format!("{number}, there are 0 to {}", values.len() - 1)))
}

impl AshsplatRenderSettings {
    /// As the library has them; on a black background.
    pub(super) fn checked(&self) -> Result<RenderSettings> {
        Ok(RenderSettings {
            extent: one_of("extent", self.extent, &[Extent::Exact, Extent::Reference])?,
            jacobian_limit: one_of(
                "jacobian_limit",
                self.jacobian_limit,
                &[JacobianLimit::Edge, JacobianLimit::Symmetric],
            )?,
            shape: one_of("shape", self.shape, &[Shape::Gaussian, Shape::Ellipsoid, Shape::Point])?,
            sh_degree: Some(self.sh_degree),
            scale_modifier: self.scale_modifier,
            antialias: self.antialias,
            inverse_depth: self.inverse_depth,
            ..RenderSettings::default()
        })
    }
}

/// What lies behind the splats, from an AshsplatBackground's number.
pub(super) fn behind(number: u32, background: [f32; 3]) -> Result<Background> {
    one_of("behind", number, &[Background::Color(background), Background::Nothing, Background::Image])
}

/// What the target's colours are, from an AshsplatColorEncoding's number.
pub(super) fn encoding(number: u32, exposure: f32) -> Result<ColorEncoding> {
    one_of("encoding", number, &[ColorEncoding::AsTrained, ColorEncoding::LinearSrgb { exposure }])
}

/// The default settings, with which scenes are trained and shown.
///
/// # Safety
/// `settings` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_render_settings(settings: *mut AshsplatRenderSettings) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        *borrowed_mut(settings, "settings")? = AshsplatRenderSettings {
            extent: AshsplatExtent::Exact as u32,
            jacobian_limit: AshsplatJacobianLimit::Edge as u32,
            shape: AshsplatShape::Gaussian as u32,
            sh_degree: 3,
            scale_modifier: 1.0,
            antialias: false,
            inverse_depth: false,
        };
        Ok(())
    })
}
