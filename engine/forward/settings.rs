//! Render settings of a frame.

use super::shape::Shape;
use crate::error::{Error, Result};
use crate::kernels::constants as c;
use crate::scene::Cut;

/// Pixels at which a Gaussian counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Extent {
    /// All pixels where its alpha is at least 1/255.
    #[default]
    Exact,
    /// Pixels of the tiles that touch the reference implementation's square of three standard deviations, for parity with the
    /// reference.
    Reference,
}

/// Directions in which the projection is linearised at the Gaussian itself. Beyond, it is linearised at the limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JacobianLimit {
    /// Up to 0.3 tan(fov/2) outside the image's edges.
    #[default]
    Edge,
    /// ±1.3 tan(fov/2) around the optical axis. This is the reference's limit, also for off-centre cameras.
    Symmetric,
}

/// Render settings of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Pixels at which a Gaussian counts.
    pub extent: Extent,
    /// Limits of the projection's linearisation.
    pub jacobian_limit: JacobianLimit,
    /// Opacity compensation for the low-pass filter (Mip-Splatting's 2D filter).
    pub antialias: bool,
    /// True if gradients treat that compensation as a constant. The kernels of gsplat and Mip-Splatting differentiate it.
    pub antialias_detached: bool,
    /// Variance that the low-pass filter of the projection adds along both axes, square pixels. 0.3 in the reference, 0.1 in
    /// Mip-Splatting (its `kernel_size`).
    pub dilation_px2: f32,
    /// Draws Gaussians with Mip-Splatting's 3D filter. [`Renderer::compute_filters`](crate::Renderer::compute_filters) sets its
    /// sizes; Gaussians without a size are drawn unfiltered.
    pub filter_3d: bool,
    /// Background colour, display-encoded like the training photographs.
    pub background: [f32; 3],
    /// Highest evaluated SH degree; `None` for all stored degrees.
    pub sh_degree: Option<u32>,
    /// Also renders the sum of weights / z.
    pub inverse_depth: bool,
    /// Shape that represents each Gaussian.
    pub shape: Shape,
    /// Factor of all scales; 1 leaves the scene unchanged.
    pub scale_modifier: f32,
    /// Volume and limits that remove Gaussians.
    pub cut: Cut,
    /// Random omission of Gaussians, for training frames.
    pub dropout: Option<Dropout>,
    /// With `inverse_depth`: renders the sum of weights * z instead, which is also differentiable. Not for recorded frames,
    /// which have depth images of their own.
    pub linear_depth: bool,
}

/// Random omission of Gaussians, each with the same probability (DropGaussian, Park et al. 2025, section 3.2). The opacities of
/// the others are divided by the probability to stay. They may then exceed 1, but alpha stays below 0.99. The same key omits
/// the same Gaussians, by index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dropout {
    /// Probability of omission: 0 to below 1.
    pub share: f64,
    /// Key of the random numbers.
    pub seed: u32,
    /// Key of the random numbers, one per frame.
    pub iteration: u32,
}

impl Dropout {
    /// 24-bit random numbers below this omit a Gaussian.
    pub(super) fn below(self) -> u32 {
        (self.share * f64::from(1 << 24)).round() as u32
    }

    /// Factor of the opacities, from the rounded probability.
    pub(super) fn factor(self) -> f32 {
        (1.0 / (1.0 - f64::from(self.below()) / f64::from(1 << 24))) as f32
    }
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            extent: Extent::default(),
            jacobian_limit: JacobianLimit::default(),
            antialias: false,
            antialias_detached: false,
            dilation_px2: c::DILATION_PX2,
            filter_3d: false,
            background: [0.0; 3],
            sh_degree: None,
            inverse_depth: false,
            shape: Shape::default(),
            scale_modifier: 1.0,
            cut: Cut::default(),
            dropout: None,
            linear_depth: false,
        }
    }
}

impl RenderSettings {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`Error::Argument`] for a scale modifier that is negative or not finite, a dilation that is not positive and finite, a
    /// background that is not finite, a dropout of almost all, or an invalid cut.
    pub fn check(&self) -> Result<()> {
        if !(self.scale_modifier.is_finite() && self.scale_modifier >= 0.0) {
            let problem = format!("is {}, must be finite and not negative", self.scale_modifier);
            return Err(Error::argument("scale_modifier", problem));
        }
        if !(self.dilation_px2.is_finite() && self.dilation_px2 > 0.0) {
            let problem = format!("is {}, must be finite and positive", self.dilation_px2);
            return Err(Error::argument("dilation_px2", problem));
        }
        if let Some(degree) = self.sh_degree.filter(|degree| *degree > 3) {
            return Err(Error::argument("sh_degree", format!("{degree} is above 3")));
        }
        if self.background.iter().any(|channel| !channel.is_finite()) {
            return Err(Error::argument("background", format!("{:?} is not finite", self.background)));
        }
        if let Some(Dropout { share, .. }) =
            self.dropout.filter(|dropout| !(0.0..=0.99).contains(&dropout.share))
        {
            return Err(Error::argument("dropout.share", format!("is {share}, must be 0 to 0.99")));
        }
        self.cut.check().map_err(|error| error.within("cut"))
    }

    /// True if the settings draw the Gaussians themselves, so that the picture is differentiable.
    pub fn is_faithful(&self) -> bool {
        self.shape == Shape::Gaussian && self.scale_modifier == 1.0
    }

    /// True if splats may be steeper than the reference's low-pass filter allows.
    pub(crate) fn is_steep(&self) -> bool {
        self.shape == Shape::Ellipsoid || self.dilation_px2 < c::DILATION_PX2
    }

    /// True if the splats' records have z in place of 1/z.
    pub(crate) fn has_z_record(&self) -> bool {
        self.inverse_depth && self.linear_depth
    }

    /// Values on which culling and projection branch: extent and antialias.
    pub(super) fn modes(&self) -> [u32; 2] {
        [self.extent_word(), self.antialias_bits()]
    }

    /// Returns the ANTIALIAS_ bits.
    pub(crate) fn antialias_bits(&self) -> u32 {
        let bit = |on: bool, bit: u32| if on { bit } else { 0 };
        bit(self.antialias, c::ANTIALIAS_COMPENSATED) | bit(self.antialias_detached, c::ANTIALIAS_DETACHED)
    }

    pub(super) fn extent_word(&self) -> u32 {
        match self.extent {
            Extent::Exact => c::EXTENT_EXACT,
            Extent::Reference => c::EXTENT_REFERENCE,
        }
    }
}
