//! `loss/ssim_backward` against its twin.

use crate::common::compare::{GradientTolerance, gradient};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::loss::{Pictures, SIZES, backward};
use crate::reference::ssim_backward::ssim_backward;
use crate::reference::ssim_forward::{SsimPlane, ssim_forward};

const TOLERANCE: GradientTolerance = GradientTolerance { relative_l2: 2e-5, max_over_max: 2e-5 };

#[test]
fn ssim_backward_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, strip) in SIZES.into_iter().flat_map(|size| [(size, 2), (size, 4), (size, 8)]) {
        let pictures = Pictures::random(size);
        let count = pictures.pixels();
        // From the twin's maps, so that only this kernel is judged.
        let twins: Vec<SsimPlane> = (0..3)
            .map(|channel| {
                let [x, y] = pictures.planes(channel);
                ssim_forward(&x, &y)
            })
            .collect();
        let map = |name, of: fn(&SsimPlane) -> &[f64]| {
            let values: Vec<f32> = twins.iter().flat_map(|t| of(t).iter().map(|&x| x as f32)).collect();
            gpu.buffer(name, &values)
        };
        let maps = [
            map("by_mean", |t| &t.d_mean),
            map("by_square", |t| &t.d_square),
            map("by_product", |t| &t.d_product),
        ];
        for lambda in [0.2, 0.0, 1.0] {
            let actual = backward(&gpu, &pictures, &maps, strip, lambda);
            assert!(actual.iter().all(|d| d[3].to_bits() == UNTOUCHED));
            for channel in 0..3 {
                let [x, y] = pictures.planes(channel);
                let lambda = f64::from(lambda);
                let mut expected = ssim_backward(&x, &y, &twins[channel], lambda, 3 * count);
                let mut actual: Vec<f64> = actual.iter().map(|d| f64::from(d[channel])).collect();
                for i in 0..count {
                    // The sign of a difference within rounding of zero.
                    if (x.values[i] - y.values[i]).abs() < 1e-6 {
                        (expected[i], actual[i]) = (0.0, 0.0);
                    }
                }
                gradient("image", &actual, &expected, &vec![false; count], TOLERANCE)
                    .expect("gradient of the loss");
            }
        }
    }
}
