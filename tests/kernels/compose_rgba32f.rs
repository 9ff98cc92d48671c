//! `compose/compose_rgba32f` against its twin.

use ashsplat::ash::vk;

use crate::common::compose::{
    BEHIND, EXPOSURE, IMAGE, LINEAR, check, composed, composed_of, is_opaque, pixels,
};
use crate::common::gpu::Gpu;
use crate::reference::compose_rgba32f::{compose, compose_linear};

#[test]
fn compose_rgba32f_equals_its_twin() {
    let gpu = Gpu::new();
    let texels: Vec<f32> = (0..IMAGE[0] * IMAGE[1] * 4).map(|i| (i % 101) as f32 / 80.0 - 0.1).collect();
    let wide = |texels: &[f32]| -> Vec<[f64; 4]> {
        texels.as_chunks::<4>().0.iter().map(|t| t.map(f64::from)).collect()
    };
    for behind in BEHIND {
        let after = composed(&gpu, vk::Format::R32G32B32A32_SFLOAT, bytemuck::cast_slice(&texels), behind);
        let after: Vec<f32> = bytemuck::pod_collect_to_vec(&after);
        check(&wide(&texels), &wide(&after), behind, 1e-6, compose);
    }
}

/// Linear light: the kernel decodes after blending, and premultiplied colours before the product with alpha.
#[test]
fn compose_rgba32f_decodes_as_its_twin() {
    let gpu = Gpu::new();
    let texels: Vec<f32> = (0..IMAGE[0] * IMAGE[1] * 4).map(|i| (i % 101) as f32 / 80.0 - 0.1).collect();
    let wide = |texels: &[f32]| -> Vec<[f64; 4]> {
        texels.as_chunks::<4>().0.iter().map(|t| t.map(f64::from)).collect()
    };
    for behind in BEHIND {
        let format = vk::Format::R32G32B32A32_SFLOAT;
        let after = composed_of(&gpu, &pixels(), format, bytemuck::cast_slice(&texels), (behind, LINEAR));
        let after: Vec<f32> = bytemuck::pod_collect_to_vec(&after);
        check(&wide(&texels), &wide(&after), behind, 5e-6, |pixel, below| {
            compose_linear(pixel, below, is_opaque(behind), EXPOSURE.into())
        });
    }
}

#[test]
#[should_panic(expected = "expected")]
fn compose_rgba32f_is_told_from_a_mutated_twin() {
    let gpu = Gpu::new();
    let texels = vec![0.5f32; (IMAGE[0] * IMAGE[1] * 4) as usize];
    let after = composed(&gpu, vk::Format::R32G32B32A32_SFLOAT, bytemuck::cast_slice(&texels), BEHIND[2]);
    let after: Vec<f32> = bytemuck::pod_collect_to_vec(&after);
    let after: Vec<[f64; 4]> = after.as_chunks::<4>().0.iter().map(|t| t.map(f64::from)).collect();
    let before = vec![[0.5; 4]; after.len()];
    check(&before, &after, BEHIND[2], 1e-6, |pixel, behind| compose(pixel, behind.map(|x| 1.001 * x)));
}
