//! Precision of image formats.

use ashsplat::ash::vk::Format;

/// Previous contents of the host's image; exact in formats of floats.
pub const BELOW: [f32; 4] = [0.25, 0.5, 0.75, 1.0];
/// The same for formats of codes. Neither the values nor their linear light lie midway between two codes, where
/// devices may round either way.
const BELOW_CODES: [f32; 4] = [79.0 / 255.0, 85.0 / 255.0, 177.0 / 255.0, 1.0];

pub fn is_srgb(format: Format) -> bool {
    matches!(format, Format::R8G8B8A8_SRGB | Format::B8G8R8A8_SRGB)
}

/// Largest rounding error of a format: half the distance between its values. The device's conversion to 16-bit
/// floats may also truncate.
pub fn rounding(format: Format, channel: usize, value: f64) -> f64 {
    let float =
        |mantissa: i32| 2f64.powi(-mantissa - 1) * 2f64.powf(value.max(2f64.powi(-14)).log2().floor());
    match format {
        Format::R32G32B32A32_SFLOAT => 0.0,
        Format::R16G16B16A16_SFLOAT => 2.0 * float(10),
        Format::B10G11R11_UFLOAT_PACK32 => float(if channel == 2 { 5 } else { 6 }),
        Format::A2B10G10R10_UNORM_PACK32 if channel == 3 => 0.5 / 3.0,
        Format::A2B10G10R10_UNORM_PACK32 => 0.5 / 1023.0,
        _ => 0.5 / 255.0,
    }
}

/// Number of steps between 0 and 1 of a normalised format.
pub fn unorm_steps(format: Format) -> Option<f64> {
    match format {
        Format::B10G11R11_UFLOAT_PACK32 | Format::R16G16B16A16_SFLOAT | Format::R32G32B32A32_SFLOAT => None,
        Format::A2B10G10R10_UNORM_PACK32 => Some(1023.0),
        _ => Some(255.0),
    }
}

/// Clear colour for an image of this format.
pub fn cleared(format: Format) -> [f32; 4] {
    if unorm_steps(format).is_some() { BELOW_CODES } else { BELOW }
}
