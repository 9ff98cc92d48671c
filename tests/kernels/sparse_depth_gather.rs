//! `loss/sparse_depth_gather` against its twin.

use crate::common::compare::elementwise;
use crate::common::depth_points::{Depths, random_points, sparse_depth_gather};
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::sparse_depth::corners;
use crate::reference::sparse_depth_gather::gather;

#[test]
fn sparse_depth_gather_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, count) in [([1, 1], 1), ([17, 9], 3), ([40, 30], 700), ([33, 70], 9000)] {
        let mut random = Random::new(count as u64);
        let depths = Depths::random(&mut random, size);
        let points = random_points(&mut random, count, size);
        let of_points: Vec<f32> = (0..count).map(|_| random.signed() as f32).collect();
        let wide: Vec<f64> = of_points.iter().map(|&x| f64::from(x)).collect();
        let of_expected = gather(&points, &wide, size);
        let coverages = depths.transmittances.iter().map(|&t| 1.0 - f64::from(t));
        let expected: Vec<f64> = of_expected
            .iter()
            .zip(coverages)
            .map(|(gradient, coverage)| if coverage > 1e-10 { gradient / coverage } else { 0.0 })
            .collect();
        let mut sampled = vec![false; size[0] * size[1]];
        for point in &points {
            corners(point.position_px, size).into_iter().for_each(|(at, _)| sampled[at] = true);
        }
        for strips in [false, true] {
            let (added, sums) = sparse_depth_gather(&gpu, &depths, (&points, &of_points), (strips, 0.0));
            let largest = expected.iter().fold(1.0_f64, |most, x| most.max(x.abs()));
            elementwise("gradient", &added, &expected, 2e-6 * largest, 2e-5).expect("the gradient");
            let after = depths.expected();
            for (pixel, &sum) in sums.iter().enumerate() {
                match sampled[pixel] {
                    true => assert!((f64::from(sum) - after[pixel]).abs() <= 1e-5 * after[pixel], "{pixel}"),
                    false => assert_eq!(sum.to_bits(), depths.sums[pixel].to_bits(), "{pixel}"),
                }
            }
        }
    }
}

/// The gradients of other terms stay.
#[test]
fn sparse_depth_gather_adds() {
    let gpu = Gpu::new();
    let size = [9, 9];
    let depths = Depths { size, sums: vec![1.0; 81], transmittances: vec![0.5; 81] };
    let points = random_points(&mut Random::new(4), 12, size);
    for strips in [false, true] {
        let of = |before: f32| sparse_depth_gather(&gpu, &depths, (&points, &[0.25; 12]), (strips, before)).0;
        elementwise("added", &of(2.0), &of(0.0), 1e-6, 0.0).expect("the same is added");
    }
}
