//! `optimizer/adam_texels` against its twin, and against `optimizer/adam` to the bit.

use super::adam::{CAMERA, RATES, check_with, random_gradients};
use crate::common::adam::{AdamState, Step};
use crate::common::gpu::{Gpu, sizes};
use crate::common::scenes::{Random, mixed_scene};

#[test]
fn adam_texels_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
        check_with(true, &gpu, size, [3, 3], false);
    }
    for degrees in [[0, 0], [0, 3], [1, 3], [2, 2]] {
        for sparse in [false, true] {
            check_with(true, &gpu, 100, degrees, sparse);
        }
    }
}

#[test]
fn adam_texels_equals_adam_to_the_bit() {
    let gpu = Gpu::new();
    let mut random = Random::new(8);
    let gaussians = mixed_scene(&mut random, 500, 16);
    let states =
        [AdamState::new(&gpu, &gaussians, 3, false), AdamState::reading_texels(&gpu, &gaussians, 3, false)];
    for count in 1..=3 {
        let gradients = random_gradients(&mut random, 500);
        for overflow in [false, true] {
            let step = Step { rates: RATES, count, camera_position: CAMERA };
            let [stored, texels] = [0, 1].map(|k| {
                let skipped = states[k].step(&gradients, &step, overflow);
                (skipped, states[k].download())
            });
            assert!(stored == texels, "step {count}");
        }
    }
}
