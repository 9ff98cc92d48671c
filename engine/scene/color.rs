//! Display-encoded colours, as photographs hold them and splats are trained in them, and linear light.
//!
//! The curve is that of sRGB (IEC 61966-2-1). It is continued oddly below 0, and by the same power above 1.

use crate::error::{Error, Result};

/// Linear light from a display-encoded value: the electro-optical transfer function.
pub fn linear_from_srgb(encoded: f32) -> f32 {
    let size = encoded.abs();
    let light = if size <= 0.040_45 { size / 12.92 } else { ((size + 0.055) / 1.055).powf(2.4) };
    light.copysign(encoded)
}

/// A display-encoded value from linear light.
pub fn srgb_from_linear(light: f32) -> f32 {
    let size = light.abs();
    let encoded = if size <= 0.003_130_8 { 12.92 * size } else { 1.055 * size.powf(1.0 / 2.4) - 0.055 };
    encoded.copysign(light)
}

/// Linear light, premultiplied by alpha, from a display-encoded colour that is premultiplied: a f(C / a), with the curve f of
/// [`linear_from_srgb`]. Alpha is the share of the pixel that is covered, the same in both. 0 where nothing covers it.
pub fn linear_from_premultiplied([r, g, b]: [f32; 3], alpha: f32) -> [f32; 3] {
    [r, g, b].map(|channel| if alpha > 0.0 { alpha * linear_from_srgb(channel / alpha) } else { 0.0 })
}

/// What the colours are that are written into an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ColorEncoding {
    /// The values that the splats were trained in: those of photographs, display-encoded by the curve of sRGB. They are
    /// shown as they are. In an image of an sRGB format they are its codes.
    #[default]
    AsTrained,
    /// Linear light with the primaries of sRGB, for hosts that light, blend and expose in it. What splats have blended to is
    /// decoded, not each splat. An image of an sRGB format encodes it again, as it does what a host draws into it.
    LinearSrgb {
        /// Factor of the light: finite and positive; 1 leaves a photograph's white at 1.
        exposure: f32,
    },
}

impl ColorEncoding {
    /// Linear light in which a photograph's white is 1.
    pub const LINEAR: Self = Self::LinearSrgb { exposure: 1.0 };

    /// Checks the number.
    ///
    /// # Errors
    /// [`Error::Argument`] for an exposure that is not finite and positive.
    pub fn check(self) -> Result<()> {
        match self {
            Self::LinearSrgb { exposure } if !(exposure.is_finite() && exposure > 0.0) => {
                let problem = format!("is {exposure}, must be finite and positive");
                Err(Error::argument("exposure", problem))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of the standard, both sides of its threshold, and the way back.
    #[test]
    fn the_curve_is_that_of_the_standard() {
        let known =
            [(0.0, 0.0), (0.040_45, 0.003_130_805), (0.5, 0.214_041_14), (173.0 / 255.0, 0.417_885_1)];
        for (encoded, light) in known.into_iter().chain([(1.0, 1.0), (-0.5, -0.214_041_14)]) {
            let found = linear_from_srgb(encoded);
            assert!((found - light).abs() < 1e-6, "{encoded}: {found}, expected {light}");
        }
        for step in -300..600 {
            let encoded = step as f32 / 255.0;
            let back = srgb_from_linear(linear_from_srgb(encoded));
            assert!((back - encoded).abs() < 2e-6, "{encoded}: {back}");
        }
    }

    #[test]
    fn premultiplied_colours_are_decoded_as_what_covers() {
        assert_eq!(linear_from_premultiplied([0.0; 3], 0.0), [0.0; 3]);
        assert_eq!(linear_from_premultiplied([0.25, 0.5, 0.0], 0.5)[1], 0.5);
        let [half, ..] = linear_from_premultiplied([0.25, 0.5, 0.0], 0.5);
        assert!((half - 0.5 * 0.214_041_14).abs() < 1e-6, "{half}");
        // Not that of the product: a tenth of white is a tenth of its light.
        assert!((linear_from_premultiplied([0.1; 3], 0.1)[0] - 0.1).abs() < 1e-7);
    }

    #[test]
    fn exposures_are_checked() {
        assert!(ColorEncoding::AsTrained.check().is_ok() && ColorEncoding::LINEAR.check().is_ok());
        for exposure in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let error = ColorEncoding::LinearSrgb { exposure }.check().expect_err("refused").to_string();
            assert!(error.contains("must be finite and positive"), "{error}");
        }
    }
}
