//! What formats of images hold.

use ashsplat::ash::vk::Format;

/// What the host has in its image before, as it sees it: a format of floats holds these exactly.
pub const BELOW: [f32; 4] = [0.25, 0.5, 0.75, 1.0];
/// The same in a format of codes: none of them, nor their linear light, lies midway between two codes. Devices round that up or
/// down.
const BELOW_CODES: [f32; 4] = [79.0 / 255.0, 85.0 / 255.0, 177.0 / 255.0, 1.0];

pub fn is_srgb(format: Format) -> bool {
    matches!(format, Format::R8G8B8A8_SRGB | Format::B8G8R8A8_SRGB)
}

/// How far a format's numbers may lie from what they stand for: half of their distance. The device's own conversion to
/// 16-bit floats may also cut off.
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

/// Steps between 0 and 1 of a format that has no more.
pub fn unorm_steps(format: Format) -> Option<f64> {
    match format {
        Format::B10G11R11_UFLOAT_PACK32 | Format::R16G16B16A16_SFLOAT | Format::R32G32B32A32_SFLOAT => None,
        Format::A2B10G10R10_UNORM_PACK32 => Some(1023.0),
        _ => Some(255.0),
    }
}

/// What an image of this format is cleared with.
pub fn cleared(format: Format) -> [f32; 4] {
    if unorm_steps(format).is_some() { BELOW_CODES } else { BELOW }
}
