//! `loss/term_reduce` against its twin.

use crate::common::compare::elementwise;
use crate::common::gpu::Gpu;
use crate::common::regularizers::regularize;
use crate::common::scenes::{Random, mixed_scene};
use crate::reference;

#[test]
fn term_reduce_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, weights) in
        [(1, [0.01, 0.01]), (333, [0.5, 0.0]), (100_000, [0.0, 2.0]), (70_001, [0.01, 0.02])]
    {
        let gaussians = mixed_scene(&mut Random::new(size as u64), size, 1);
        let (actual, _) = regularize(&gpu, &gaussians, weights);
        let sums = reference::regularize::regularize(&gaussians, weights);
        let expected = reference::term_reduce::losses(&sums, size, weights);
        elementwise("losses", &actual, &expected, 1e-7, 3e-6).expect("losses");
    }
}
