//! `compose/compose_rgba8` against its twin.

use ashsplat::ash::vk::Format;

use crate::common::compose::{
    BEHIND, EXPOSURE, IMAGE, LINEAR, OFFSET, SIZE, check, composed, composed_of, is_opaque, pixels,
};
use crate::common::gpu::Gpu;
use crate::reference::compose_rgba8::{compose, compose_linear, compose_linear_in_srgb};

/// A little more than half a step, for float32.
const TOLERANCE: f64 = 0.501 / 255.0;

fn texels() -> Vec<u8> {
    (0..IMAGE[0] * IMAGE[1] * 4).map(|i| (i * 37 % 256) as u8).collect()
}

/// Values of texels whose bytes have this order.
fn wide(texels: &[u8], order: [usize; 4]) -> Vec<[f64; 4]> {
    texels.as_chunks::<4>().0.iter().map(|t| order.map(|k| f64::from(t[k]) / 255.0)).collect()
}

/// All encodings in a plain and in an sRGB format.
pub fn equal_their_twins([plain, srgb]: [Format; 2], order: [usize; 4]) {
    let gpu = Gpu::new();
    let (texels, exposure) = (texels(), f64::from(EXPOSURE));
    let before = wide(&texels, order);
    for behind in BEHIND {
        let opaque = is_opaque(behind);
        // As trained, codes stay codes.
        for format in [plain, srgb] {
            let after = composed(&gpu, format, &texels, behind);
            check(&before, &wide(&after, order), behind, TOLERANCE, compose);
        }
        let linear = |format| wide(&composed_of(&gpu, &pixels(), format, &texels, (behind, LINEAR)), order);
        let twin = |pixel, below| compose_linear(pixel, below, opaque, exposure);
        check(&before, &linear(plain), behind, TOLERANCE, twin);
        let twin = |pixel, below| compose_linear_in_srgb(pixel, below, opaque, exposure);
        check(&before, &linear(srgb), behind, TOLERANCE, twin);
    }
}

#[test]
fn compose_rgba8_equals_its_twin() {
    equal_their_twins([Format::R8G8B8A8_UNORM, Format::R8G8B8A8_SRGB], [0, 1, 2, 3]);
}

/// Each of the 256 codes under uncovered pixels survives decoding and encoding.
#[test]
fn compose_rgba8_leaves_what_nothing_covers() {
    let gpu = Gpu::new();
    let nothing = vec![[0.0, 0.0, 0.0, 1.0]; (SIZE[0] * SIZE[1]) as usize];
    let inside = |x: u32, y: u32| {
        (OFFSET[0]..OFFSET[0] + SIZE[0]).contains(&x) && (OFFSET[1]..OFFSET[1] + SIZE[1]).contains(&y)
    };
    let mut texels = Vec::new();
    let mut code = 0_u32;
    for (y, x) in (0..IMAGE[1]).flat_map(|y| (0..IMAGE[0]).map(move |x| (y, x))) {
        texels.extend([code as u8, 255 - code as u8, (code * 7) as u8, 255]);
        code = (code + u32::from(inside(x, y))) % 256;
    }
    let after = composed_of(&gpu, &nothing, Format::R8G8B8A8_SRGB, &texels, (BEHIND[2], LINEAR));
    assert_eq!(after, texels);
}
