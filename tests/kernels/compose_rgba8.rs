//! `compose/compose_rgba8` against its twin.

use ashsplat::ash::vk;

use crate::common::compose::{BEHIND, IMAGE, check, composed};
use crate::common::gpu::Gpu;
use crate::reference::compose_rgba8::compose;

#[test]
fn compose_rgba8_equals_its_twin() {
    let gpu = Gpu::new();
    let texels: Vec<u8> = (0..IMAGE[0] * IMAGE[1] * 4).map(|i| (i * 37 % 256) as u8).collect();
    let wide = |texels: &[u8]| -> Vec<[f64; 4]> {
        texels.as_chunks::<4>().0.iter().map(|t| t.map(|x| f64::from(x) / 255.0)).collect()
    };
    for behind in BEHIND {
        let after = composed(&gpu, vk::Format::R8G8B8A8_UNORM, &texels, behind);
        check(&wide(&texels), &wide(&after), behind, 0.51 / 255.0, compose);
    }
}
