//! `compose/compose_rgb10a2` against the twin of `compose/compose_rgba8`, with its own steps.

use ashsplat::ash::vk::Format;

use crate::common::compose::{
    BEHIND, EXPOSURE, IMAGE, LINEAR, SIZE, check_each, composed, composed_of, is_opaque, pixels,
};
use crate::common::gpu::Gpu;
use crate::reference::compose_rgba8::{compose, compose_linear};

const FORMAT: Format = Format::A2B10G10R10_UNORM_PACK32;

fn texels() -> Vec<u32> {
    (0..IMAGE[0] * IMAGE[1]).map(|i| i.wrapping_mul(0x9e37_79b9)).collect()
}

fn wide(texels: &[u32]) -> Vec<[f64; 4]> {
    let colors = |t: u32| [0, 10, 20].map(|first| f64::from(t >> first & 1023) / 1023.0);
    let texel = |&t: &u32| {
        let [r, g, b] = colors(t);
        [r, g, b, f64::from(t >> 30) / 3.0]
    };
    texels.iter().map(texel).collect()
}

#[test]
fn compose_rgb10a2_equals_its_twin() {
    let gpu = Gpu::new();
    let texels = texels();
    let tolerance = |channel, _| if channel == 3 { 0.501 / 3.0 } else { 0.51 / 1023.0 };
    for behind in BEHIND {
        let read = |after: Vec<u8>| wide(&bytemuck::pod_collect_to_vec::<_, u32>(&after));
        let after = read(composed(&gpu, FORMAT, bytemuck::cast_slice(&texels), behind));
        check_each(&wide(&texels), &after, behind, tolerance, compose);
        let linear = (behind, LINEAR);
        let after = read(composed_of(&gpu, &pixels(), FORMAT, bytemuck::cast_slice(&texels), linear));
        check_each(&wide(&texels), &after, behind, tolerance, |pixel, below| {
            compose_linear(pixel, below, is_opaque(behind), EXPOSURE.into())
        });
    }
}

/// Uncovered texels keep their bits.
#[test]
fn compose_rgb10a2_leaves_what_nothing_covers() {
    let gpu = Gpu::new();
    let nothing = vec![[0.0, 0.0, 0.0, 1.0]; (SIZE[0] * SIZE[1]) as usize];
    for round in 0..8_u32 {
        let texels: Vec<u32> = texels().iter().map(|t| t.rotate_left(4 * round) ^ round).collect();
        let bytes = bytemuck::cast_slice(&texels);
        for encoding in [ashsplat::ColorEncoding::AsTrained, LINEAR] {
            assert_eq!(composed_of(&gpu, &nothing, FORMAT, bytes, (BEHIND[2], encoding)), bytes);
        }
    }
}
