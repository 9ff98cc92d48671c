//! `compose/compose_rgba16f` against the twin of `compose/compose_rgba32f`, rounded to the image's format.

use ashsplat::ash::vk;

use crate::common::compose::{
    BEHIND, EXPOSURE, IMAGE, LINEAR, SIZE, check, composed, composed_of, is_opaque, pixels,
};
use crate::common::gpu::Gpu;
use crate::reference::compose_rgba32f::{compose, compose_linear};

/// Value of a half float that is finite.
fn from_half(bits: u16) -> f64 {
    let (exponent, mantissa) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    let size = match exponent {
        0 => mantissa * 2f64.powi(-24),
        _ => (1024.0 + mantissa) * 2f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}

#[test]
fn compose_rgba16f_equals_its_twin() {
    let gpu = Gpu::new();
    // Values from 0.5 to just below 2.
    let texels: Vec<u16> = (0..IMAGE[0] * IMAGE[1] * 4).map(|i| 0x3800 + (i % 2048) as u16).collect();
    let wide = |texels: &[u16]| -> Vec<[f64; 4]> {
        texels.as_chunks::<4>().0.iter().map(|t| t.map(from_half)).collect()
    };
    for behind in BEHIND {
        let after = composed(&gpu, vk::Format::R16G16B16A16_SFLOAT, bytemuck::cast_slice(&texels), behind);
        let after: Vec<u16> = bytemuck::pod_collect_to_vec(&after);
        // Half a unit in the last place below 4.
        check(&wide(&texels), &wide(&after), behind, 1.1e-3, compose);
        let linear = (behind, LINEAR);
        let format = vk::Format::R16G16B16A16_SFLOAT;
        let after = composed_of(&gpu, &pixels(), format, bytemuck::cast_slice(&texels), linear);
        let after: Vec<u16> = bytemuck::pod_collect_to_vec(&after);
        check(&wide(&texels), &wide(&after), behind, 1.1e-3, |pixel, below| {
            compose_linear(pixel, below, is_opaque(behind), EXPOSURE.into())
        });
    }
}

/// Colours above the format's largest number become that number, not infinity.
#[test]
fn compose_rgba16f_stays_finite() {
    let gpu = Gpu::new();
    let texels = vec![0x3800_u16; (IMAGE[0] * IMAGE[1] * 4) as usize];
    let bright = vec![[1e30, 65504.0, 66000.0, 0.5]; (SIZE[0] * SIZE[1]) as usize];
    for behind in BEHIND {
        let format = vk::Format::R16G16B16A16_SFLOAT;
        let onto = (behind, ashsplat::ColorEncoding::AsTrained);
        let after = composed_of(&gpu, &bright, format, bytemuck::cast_slice(&texels), onto);
        let after: Vec<u16> = bytemuck::pod_collect_to_vec(&after);
        let changed: Vec<_> = after.as_chunks::<4>().0.iter().filter(|t| t[0] != 0x3800).collect();
        assert_eq!(changed.len(), bright.len());
        assert!(changed.iter().all(|t| t[..3] == [0x7bff; 3]), "{behind:?}: {:x?}", changed[0]);
    }
}
