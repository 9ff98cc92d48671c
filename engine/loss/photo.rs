//! Photographs in the layout of [`super::LossInputs::photo`].

use super::Windowing;
use crate::plan::Strips;

/// Bytes of a texel of planes in strips.
const TEXEL_BYTES: u64 = 16;

/// Device bytes of a photograph with 8 bits per channel; `masked`: for
/// [`PhotoFormat::MaskedRgba8`](super::PhotoFormat).
pub fn photo_bytes(windowing: Windowing, width: u32, height: u32, masked: bool) -> u64 {
    match windowing {
        Windowing::Blocks => 4 * u64::from(width) * u64::from(height),
        Windowing::Sweeps => {
            let planes = if masked { 4 } else { 3 };
            (planes * Strips { width, height }.values()).next_multiple_of(TEXEL_BYTES)
        }
    }
}

/// Converts a photograph with 8 bits per channel, (r, g, b, mask) per pixel, to the device's layout: unchanged, or planes in
/// [`Strips`]. The planes are 0 where the mask is 0. With `masked`, a further plane holds the mask, for
/// [`PhotoFormat::MaskedRgba8`](super::PhotoFormat).
///
/// # Panics
/// If the number of pixels differs from the image's.
pub fn photo_on_device(
    windowing: Windowing,
    width: u32,
    height: u32,
    masked: bool,
    rgbm: Vec<u8>,
) -> Vec<u8> {
    if windowing == Windowing::Blocks {
        return rgbm;
    }
    let strips = Strips { width, height };
    let pixels = rgbm.as_chunks::<4>().0.iter();
    let mut planes = match masked {
        true => strips.planes(pixels.map(|&pixel| if pixel[3] == 0 { [0; 4] } else { pixel })),
        false => strips.planes(pixels.map(|&[r, g, b, _]| [r, g, b])),
    };
    planes.resize(photo_bytes(windowing, width, height, masked) as usize, 0);
    planes
}
