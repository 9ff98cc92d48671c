//! `loss/sparse_depth` against its twin.

use crate::common::compare::elementwise;
use crate::common::depth_points::{Depths, random_points, sparse_depth};
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::sparse_depth::loss;

#[test]
fn sparse_depth_equals_its_twin() {
    let gpu = Gpu::new();
    // The last has more points than invocations.
    let many = 256 * gpu.workgroup(64) as usize + 40;
    for (size, count) in [([1, 1], 1), ([17, 9], 3), ([40, 30], 700), ([33, 70], many)] {
        let mut random = Random::new(count as u64);
        let depths = Depths::random(&mut random, size);
        let points = random_points(&mut random, count, size);
        let weight = 0.5 * count as f64;
        let (actual, gradients) = sparse_depth(&gpu, &depths, &points, weight);
        let (expected, each) = loss(&depths.expected(), size, &points, weight);
        elementwise("loss", &[actual], &[expected], 1e-6, 2e-6).expect("the loss");
        let expected: Vec<f64> = each.iter().map(|[_, gradient]| *gradient).collect();
        elementwise("gradient", &gradients, &expected, 1e-6, 2e-5).expect("the gradient");
        assert!(count < 100 || expected.iter().any(|&gradient| gradient > 0.0));
        assert!(count < 100 || expected.iter().any(|&gradient| gradient < 0.0));
    }
}

/// A point where nothing is drawn has inverse depth 0 and no gradient.
#[test]
fn sparse_depth_of_nothing_has_no_gradient() {
    let gpu = Gpu::new();
    let size = [6, 5];
    let depths = Depths { size, sums: vec![0.0; 30], transmittances: vec![1.0; 30] };
    let points = random_points(&mut Random::new(3), 20, size);
    let (actual, gradients) = sparse_depth(&gpu, &depths, &points, 2.0);
    let expected = 2.0 * points.iter().map(|point| point.inverse_z).sum::<f64>() / 20.0;
    elementwise("loss", &[actual], &[expected], 1e-6, 1e-6).expect("the loss");
    assert!(gradients.iter().all(|&gradient| gradient == 0.0));
}
