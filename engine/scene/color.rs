//! Display-encoded colours, as in photographs and trained splats, and linear light.
//!
//! The curve is that of sRGB (IEC 61966-2-1). Below 0 it is odd, and above 1 it continues with the same power.

use crate::error::{Error, Result};

/// Converts a display-encoded value to linear light: the electro-optical transfer function.
pub fn linear_from_srgb(encoded: f32) -> f32 {
    let size = encoded.abs();
    let light = if size <= 0.040_45 { size / 12.92 } else { libm::powf((size + 0.055) / 1.055, 2.4) };
    light.copysign(encoded)
}

/// Converts linear light to a display-encoded value.
pub fn srgb_from_linear(light: f32) -> f32 {
    let size = light.abs();
    let encoded =
        if size <= 0.003_130_8 { 12.92 * size } else { 1.055 * libm::powf(size, 1.0 / 2.4) - 0.055 };
    encoded.copysign(light)
}

/// Converts a premultiplied display-encoded colour to premultiplied linear light: a f(C / a), with the curve f of
/// [`linear_from_srgb`]. Alpha, the covered share of the pixel, is the same in both. 0 if nothing covers the pixel.
pub fn linear_from_premultiplied([r, g, b]: [f32; 3], alpha: f32) -> [f32; 3] {
    [r, g, b].map(|channel| if alpha > 0.0 { alpha * linear_from_srgb(channel / alpha) } else { 0.0 })
}

/// Encoding of the colours in a written image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ColorEncoding {
    /// Values of the training photographs, display-encoded by the curve of sRGB, and shown unchanged. An image of an sRGB
    /// format stores them as they are, without encoding them again.
    #[default]
    AsTrained,
    /// Linear light with the primaries of sRGB, for hosts that light, blend and expose in it. The blended colour is decoded,
    /// not each splat. An image of an sRGB format encodes it again, like everything that a host draws into it.
    LinearSrgb {
        /// Factor of the light: finite and positive. 1 leaves a photograph's white at 1.
        exposure: f32,
    },
}

impl ColorEncoding {
    /// Linear light in which a photograph's white is 1.
    pub const LINEAR: Self = Self::LinearSrgb { exposure: 1.0 };

    /// Refuses an exposure that is not finite and positive.
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

    /// Values of the standard, on both sides of its threshold, and the inverse.
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
        // The product is not decoded: a tenth of white is a tenth of its light.
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
