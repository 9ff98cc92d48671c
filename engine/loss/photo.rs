//! Photographs as [`super::LossInputs::photo`] has them.

use super::Windowing;
use crate::plan::Strips;
use crate::vk::Limits;

/// Texels of planes in strips, which are read by 16 bytes.
const TEXEL_BYTES: u64 = 16;

/// Bytes of a photograph of 8 bits on a device.
pub fn photo_bytes(limits: &Limits, width: u32, height: u32, masked: bool) -> u64 {
    match Windowing::for_device(limits) {
        Windowing::Blocks => 4 * u64::from(width) * u64::from(height),
        Windowing::Sweeps => {
            let planes = if masked { 4 } else { 3 };
            (planes * Strips { width, height }.values()).next_multiple_of(TEXEL_BYTES)
        }
    }
}

/// A photograph of 8 bits as a device wants it, from (r, g, b, mask) per pixel: that itself, or planes in [`Strips`], which are
/// 0 where the mask is, with one more for the mask.
///
/// # Panics
/// When there are not as many pixels as the image has.
pub fn photo_on_device(limits: &Limits, width: u32, height: u32, masked: bool, rgbm: Vec<u8>) -> Vec<u8> {
    if Windowing::for_device(limits) == Windowing::Blocks {
        return rgbm;
    }
    let strips = Strips { width, height };
    let pixels = rgbm.as_chunks::<4>().0;
    let mut planes = if masked {
        let counted = |pixel: &[u8; 4]| if pixel[3] == 0 { [0; 4] } else { *pixel };
        strips.planes(&pixels.iter().map(counted).collect::<Vec<_>>())
    } else {
        strips.planes(&pixels.iter().map(|&[r, g, b, _]| [r, g, b]).collect::<Vec<_>>())
    };
    planes.resize(photo_bytes(limits, width, height, masked) as usize, 0);
    planes
}
