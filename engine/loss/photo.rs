//! Photographs as [`super::LossInputs::photo`] has them.

use super::Windowing;
use crate::plan::Strips;

/// Texels of planes in strips, which are read by 16 bytes.
const TEXEL_BYTES: u64 = 16;

/// Bytes of a photograph of 8 bits on the device; `masked`: for [`PhotoFormat::MaskedRgba8`](super::PhotoFormat).
pub fn photo_bytes(windowing: Windowing, width: u32, height: u32, masked: bool) -> u64 {
    match windowing {
        Windowing::Blocks => 4 * u64::from(width) * u64::from(height),
        Windowing::Sweeps => {
            let planes = if masked { 4 } else { 3 };
            (planes * Strips { width, height }.values()).next_multiple_of(TEXEL_BYTES)
        }
    }
}

/// A photograph of 8 bits as the device wants it, from (r, g, b, mask) per pixel: that itself, or planes in [`Strips`], which are
/// 0 where the mask is, with one more for the mask if it is `masked`, for [`PhotoFormat::MaskedRgba8`](super::PhotoFormat).
///
/// # Panics
/// When there are not as many pixels as the image has.
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
