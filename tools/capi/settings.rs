//! Render settings in C. Enumerations arrive as numbers and are checked here, because a C program may write any number.

use ashsplat::{Error, Extent, JacobianLimit, RenderSettings, Result, Shape};

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

/// How a frame is rendered; by default as scenes are trained and shown.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatRenderSettings {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// An AshsplatExtent.
    pub extent: u32,
    /// An AshsplatJacobianLimit.
    pub jacobian_limit: u32,
    /// An AshsplatShape.
    pub shape: u32,
    /// Highest evaluated SH degree: 3 for all stored degrees.
    pub sh_degree: u32,
    /// Whether opacities are compensated for the low-pass filter.
    pub antialias: bool,
    /// Whether the sum of weights / z is rendered as well: ashsplat_slot_inverse_depth.
    pub inverse_depth: bool,
    /// Factor of all scales: 1 for the scene as it is.
    pub scale_modifier: f32,
    /// The low-pass filter: variance that the projection adds along both axes, square pixels. 0 is as 0.3, the reference's;
    /// Mip-Splatting has 0.1.
    pub kernel_size: f32,
    /// Not 0: gradients take the compensation of `antialias` as a constant.
    pub antialias_detached: u32,
    /// Not 0: Gaussians are drawn with Mip-Splatting's 3D filter, whose sizes ashsplat_compute_filters gives them. Frames of such
    /// settings are reserved: AshsplatReservation.filter_3d.
    pub filter_3d: u32,
}

/// Returns the value of an enumeration's number.
pub(super) fn one_of<T: Copy>(what: impl std::fmt::Display, number: u32, values: &[T]) -> Result<T> {
    let found = values.get(number as usize).copied();
    found.ok_or_else(|| {
        Error::argument(what.to_string(), format!("{number}, there are 0 to {}", values.len() - 1))
    })
}

impl AshsplatRenderSettings {
    /// Converts to the engine's settings, with a black background.
    pub(super) fn checked(&self) -> Result<RenderSettings> {
        let standard = RenderSettings::default();
        let dilation_px2 = match self.kernel_size {
            0.0 => standard.dilation_px2,
            own if own.is_finite() && own > 0.0 => own,
            other => {
                let problem = format!("is {other}, must be finite and positive, or 0 for the default");
                return Err(Error::argument("settings.kernel_size", problem));
            }
        };
        Ok(RenderSettings {
            extent: one_of("settings.extent", self.extent, &[Extent::Exact, Extent::Reference])?,
            jacobian_limit: one_of(
                "settings.jacobian_limit",
                self.jacobian_limit,
                &[JacobianLimit::Edge, JacobianLimit::Symmetric],
            )?,
            shape: one_of("settings.shape", self.shape, &[Shape::Gaussian, Shape::Ellipsoid, Shape::Point])?,
            sh_degree: Some(self.sh_degree),
            scale_modifier: self.scale_modifier,
            antialias: self.antialias,
            inverse_depth: self.inverse_depth,
            dilation_px2,
            antialias_detached: self.antialias_detached != 0,
            filter_3d: self.filter_3d != 0,
            ..standard
        })
    }
}
