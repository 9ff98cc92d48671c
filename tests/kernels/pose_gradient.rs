//! `poses/pose_gradient` against its twin.

use crate::common::compare::elementwise;
use crate::common::gpu::Gpu;
use crate::common::poses::pose_gradient;
use crate::common::scenes::Random;
use crate::reference::pose_gradient::{gradient_of_parameters, total};

fn six(random: &mut Random, scale: f64) -> [f32; 6] {
    [0; 6].map(|_| (scale * random.signed()) as f32)
}

#[test]
pub fn pose_gradient_equals_its_twin() {
    let gpu = Gpu::new();
    let mut random = Random::new(5);
    // No motion, small ones, and turns of more than half a circle.
    for (count, size) in [(0, 0.1), (1, 0.0), (2, 0.01), (63, 0.3), (64, 1.0), (1000, 1.7), (30_001, 0.1)] {
        let sums: Vec<[f32; 6]> = (0..count).map(|_| six(&mut random, 1.0)).collect();
        let parameters: Vec<[f32; 6]> = (0..3).map(|_| six(&mut random, size)).collect();
        let wide: Vec<[f64; 6]> = sums.iter().map(|sum| sum.map(f64::from)).collect();
        let g = total(&wide);
        for image in 0..3 {
            let xi = parameters[image as usize].map(f64::from);
            let expected = gradient_of_parameters(xi, g);
            let [actual, of_parameters] = pose_gradient(&gpu, &sums, &parameters, image);
            let largest = |values: [f64; 6]| values.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            // The sums have both signs, hence an absolute bound.
            let bound = 1e-5 * f64::from(count).sqrt() + 1e-5 * largest(g);
            elementwise("g", &actual, &g, bound, 0.0).unwrap_or_else(|e| panic!("{count}: {e}"));
            let bound = bound + 2e-6 * largest(expected);
            elementwise("dL/dxi", &of_parameters, &expected, bound, 0.0)
                .unwrap_or_else(|e| panic!("{count}, {xi:?}: {e}"));
            if size == 0.0 {
                assert_eq!(actual, of_parameters);
            }
        }
    }
}
