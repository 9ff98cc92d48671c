//! `loss/ssim_forward` against its twin.

use crate::common::compare::elementwise;
use crate::common::gpu::Gpu;
use crate::common::loss::{Pictures, SIZES, Window, forward};
use crate::reference::ssim_forward::ssim_forward;

/// Compares derivatives and partial sums of either kernel with the twin's.
pub fn check(gpu: &Gpu, pictures: &Pictures, window: Window) {
    let (derivatives, partials) = forward(gpu, pictures, window);
    let count = pictures.pixels();
    let derivatives = gpu.read::<f32>(&derivatives, window.derivative_words(pictures));
    assert!(window.derivatives_below(pictures).iter().all(|&place| derivatives[place] == 0.0));
    let per_channel = window.partials(pictures);
    let partials = gpu.read::<[f32; 2]>(&partials, 3 * per_channel);
    for channel in 0..3 {
        let [x, y] = pictures.planes(channel);
        let twin = ssim_forward(&x, &y);
        let place = |pixel: usize, k: usize| window.derivative_place(pictures, channel, pixel, k);
        let column = |k: usize| (0..count).map(|i| f64::from(derivatives[place(i, k)])).collect::<Vec<f64>>();
        for (k, expected) in [&twin.d_mean, &twin.d_square, &twin.d_product].into_iter().enumerate() {
            // The derivatives reach 1/C2 if a window has no variance.
            let largest = expected.iter().fold(1.0_f64, |largest, x| largest.max(x.abs()));
            elementwise("derivative", &column(k), expected, 1e-4 * largest, 1e-4)
                .expect("derivatives of SSIM");
        }
        let sums = &partials[channel * per_channel..(channel + 1) * per_channel];
        let sum = |k: usize| sums.iter().map(|s| f64::from(s[k])).sum::<f64>();
        let l1: f64 = x.values.iter().zip(&y.values).map(|(x, y)| (x - y).abs()).sum();
        elementwise("L1", &[sum(0)], &[l1], 0.0, 1e-5).expect("L1");
        elementwise("SSIM", &[sum(1)], &[twin.ssim.iter().sum()], 1e-5 * count as f64, 1e-5).expect("SSIM");
    }
}

#[test]
fn ssim_forward_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, strip) in SIZES.into_iter().flat_map(|size| [(size, 2), (size, 4), (size, 8)]) {
        check(&gpu, &Pictures::random(size), Window::Block { strip });
        check(&gpu, &Pictures::masked(size), Window::Block { strip });
    }
}
