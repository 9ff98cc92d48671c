//! `loss/ssim_backward` against its twin.

use crate::common::compare::{GradientTolerance, gradient};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::loss::{Pictures, SIZES, WEIGHT, Window, backward};
use crate::reference::ssim_backward::ssim_backward;
use crate::reference::ssim_forward::{SsimPlane, ssim_forward};

/// Tolerance of a float32 gradient.
pub const TOLERANCE: GradientTolerance = GradientTolerance { relative_l2: 2e-5, max_over_max: 2e-5 };

/// Compares the gradient of either kernel with the twin's.
pub fn check(gpu: &Gpu, pictures: &Pictures, window: Window) {
    let count = pictures.pixels();
    // Uses the twin's derivatives, so that the test judges only this kernel.
    let twins: Vec<SsimPlane> = (0..3)
        .map(|channel| {
            let [x, y] = pictures.planes(channel);
            ssim_forward(&x, &y)
        })
        .collect();
    let of_pixel = |t: &SsimPlane, i: usize| [t.d_mean[i], t.d_square[i], t.d_product[i]].map(|x| x as f32);
    let mut derivatives = vec![f32::NAN; window.derivative_words(pictures)];
    for place in window.derivatives_below(pictures) {
        derivatives[place] = 0.0;
    }
    for (channel, t) in twins.iter().enumerate() {
        for i in 0..count {
            for (k, value) in of_pixel(t, i).into_iter().enumerate() {
                derivatives[window.derivative_place(pictures, channel, i, k)] = value;
            }
        }
    }
    let derivatives = gpu.buffer("derivatives", &derivatives);
    for lambda in [0.2, 0.0, 1.0] {
        let actual = backward(gpu, pictures, &derivatives, window, lambda);
        let fourth = if let Window::Block { .. } = window { UNTOUCHED } else { 0 };
        assert!(actual.iter().all(|d| d[3].to_bits() == fourth));
        for channel in 0..3 {
            let [x, y] = pictures.planes(channel);
            let lambda = f64::from(lambda);
            let expected = ssim_backward(&x, &y, &twins[channel], lambda, 3 * count);
            let mut expected: Vec<f64> = expected.iter().map(|d| f64::from(WEIGHT) * d).collect();
            let mut actual: Vec<f64> = actual.iter().map(|d| f64::from(d[channel])).collect();
            for i in 0..count {
                if !pictures.counts(i) {
                    assert_eq!(actual[i], 0.0, "gradient where the mask is");
                    expected[i] = 0.0;
                }
                // Rounding decides the sign of a difference near zero.
                if (x.values[i] - y.values[i]).abs() < 1e-6 {
                    (expected[i], actual[i]) = (0.0, 0.0);
                }
            }
            gradient("image", &actual, &expected, &vec![false; count], TOLERANCE)
                .expect("gradient of the loss");
        }
    }
}

#[test]
fn ssim_backward_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, strip) in SIZES.into_iter().flat_map(|size| [(size, 2), (size, 4), (size, 8)]) {
        check(&gpu, &Pictures::random(size), Window::Block { strip });
        check(&gpu, &Pictures::masked(size), Window::Block { strip });
    }
}
