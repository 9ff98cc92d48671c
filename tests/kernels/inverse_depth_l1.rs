//! `loss/inverse_depth_l1` against its twin.

use super::picture_to_rows::SIZES;
use crate::common::compare::elementwise;
use crate::common::gpu::Gpu;
use crate::common::inverse_depth::inverse_depth_l1;
use crate::common::scenes::Random;
use crate::reference::inverse_depth_l1::inverse_depth_l1 as twin;

#[test]
fn inverse_depth_l1_equals_its_twin() {
    let gpu = Gpu::new();
    // The last has more pixels than invocations.
    let large = [300, 2 * gpu.workgroup(64) + 40];
    for ([width, height], strips) in
        SIZES.into_iter().chain([large]).flat_map(|size| [(size, true), (size, false)])
    {
        let size = [width as usize, height as usize];
        let pixels = size[0] * size[1];
        let mut random = Random::new(u64::from(width));
        let depth: Vec<f32> = (0..pixels).map(|_| random.unit() as f32).collect();
        let targets: Vec<f32> = (0..pixels)
            .map(|pixel| match random.below(4) {
                0 => f32::INFINITY,
                1 => depth[pixel],
                _ => random.signed() as f32,
            })
            .collect();
        // A power of two, so that the sum with the previous value is exact.
        let weight = 0.25 * pixels as f64;
        let (loss, added) = inverse_depth_l1(&gpu, &depth, &targets, size, (weight, strips, 0.5));
        let wide: Vec<f64> = depth.into_iter().map(f64::from).collect();
        let targets: Vec<Option<f64>> =
            targets.iter().map(|&x| x.is_finite().then_some(f64::from(x))).collect();
        let (expected_loss, expected) = twin(&wide, &targets, weight);
        elementwise("loss", &[loss], &[expected_loss], 1e-6, 1e-6).expect("the loss");
        elementwise("gradient", &added, &expected, 1e-7, 1e-6).expect("the gradient");
    }
}
