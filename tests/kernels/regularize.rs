//! `loss/regularize` against its twin.

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, sizes};
use crate::common::regularizers::regularize;
use crate::common::scenes::{Random, mixed_scene};
use crate::reference;
use crate::reference::types::Gaussian;

#[test]
fn regularize_equals_its_twin() {
    let gpu = Gpu::new();
    let workgroup = gpu.workgroup(64) as usize;
    // The last has more Gaussians than invocations.
    for size in sizes(workgroup).into_iter().filter(|&size| size > 0).chain([700 * workgroup + 1]) {
        let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 1);
        if size > 2 {
            gaussians[0].opacity_logit = 80.0;
            gaussians[2].opacity_logit = -80.0;
        }
        let weights = [0.01, 0.3];
        let (_, actual) = regularize(&gpu, &gaussians, weights);
        let expected = reference::regularize::regularize(&gaussians, weights).gradients;
        let values = |all: &[Gaussian]| -> Vec<f64> {
            all.iter()
                .flat_map(|g| [g.log_scale[0], g.log_scale[1], g.log_scale[2], g.opacity_logit])
                .collect()
        };
        let tolerance = 1e-7 / size as f64;
        elementwise("gradient", &values(&actual), &values(&expected), tolerance, 2e-6).expect("gradients");
        let untouched = |g: &Gaussian| g.mean == [0.0; 3] && g.quat == [0.0; 4];
        assert!(actual.iter().all(untouched), "gradients that the regularisers do not have");
    }
}
